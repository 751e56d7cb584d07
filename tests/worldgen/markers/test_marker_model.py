from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from lxml import etree
from numpy.typing import NDArray
from PIL import Image

from mazebot.common.config import ConfigError
from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import Array
from mazebot.common.world.marker_dictionary import read_dictionary
from mazebot.worldgen.sdf.marker_model import PANEL_THICKNESS_M, write_marker_model

SIDE_M = 0.3 * 8 / 6
Pixels = NDArray[np.uint8]


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def picture(folder: Path, marker_id: int) -> Pixels:
    grey = cv2.imread(str(folder / f"materials/textures/{marker_id}.png"), cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    return np.asarray(grey, np.uint8)


def ids_in(grey: Pixels, dictionary: cv2.aruco.Dictionary | None = None) -> list[int]:
    known = dictionary or cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    _, ids, _ = cv2.aruco.ArucoDetector(known).detectMarkers(grey)
    return [] if ids is None else [int(one) for one in ids.ravel()]


def seen(mesh: Any, right: Array, up: Array, side_px: int = 320) -> Pixels:
    """The mesh as one sees it who looks along cross(up, right), pixel by pixel."""
    towards = np.cross(right, up)
    axis = (np.arange(side_px) + 0.5) / side_px - 0.5
    u, v = np.meshgrid(axis, -axis)
    extent = 1.25 * SIDE_M
    at = extent * (u[..., None] * right + v[..., None] * up)
    origins = (at + towards).reshape(-1, 3)
    corners = mesh.triangles
    shown = np.full(len(origins), 255, np.uint8)
    best = np.full(len(origins), -np.inf)
    material = mesh.visual.material
    texture = material.baseColorTexture if hasattr(material, "baseColorTexture") else material.image
    image = np.asarray(texture.convert("L"))
    for triangle, normal, uvs in zip(
        corners, mesh.face_normals, mesh.visual.uv[mesh.faces], strict=True
    ):
        if normal @ towards < 1e-6:
            continue
        flat = np.array([[p @ right, p @ up, 1.0] for p in triangle]).T
        weights = np.linalg.solve(
            flat, np.array([origins @ right, origins @ up, np.ones(len(best))])
        )
        height = (triangle @ towards) @ weights
        inside = (weights >= -1e-9).all(0) & (height > best)
        texel = uvs.T @ weights
        column = np.clip((texel[0] * image.shape[1]).astype(int), 0, image.shape[1] - 1)
        row = np.clip(((1.0 - texel[1]) * image.shape[0]).astype(int), 0, image.shape[0] - 1)
        shown[inside] = image[row, column][inside]
        best[inside] = height[inside]
    return shown.reshape(side_px, side_px)


def loaded(file: Path) -> Any:
    """The one mesh in a file."""
    scene: Any = trimesh.load(file)
    return scene.to_geometry() if isinstance(scene, trimesh.Scene) else scene


def closed(mesh: Any) -> bool:
    """Whether it has an inside, and its faces look out of it."""
    joined = trimesh.Trimesh(mesh.vertices, mesh.faces)
    return bool(joined.is_volume)


X, Y, Z = np.eye(3)


@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_a_panel_shows_its_marker_upright_in_front_and_nothing_behind(
    tmp_path: Path, suffix: str
) -> None:
    folder = write_marker_model(tmp_path, 60)
    mesh = loaded(folder / f"meshes/aruco_id_60.{suffix}")
    assert closed(mesh)
    assert mesh.bounds == pytest.approx(
        np.array([[-SIDE_M / 2, -SIDE_M / 2, -PANEL_THICKNESS_M], [SIDE_M / 2, SIDE_M / 2, 0.0]])
    )
    front = seen(mesh, X, Y)
    assert ids_in(front) == [60]
    # The right way round: as in the picture.
    small = cv2.resize(picture(folder, 60), (256, 256), interpolation=cv2.INTER_AREA)
    assert (np.abs(front[32:288, 32:288].astype(int) - small) > 128).mean() < 0.02
    behind = seen(mesh, -X, Y)
    assert behind.min() == 255


def test_a_cube_shows_its_marker_on_all_sides(tmp_path: Path) -> None:
    folder = write_marker_model(tmp_path, 80, kind="cube")
    mesh = loaded(folder / "meshes/aruco_id_80.obj")
    assert closed(mesh)
    assert mesh.extents == pytest.approx(np.full(3, SIDE_M))
    assert mesh.bounds.sum(0) == pytest.approx(np.zeros(3), abs=1e-12)
    upright = seen(mesh, -Y, Z)
    for right, up in ((-Y, Z), (X, Z), (Y, Z), (-X, Z), (-X, Y), (X, Y)):
        face = seen(mesh, right, up)
        assert ids_in(face) == [80]
        # Readable the right way up, not only found.
        assert (np.abs(face.astype(int) - upright) > 128).mean() < 0.01


def test_a_panel_is_seen_and_never_touched_a_cube_both(tmp_path: Path) -> None:
    for kind, collisions in (("panel", 0), ("cube", 1)):
        folder = write_marker_model(tmp_path / kind, 60, kind=kind)  # type: ignore[arg-type]
        root = etree.parse(folder / "model.sdf").getroot()
        assert root.get("version") == "1.9"
        assert root.find("model").get("name") == "aruco_id_60"
        assert root.findtext("model/static") == "true"
        assert len(root.findall(".//collision")) == collisions
        assert len(root.findall(".//visual")) == 1
        # All that it names is there, by its name relative to the file.
        named = [element.text for element in root.iter("uri", "albedo_map")]
        assert len(named) == 2
        for name in named:
            assert (folder / name).is_file()
        assert "/" not in root.findtext("model/link/name", "")
        config = etree.parse(folder / "model.config").getroot()
        assert (folder / config.findtext("sdf")).is_file()
        material = (folder / "meshes/aruco_id_60.mtl").read_text()
        (texture,) = {line.split()[1] for line in material.splitlines() if line.startswith("map_")}
        assert (folder / "meshes" / texture).is_file()


@pytest.mark.parametrize("marker_id", [60, 80])
def test_the_models_that_come_with_it_are_what_the_code_writes(
    tmp_path: Path, marker_id: int
) -> None:
    written = write_marker_model(tmp_path, marker_id)
    assert bytes_of(written) == bytes_of(ROOT / "models" / f"aruco_id_{marker_id}")


def test_a_quiet_zone_surrounds_the_black_square(tmp_path: Path) -> None:
    folder = write_marker_model(tmp_path, 5, "DICT_6X6_250", 0.2, "panel", 2)
    grey = picture(folder, 5)
    module_px = grey.shape[0] // (8 + 4)
    inner = grey[2 * module_px : -2 * module_px, 2 * module_px : -2 * module_px]
    assert (grey == 255).sum() - (inner == 255).sum() == grey.size - inner.size
    assert (inner[0] == 0).all()
    side_m = loaded(folder / "meshes/aruco_id_5.obj").extents[0]
    assert side_m * inner.shape[0] / grey.shape[0] == pytest.approx(0.2)
    with Image.open(folder / "materials/textures/5.png") as image:
        assert image.format == "PNG"


OWN = {"nmarkers": 2, "markersize": 4, "maxCorrectionBits": 0,
       "marker_0": "1011010010011100", "marker_1": "0100111011010010"}  # fmt: skip


def as_yaml(content: dict[str, object]) -> str:
    lines = (
        f'{key}: "{value}"' if isinstance(value, str) else f"{key}: {value}"
        for key, value in content.items()
    )
    return "%YAML:1.0\n---\n" + "\n".join(lines) + "\n"


@pytest.mark.parametrize("suffix", ["yml", "json", "xml"])
def test_a_dictionary_of_ones_own_as_opencv_writes_it(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"own.{suffix}"
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    for key, value in OWN.items():
        storage.write(key, value)  # type: ignore[call-overload]
    storage.release()
    dictionary = read_dictionary(file)
    folder = write_marker_model(tmp_path / "models", 1, "own", dictionary_file=file)
    assert ids_in(picture(folder, 1), dictionary) == [1]
    # It reads the same as OpenCV reads it.
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
    theirs = cv2.aruco.Dictionary()
    theirs.readDictionary(storage.root())
    assert (theirs.bytesList == dictionary.bytesList).all()
    assert theirs.markerSize == dictionary.markerSize
    # The world's documents know OpenCV's dictionaries alone: this one is something to look at.
    assert b"mazebot:marker" not in (folder / "model.sdf").read_bytes()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "must be a flat mapping with nmarkers"),
        ("- 1\n- 2\n", "must be a flat mapping with nmarkers"),
        ("a: [" + "{a: 1}," * 500_000 + "]", "must be a flat mapping with nmarkers"),
        ("a: &a [1]\nnmarkers: *a\n", "must be a flat mapping with nmarkers"),
        ("a: 1\nb", "neither YAML nor JSON nor XML"),
        ("{" * 5000, "neither YAML nor JSON nor XML"),
        ("<a><b></a>", "neither YAML nor JSON nor XML"),
        (json.dumps({**OWN, "nmarkers": -1}), "nmarkers: -1: must be an integer"),
        (json.dumps({**OWN, "nmarkers": True}), "nmarkers: True: must be an integer"),
        (as_yaml({**OWN, "nmarkers": 10**9}), "must be an integer"),
        (as_yaml({**OWN, "nmarkers": 3}), "marker_2: is missing"),
        (as_yaml({**OWN, "markersize": 5}), "marker_0: '1011010010011100': must be 25 digits"),
        (as_yaml({**OWN, "markersize": 1}), "markersize: 1: must be from 2 to 16"),
        (as_yaml({**OWN, "marker_1": "0100111011010012"}), "marker_1: '0100111011010012': must be"),
        (as_yaml({k: v for k, v in OWN.items() if k != "markersize"}), "markersize: is missing"),
    ],
)
def test_a_bad_dictionary_is_one_line(tmp_path: Path, content: str, said: str) -> None:
    file = tmp_path / "own.yml"
    file.write_text(content)
    with pytest.raises(ConfigError) as error:
        write_marker_model(tmp_path / "models", 0, "own", dictionary_file=file)
    assert str(error.value).startswith(f"{file}:")
    assert said in str(error.value)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "models").exists()


def test_a_dictionary_is_read_from_a_file_alone(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yml")
    (tmp_path / "zero.yml").symlink_to("/dev/zero")
    (tmp_path / "folder.yml").mkdir()
    for name in ("pipe.yml", "zero.yml", "folder.yml"):
        with pytest.raises(ConfigError, match=f"{name}: must be a file"):
            write_marker_model(tmp_path, 0, "own", dictionary_file=tmp_path / name)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"marker_id": 100}, "id: 100: must be less than 100 in DICT_4X4_100"),
        ({"marker_id": -1}, "id: -1: "),
        ({"dictionary": "DICT_5"}, "dictionary: 'DICT_5': must be one of DICT_4X4_100"),
        ({"size_m": 0.0}, "size_m: 0.0: "),
        ({"size_m": float("nan")}, "size_m: nan: "),
        ({"size_m": 1e-300}, "size_m: 1e-300: must be from 0.001 to 100"),
        ({"size_m": 1e9}, "size_m: 1000000000.0: must be from 0.001 to 100"),
        ({"quiet_zone_modules": 0}, "quiet_zone_modules: 0: "),
        ({"dictionary_file": Path("/no/such")}, "/no/such: cannot be read"),
    ],
)
def test_a_marker_that_cannot_be_is_one_line(
    tmp_path: Path, changes: dict[str, object], said: str
) -> None:
    with pytest.raises(ConfigError) as error:
        write_marker_model(**{"folder": tmp_path, "marker_id": 0, **changes})  # type: ignore[arg-type]
    assert str(error.value).startswith(said)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_a_model_is_replaced_and_nothing_else(tmp_path: Path) -> None:
    before = bytes_of(write_marker_model(tmp_path, 7))
    folder = write_marker_model(tmp_path, 7, size_m=0.1)
    assert bytes_of(folder).keys() == before.keys()
    assert bytes_of(folder) != before
    (folder / "notes.txt").write_text("mine")
    kept = bytes_of(folder)
    with pytest.raises(ConfigError, match=r"aruco_id_7: contains notes\.txt"):
        write_marker_model(tmp_path, 7)
    assert bytes_of(folder) == kept
    assert [entry.name for entry in tmp_path.iterdir()] == ["aruco_id_7"]

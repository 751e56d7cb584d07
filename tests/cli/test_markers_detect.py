"""`mazebot markers detect`: ids, corners and poses of the markers in pictures."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image

from mazebot.cli.markers.camera_file import read_camera_file
from mazebot.common.config import ConfigError
from tests.cli.test_app import assert_one_line, mazebot
from tests.perception.scene import CAMERA, camera_from_marker, project, render

POSE = camera_from_marker(1.5, math.radians(40), 0.05, 0.1)
ROS = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "narrow_stereo",
    "camera_matrix": {"rows": 3, "cols": 3, "data": CAMERA.ravel().tolist()},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0, 0.0, 0.0, 0.0, 0.0]},
}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of `here`, drawn once."""
    folder = tmp_path_factory.mktemp("pictures")
    rgb = render(POSE, "bricks")
    cv2.imwrite(str(folder / "wall.png"), rgb[..., ::-1])
    cv2.imwrite(str(folder / "blank.png"), np.full((480, 640, 3), 128, np.uint8))
    cv2.imwrite(str(folder / "small.png"), rgb[:240, :320, ::-1])
    (folder / "camera.yaml").write_text(yaml.safe_dump(ROS))
    (folder / "text.png").write_text("no picture")
    (folder / "empty.png").write_bytes(b"")
    data = (folder / "wall.png").read_bytes()
    (folder / "cut.png").write_bytes(data[:5000])
    wrong = data[:5000] + bytes(reversed(data[5000:8000])) + data[8000:]
    (folder / "wrong.png").write_bytes(wrong)
    return folder


@pytest.fixture
def here(pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(pictures, tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_a_marker_is_printed_with_its_pose(here: Path) -> None:
    done = mazebot(
        "markers", "detect", "wall.png", "--camera", "camera.yaml", "--size", "0.3", "--json"
    )
    assert done.returncode == 0, done.stderr
    (image,) = json.loads(done.stdout)["images"]
    assert (image["image"], image["width"], image["height"]) == ("wall.png", 640, 480)
    (marker,) = image["markers"]
    assert marker["id"] == 60
    assert np.abs(np.array(marker["corners_px"]) - project(POSE)).max() < 0.15
    better, worse = marker["poses"]
    assert np.abs(np.array(better["position_m"]) - POSE[:3, 3]).max() < 0.01
    assert np.array(better["covariance"]).shape == (6, 6)
    ratio = worse["reprojection_error_px"] / better["reprojection_error_px"]
    assert marker["ambiguity"] == pytest.approx(ratio)
    for_people = mazebot(
        "markers", "detect", "wall.png", "blank.png", "--camera", "camera.yaml", "--size", "0.3"
    ).stdout.splitlines()
    assert for_people[0].startswith("wall.png: id 60: corners (")
    assert "seen from 1.50" in for_people[1]
    assert "ambiguity" in for_people[1]
    assert for_people[2] == "blank.png: no marker"


def test_what_is_found_is_drawn(here: Path) -> None:
    given = ("--camera", "camera.yaml", "--size", "0.3")
    assert mazebot("markers", "detect", "wall.png", *given, "--draw", "out.png").returncode == 0
    before, after = cv2.imread("wall.png"), cv2.imread("out.png")
    assert before is not None
    assert after is not None
    changed = np.argwhere((before != after).any(axis=2))[:, ::-1]
    corners = project(POSE)
    assert np.abs(changed.min(axis=0) - corners.min(axis=0)).max() < 15
    # Between two corners, the outline is green.
    x, y = corners[:2].mean(axis=0).round().astype(int)
    assert after[y, x, 1] > 150 > after[y, x, 2]
    assert mazebot("markers", "detect", "wall.png", "blank.png", "--draw", "both").returncode == 0
    assert {file.name for file in Path("both").iterdir()} == {"wall.png", "blank.png"}


def test_no_picture_is_drawn_over_one_that_is_read(here: Path) -> None:
    before = Path("wall.png").read_bytes()
    Path("link.png").symlink_to("wall.png")
    Path("twin.png").hardlink_to("wall.png")
    for outputs in ("wall.png", "link.png", "twin.png", "."):
        assert_one_line(
            mazebot("markers", "detect", "wall.png", "--draw", outputs), "--draw", "reads"
        )
    assert_one_line(
        mazebot("markers", "detect", "blank.png", "link.png", "--draw", str(here)), "--draw"
    )
    assert Path("wall.png").read_bytes() == before
    assert mazebot("markers", "detect", "wall.png", "--draw", "new.png").returncode == 0
    # What an earlier command has written may be written again.
    assert mazebot("markers", "detect", "wall.png", "--draw", "new.png").returncode == 0


def test_pictures_that_are_transparent_or_of_any_range_are_read(here: Path) -> None:
    grey = np.asarray(cv2.imread("wall.png", cv2.IMREAD_GRAYSCALE), np.uint8)
    ink = np.zeros_like(grey)
    marker = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100).generateImageMarker(60, 160)
    ink[100:260, 100:260] = 255 - marker
    black = np.zeros_like(ink)
    cv2.imwrite("ink.png", np.dstack([black, black, black, ink]))
    cv2.imwrite("hidden.png", np.dstack([grey, grey, grey, black]))
    palette = Image.fromarray(ink // 255).convert("P")
    palette.putpalette([0] * 6)
    palette.save("palette.png", transparency=0)
    share = grey.astype(np.float32) / 255.0
    share[:2, :5] = np.nan
    Image.fromarray(share).save("share.tiff")
    share[:2, :5] = 1e6
    Image.fromarray(share).save("glare.tiff")
    cv2.imwrite("ten_bits.png", grey.astype(np.uint16) * 4)
    cv2.imwrite("deep.pgm", grey.astype(np.uint16) * 257)
    files = (
        "ink.png", "hidden.png", "palette.png", "share.tiff", "glare.tiff", "ten_bits.png",
        "deep.pgm",
    )  # fmt: skip
    told = mazebot("markers", "detect", *files).stdout.splitlines()
    for line, file in zip(told, files, strict=True):
        assert line.startswith(f"{file}: id 60")


def test_pictures_of_other_kinds_are_read(here: Path) -> None:
    grey = np.asarray(cv2.imread("wall.png", cv2.IMREAD_GRAYSCALE), np.uint8)
    cv2.imwrite("grey.png", grey)
    cv2.imwrite("deep.png", grey.astype(np.uint16) * 256)
    cv2.imwrite("photo.jpg", grey)
    cv2.imwrite("clear.png", np.dstack([grey] * 3 + [np.full_like(grey, 255)]))
    files = ("grey.png", "deep.png", "photo.jpg", "clear.png")
    told = mazebot("markers", "detect", *files).stdout.splitlines()
    for line, file in zip(told, files, strict=True):
        assert line.startswith(f"{file}: id 60")


def test_dictionaries_by_name_in_any_case_and_of_ones_own(here: Path) -> None:
    for name in ("DICT_4X4_100", "dict_4x4_250", "4X4_1000"):
        told = mazebot("markers", "detect", "wall.png", "--dictionary", name).stdout
        assert told.startswith("wall.png: id 60"), name
    own = cv2.aruco.extendDictionary(3, 5)
    storage = cv2.FileStorage("own.yml", cv2.FILE_STORAGE_WRITE)
    own.writeDictionary(storage)
    storage.release()
    page = np.full((300, 400), 230, np.uint8)
    page[100:200, 100:200] = cv2.aruco.generateImageMarker(own, 2, 100)
    cv2.imwrite("own.png", page)
    told = mazebot("markers", "detect", "own.png", "--dictionary", "own.yml").stdout
    assert told.startswith("own.png: id 2")


def test_markers_of_another_dictionary_are_hinted_at(here: Path) -> None:
    told = mazebot("markers", "detect", "wall.png", "--dictionary", "DICT_6X6_50").stdout
    assert told == "wall.png: no marker\n1 of DICT_4X4_1000: see --dictionary\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("nowhere.png", ["nowhere.png", "No such file"]),
        ("text.png", ["text.png", "is not an image"]),
        ("empty.png", ["empty.png", "is not an image"]),
        ("cut.png", ["cut.png: is corrupt"]),
        ("wrong.png", ["wrong.png: is corrupt"]),
        (".", ["must be a file"]),
        ("wall.png --dictionary DICT_4X4_10", ["--dictionary", "DICT_4X4_10'", "DICT_4X4_100"]),
        ("wall.png --dictionary zzz", ["--dictionary", "zzz", "DICT_APRILTAG_36h11"]),
        ("wall.png --dictionary nowhere.yml", ["nowhere.yml"]),
        ("wall.png --camera camera.yaml", ["--camera", "--size"]),
        ("wall.png --size 0.3", ["--size", "--camera"]),
        ("wall.png --camera camera.yaml --size 0", ["--size: 0", "more than 0"]),
        ("wall.png --camera camera.yaml --size nan", ["--size: nan", "more than 0"]),
        ("wall.png --camera nowhere.yaml --size 1", ["nowhere.yaml", "No such file"]),
        ("small.png --camera camera.yaml --size 1", ["640 x 480", "small.png has 320 x 240"]),
        ("wall.png --corner-sigma 0", ["--corner-sigma", "more than 0"]),
        ("wall.png --draw out.txt", ["--draw", "out.txt", ".png"]),
        ("wall.png blank.png --draw out.png", ["--draw", "must be a folder"]),
        ("wall.png wall.png --draw out", ["--draw", "two of the images"]),
        ("wall.png --draw text.png/out.png", ["--draw", "text.png/out.png"]),
    ],
)
def test_a_mistake_is_one_line(here: Path, arguments: str, words: list[str]) -> None:
    done = mazebot("markers", "detect", *arguments.split())
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    for word in words:
        assert word in line, line


def test_a_calibration_of_ros_or_of_opencv_is_read(tmp_path: Path) -> None:
    lens = [-0.2, 0.05, 0.001, -0.002, 0.0]
    ros = tmp_path / "ros.yaml"
    ros.write_text(yaml.safe_dump({**ROS, "distortion_coefficients": {"data": lens}}))
    theirs = tmp_path / "opencv.yml"
    storage = cv2.FileStorage(str(theirs), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", CAMERA)
    storage.write("distortion_coefficients", np.array([lens]))
    storage.release()
    for file in (ros, theirs):
        read = read_camera_file(file)
        assert (read.width_px, read.height_px) == (640, 480)
        assert (read.camera.matrix == CAMERA).all()
        assert read.camera.distortion.tolist() == lens


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"image_width": None}, "image_width: None: must be an integer"),
        ({"image_height": 0}, "image_height: 0: must be"),
        ({"camera_matrix": {"data": [1.0, 2.0]}}, "camera_matrix.data: must be a list of 9"),
        ({"camera_matrix": {"data": [0.0] * 9}}, "camera_matrix: must be fx 0 cx"),
        ({"camera_matrix": {"data": ["a"] * 9}}, "camera_matrix.data: 'a': must be"),
        ({"camera_matrix": 3}, "camera_matrix.data: must be a list"),
        ({"distortion_model": "equidistant"}, "distortion_model: 'equidistant': must be one of"),
        ({"distortion_coefficients": {"data": [0.1] * 3}}, "distortion_coefficients.data: must"),
        ({"distortion_coefficients": {"data": [math.nan] * 5}}, "must be a finite number"),
    ],
)
def test_a_bad_calibration_is_one_line(
    tmp_path: Path, change: dict[str, object], said: str
) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(yaml.safe_dump({**ROS, **change}))
    with pytest.raises(ConfigError) as caught:
        read_camera_file(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "must be a mapping"),
        ("- 1", "must be a mapping"),
        ("a: [", "not YAML"),
        ("camera_matrix: !!python/name:os.system x", "not YAML"),
        ("image_height: 480", "image_width: is missing"),
        ("x" * 70_000, "must have at most"),
    ],
)
def test_a_file_that_is_no_calibration_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=said) as caught:
        read_camera_file(file)
    assert "\n" not in str(caught.value)

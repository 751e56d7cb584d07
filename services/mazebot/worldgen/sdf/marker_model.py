"""Models of ArUco markers, in the folder layout of Gazebo models."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from lxml import etree
from pydantic import ValidationError

from mazebot.common.config import ConfigError
from mazebot.common.files.folder_writing import write_folder
from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.common.messages.documents import Marker
from mazebot.common.world import marker_picture
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.marker_dictionary import read_dictionary
from mazebot.common.world.marker_entities import PanelStyle
from mazebot.worldgen.sdf.writing import add, add_look, annotate, numbers, sdf_root, xml_bytes

Kind = Literal["panel", "cube"]

PANEL_THICKNESS_M = 0.001
"""Behind the face, which is at z = 0: less than the gap between panels and their wall."""
MIN_SIZE_M, MAX_SIZE_M = 1e-3, 100.0


def write_marker_model(
    folder: Path,
    marker_id: int,
    dictionary: str = "DICT_4X4_100",
    size_m: float = 0.3,
    kind: Kind = "panel",
    quiet_zone_modules: int = 1,
    dictionary_file: Path | None = None,
) -> Path:
    """Write the model `aruco_id_ID` of a marker into a folder of models, and return its folder.

    A panel's face is normal to +z, with +x to the right and +y up as seen from the front; it has no
    collision, and its back is white. A cube shows the marker on each of its faces. `size_m` is the
    side of the black square. `dictionary_file` contains a custom dictionary, see
    marker_dictionary; a model of such a marker is visible, but cannot be a marker of a world's
    recipe.

    Raises ConfigError in one line if there is no such marker, or if the folder cannot be written or
    contains something else.
    """
    own = read_dictionary(dictionary_file) if dictionary_file else None
    if not MIN_SIZE_M <= size_m <= MAX_SIZE_M:
        raise ConfigError(f"size_m: {size_m!r}: must be from {MIN_SIZE_M:g} to {MAX_SIZE_M:g}")
    try:
        marker = Marker(
            id=marker_id, dictionary=dictionary, size_m=size_m, wall="", side="left",
            quiet_zone_modules=quiet_zone_modules, height_m=0.0,
        )  # fmt: skip
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"{field}: {first['input']!r:.40}: {first['msg']}") from error
    problem = marker_picture.identity_problem(marker, own)
    if problem:
        raise ConfigError(problem)
    files = marker_model_files(marker, kind, own)
    return write_folder(folder / model_name(marker.id), files, files.__contains__)


def model_name(marker_id: int) -> str:
    """Name of a marker's model, and of its folder."""
    return f"aruco_id_{marker_id}"


def marker_model_files(
    marker: Marker, kind: Kind = "panel", own: cv2.aruco.Dictionary | None = None
) -> dict[str, bytes]:
    """The files of a marker's model by their path in its folder. `own` as in marker_picture."""
    # Imports of mesh writers are slow.
    from mazebot.worldgen.assets.glb import glb_of  # noqa: PLC0415
    from mazebot.worldgen.assets.meshes import MeshPart  # noqa: PLC0415

    name = model_name(marker.id)
    texture = f"materials/textures/{marker.id}.png"
    side_m = marker_picture.panel_side_m(marker, own)
    black = marker_picture.modules(marker, own)
    white = 0.5 * marker.quiet_zone_modules / (black + 2 * marker.quiet_zone_modules)
    faces = _panel(side_m, white) if kind == "panel" else _cube(side_m)
    picture = marker_picture.draw(marker, PanelStyle().module_px, own)
    glb = glb_of((MeshPart(name, _mesh(faces), _WHITE, picture, f"{marker.id}.png"),))
    return {
        "model.config": _config(marker, kind),
        "model.sdf": _sdf(marker, kind, side_m, texture, own is not None),
        f"meshes/{name}.glb": glb,
        f"meshes/{name}.mtl": _mtl(name, f"{marker.id}.png"),
        f"meshes/{name}.obj": _obj(name, faces),
        # A second copy, because not every reader of OBJ follows a path out of the mesh's folder.
        f"meshes/{marker.id}.png": picture,
        texture: picture,
    }


@dataclass(frozen=True, eq=False)
class _Face:
    """A square of a model: corners counter-clockwise from the lower left, seen from the front."""

    corners_m: Array
    """(4, 3)"""
    normal: Array
    """(3,)"""
    uvs: Array
    """(4, 2): (0, 0) is the image's top left."""


_WHITE = (1.0, 1.0, 1.0, 1.0)
_WHOLE = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def _panel(side_m: float, white: float) -> list[_Face]:
    """The face at z = 0, and a white back and edges. The image is white at (`white`, `white`)."""
    half, back = side_m / 2.0, -PANEL_THICKNESS_M
    blank = np.full((4, 2), white)
    front = np.column_stack([half * _SQUARE, np.zeros(4)])
    behind = np.column_stack([half * _SQUARE[::-1], np.full(4, back)])
    faces = [
        _Face(front, np.array([0.0, 0.0, 1.0]), _WHOLE),
        _Face(behind, np.array([0.0, 0.0, -1.0]), blank),
    ]
    for start, end in zip(front, np.roll(front, -1, axis=0), strict=True):
        edge = np.array([start, start, end, end])
        edge[1:3, 2] = back
        along = (end - start) / side_m
        faces.append(_Face(edge, np.array([along[1], -along[0], 0.0]), blank))
    return faces


def _cube(side_m: float) -> list[_Face]:
    """Six images, upright on the sides; on top and bottom their upper edge is towards +y."""
    half = side_m / 2.0
    z = np.array([0.0, 0.0, 1.0])
    faces = []
    for yaw_quarters in range(4):
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[yaw_quarters]
        faces.append((np.array([c, s, 0.0]), z))
    faces += [(z, np.array([0.0, 1.0, 0.0])), (-z, np.array([0.0, 1.0, 0.0]))]
    made = []
    for normal, up in faces:
        right = np.cross(up, normal)
        corners = half * (normal + portable.product(_SQUARE, np.array([right, up])))
        made.append(_Face(corners, normal, _WHOLE))
    return made


def _mesh(faces: list[_Face]) -> TriangleMesh:
    starts = 4 * np.arange(len(faces))
    return TriangleMesh(
        np.concatenate([face.corners_m for face in faces]),
        np.concatenate([np.tile(face.normal, (4, 1)) for face in faces]),
        np.concatenate([face.uvs for face in faces]),
        np.asarray([(at, at + 1 + k, at + 2 + k) for at in starts for k in range(2)], np.int32),
    )


def _obj(name: str, faces: list[_Face]) -> bytes:
    """Wavefront OBJ, in which v points upwards."""
    lines = [f"mtllib {name}.mtl", f"o {name}"]
    for face in faces:
        lines += [f"v {numbers(corner)}" for corner in face.corners_m]
    for face in faces:
        lines += [f"vt {numbers((u, 1.0 - v))}" for u, v in face.uvs]
    lines += [f"vn {numbers(face.normal)}" for face in faces]
    lines.append(f"usemtl {name}")
    for index in range(len(faces)):
        corners = range(4 * index + 1, 4 * index + 5)
        lines.append("f " + " ".join(f"{at}/{at}/{index + 1}" for at in corners))
    return ("\n".join(lines) + "\n").encode()


def _mtl(name: str, texture: str) -> bytes:
    colours = "Ka 1 1 1\nKd 1 1 1\nKs 0 0 0\nillum 1"
    return f"newmtl {name}\n{colours}\nmap_Ka {texture}\nmap_Kd {texture}\n".encode()


def _config(marker: Marker, kind: Kind) -> bytes:
    root = etree.Element("model")
    add(root, "name", model_name(marker.id))
    add(root, "version", "1.0")
    add(root, "sdf", "model.sdf", version="1.9")
    side = f"black square of {marker.size_m:g} m with {marker.quiet_zone_modules} white "
    modules = "module" if marker.quiet_zone_modules == 1 else "modules"
    add(
        root,
        "description",
        f"ArUco marker {marker.id} of {marker.dictionary} on a {kind}: {side}{modules} around it.",
    )
    return xml_bytes(root)


def _sdf(marker: Marker, kind: Kind, side_m: float, texture: str, own: bool) -> bytes:
    name = model_name(marker.id)
    root = sdf_root("1.9")
    model = add(root, "model", name=name)
    if kind == "panel" and not own:
        annotate(
            model,
            marker=str(marker.id),
            dictionary=marker.dictionary,
            size_m=repr(marker.size_m),
            quiet_zone_modules=str(marker.quiet_zone_modules),
        )
    add(model, "static", "true")
    link = add(model, "link", name="link")
    if kind == "cube":
        collision = add(link, "collision", name="collision")
        add(add(add(collision, "geometry"), "box"), "size", numbers((side_m, side_m, side_m)))
    visual = add(link, "visual", name="visual")
    if kind == "panel":
        # The shadow of a panel millimetres before its wall would flicker.
        add(visual, "cast_shadows", "false")
    add(add(add(visual, "geometry"), "mesh"), "uri", f"meshes/{name}.obj")
    add_look(visual, _WHITE, _WHITE, texture)
    return xml_bytes(root)

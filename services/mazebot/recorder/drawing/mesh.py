"""Triangle meshes of marker panels and of the robot."""

from __future__ import annotations

import functools
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import rerun as rr
import shapely
from numpy.typing import NDArray

from mazebot.common.maths.frames import (
    SE3,
    Array,
    rotation_from_rpy,
    transform_matrix,
)

_SIDES_OF_ROUND = 24
_OUTLINE_STEP_M = 0.005
"""Corners of the robot's outline that protrude by less are left out."""
_GREY: Array = np.array([0.6, 0.6, 0.6, 1.0])
_UNIT_UVS: Array = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles, counter-clockwise from outside."""

    positions_m: NDArray[np.float32]
    """(n, 3)"""
    normals: NDArray[np.float32]
    """(n, 3)"""
    uvs: NDArray[np.float32]
    """(n, 2): (0, 0) is a texture's top left, (1, 1) its bottom right; it repeats beyond."""
    colors: NDArray[np.uint8]
    """(n, 4), RGBA"""
    triangles: NDArray[np.uint32]
    """(m, 3)"""


class MeshBuilder:
    """Builds a mesh from its faces."""

    def __init__(self) -> None:
        self._positions: list[Array] = []
        self._normals: list[Array] = []
        self._uvs: list[Array] = []
        self._colors: list[NDArray[np.uint8]] = []
        self._triangles: list[NDArray[np.uint32]] = []
        self._count = 0

    def add(
        self,
        positions_m: Array,
        normals: Array,
        triangles: NDArray[np.uint32],
        rgba: Iterable[float] = (1.0, 1.0, 1.0, 1.0),
        uvs: Array | None = None,
    ) -> None:
        """Add (n, 3) vertices with normals, and (m, 3) triangles of them, in one colour, 0 to 1."""
        count = len(positions_m)
        color = np.clip(np.round(255.0 * np.array(tuple(rgba))), 0, 255).astype(np.uint8)
        self._positions.append(positions_m)
        self._normals.append(np.broadcast_to(normals, (count, 3)))
        self._uvs.append(np.zeros((count, 2)) if uvs is None else uvs)
        self._colors.append(np.tile(color, (count, 1)))
        self._triangles.append(triangles + np.uint32(self._count))
        self._count += count

    def add_rectangle(
        self,
        a_from_b: Array,
        centre_m: Array,
        half_right_m: Array,
        half_up_m: Array,
        rgba: Iterable[float] = (1.0, 1.0, 1.0, 1.0),
        uvs: Array | None = None,
    ) -> None:
        """Add a rectangle given in b; its texture runs from the bottom left of its front."""
        corners = np.array(
            [
                centre_m - half_right_m - half_up_m,
                centre_m + half_right_m - half_up_m,
                centre_m + half_right_m + half_up_m,
                centre_m - half_right_m + half_up_m,
            ]
        )
        normal = np.cross(half_right_m, half_up_m)
        normal = a_from_b[:3, :3] @ (normal / np.linalg.norm(normal))
        triangles = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
        self.add(_moved(a_from_b, corners), normal, triangles, rgba, uvs)

    def mesh(self) -> Mesh | None:
        """The mesh; None if nothing was added."""
        if not self._positions:
            return None
        return Mesh(
            np.concatenate(self._positions).astype(np.float32),
            np.concatenate(self._normals).astype(np.float32),
            np.concatenate(self._uvs).astype(np.float32),
            np.concatenate(self._colors),
            np.concatenate(self._triangles),
        )


def panel(side_m: float) -> Mesh:
    """The front of a marker's panel in its own frame, for its texture."""
    builder = MeshBuilder()
    half_m = side_m / 2.0
    builder.add_rectangle(
        np.eye(4),
        np.zeros(3),
        np.array([half_m, 0.0, 0.0]),
        np.array([0.0, half_m, 0.0]),
        uvs=_UNIT_UVS,
    )
    return _whole(builder)


def mesh_drawing(mesh: Mesh, texture: NDArray[np.uint8] | None = None) -> rr.Mesh3D:
    """A mesh with a texture, or else with its vertex colours."""
    return rr.Mesh3D(
        vertex_positions=mesh.positions_m,
        vertex_normals=mesh.normals,
        vertex_texcoords=None if texture is None else mesh.uvs,
        vertex_colors=mesh.colors if texture is None else None,
        triangle_indices=mesh.triangles,
        albedo_texture=texture,
    )


@dataclass(frozen=True, eq=False)
class Wheel:
    """A part that rotates about an axis."""

    joint: str
    base_from_joint: Array
    """(4, 4), at angle 0"""
    axis: Array
    """(3,), in the part's frame"""
    mesh: Mesh

    @functools.cached_property
    def pose(self) -> SE3:
        """The same as `base_from_joint`."""
        return SE3.from_matrix(self.base_from_joint)


@dataclass(frozen=True, eq=False)
class RobotMesh:
    """The robot in the frame of its root link: its fixed and its rotating links."""

    body: Mesh
    wheels: tuple[Wheel, ...]

    def outline(self) -> list[Array]:
        """Closed and open strips, (n, 3) each, along the edges of the upright prism around it."""
        turning = [
            _moved(wheel.base_from_joint, wheel.mesh.positions_m.astype(np.float64))
            for wheel in self.wheels
        ]
        points = np.concatenate([self.body.positions_m.astype(np.float64), *turning])
        hull = shapely.convex_hull(shapely.multipoints(points[:, :2]))
        ring = shapely.get_coordinates(shapely.simplify(hull, _OUTLINE_STEP_M))
        low, high = (
            np.column_stack([ring, np.full(len(ring), z_m)])
            for z_m in (points[:, 2].min(), points[:, 2].max())
        )
        return [low, high, *np.stack([low, high], axis=1)[1:]]


def robot_from_urdf(text: str) -> RobotMesh:
    """The robot of a URDF file whose visuals are boxes, cylinders and spheres."""
    root = ET.fromstring(text)
    colors = {
        material.attrib["name"]: _numbers(material.find("color"), "rgba", 4)
        for material in root.findall("material")
    }
    links = {link.attrib["name"]: link for link in root.findall("link")}
    joints = {joint.find("child").attrib["link"]: joint for joint in root.findall("joint")}  # type: ignore[union-attr]
    body = MeshBuilder()
    wheels = []
    for name, link in links.items():
        turning, moving_from_link = _moving_parent(name, joints)
        builder = MeshBuilder() if turning is not None else body
        for visual in link.findall("visual"):
            material = visual.find("material")
            rgba = colors.get(material.attrib["name"] if material is not None else "")
            geometry = visual.find("geometry")
            if geometry is not None and len(geometry):
                placed = moving_from_link @ _origin(visual)
                _add_shape(builder, geometry[0], placed, _GREY if rgba is None else rgba)
        mesh = builder.mesh()
        if turning is not None and mesh is not None:
            parent = turning.find("parent").attrib["link"]  # type: ignore[union-attr]
            _, base_from_parent = _moving_parent(parent, joints)
            axis = turning.find("axis")
            wheels.append(
                Wheel(
                    joint=turning.attrib["name"],
                    base_from_joint=base_from_parent @ _origin(turning),
                    axis=_numbers(axis, "xyz", 3) if axis is not None else np.array([1.0, 0, 0]),
                    mesh=mesh,
                )
            )
    return RobotMesh(_whole(body), tuple(wheels))


def _moving_parent(link: str, joints: dict[str, ET.Element]) -> tuple[ET.Element | None, Array]:
    """The joint that moves a link, and its frame from the link's; None if fixed to the root."""
    moving_from_link: Array = np.eye(4)
    while link in joints:
        joint = joints[link]
        if joint.attrib["type"] != "fixed":
            return joint, moving_from_link
        moving_from_link = _origin(joint) @ moving_from_link
        link = joint.find("parent").attrib["link"]  # type: ignore[union-attr]
    return None, moving_from_link


def _add_shape(builder: MeshBuilder, shape: ET.Element, placed: Array, rgba: Array) -> None:
    if shape.tag == "box":
        half = _numbers(shape, "size", 3) / 2.0
        for axis in range(3):
            for sign in (1.0, -1.0):
                right, up = np.zeros(3), np.zeros(3)
                right[(axis + 1) % 3] = half[(axis + 1) % 3] * sign
                up[(axis + 2) % 3] = half[(axis + 2) % 3]
                centre = np.zeros(3)
                centre[axis] = half[axis] * sign
                builder.add_rectangle(placed, centre, right, up, rgba)
    elif shape.tag == "cylinder":
        radius_m, half_m = float(shape.attrib["radius"]), float(shape.attrib["length"]) / 2.0
        profile = [(0.0, half_m, 1.0), (radius_m, half_m, 1.0), (radius_m, half_m, 0.0)]
        profile += [(r, -z, -up) for r, z, up in reversed(profile)]
        _add_turned(builder, placed, profile, rgba)
    elif shape.tag == "sphere":
        radius_m = float(shape.attrib["radius"])
        angles = np.linspace(math.pi / 2.0, -math.pi / 2.0, 9)
        _add_turned(
            builder,
            placed,
            [(radius_m * math.cos(a), radius_m * math.sin(a), math.sin(a)) for a in angles],
            rgba,
        )


def _add_turned(
    builder: MeshBuilder, placed: Array, profile: list[tuple[float, float, float]], rgba: Array
) -> None:
    """Add a solid of revolution about z: its profile is (radius, z, z of the normal), top down."""
    rows, n = len(profile), _SIDES_OF_ROUND
    turn = np.linspace(0.0, 2.0 * math.pi, n, endpoint=False)
    around = np.stack([np.cos(turn), np.sin(turn), np.zeros(n)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    points = np.concatenate([r * around + z * up for r, z, _ in profile])
    normals = np.concatenate(
        [math.sqrt(max(1.0 - nz * nz, 0.0)) * around + nz * up for _, _, nz in profile]
    )
    triangles = []
    for row in range(rows - 1):
        for i in range(n):
            a, b = row * n + i, row * n + (i + 1) % n
            triangles += [[a, a + n, b], [b, a + n, b + n]]
    builder.add(
        _moved(placed, points), normals @ placed[:3, :3].T, np.array(triangles, np.uint32), rgba
    )


def _origin(element: ET.Element) -> Array:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    x, y, z = (float(v) for v in _numbers(origin, "xyz", 3))
    return transform_matrix(rotation_from_rpy(*_numbers(origin, "rpy", 3).tolist()), (x, y, z))


def _numbers(element: ET.Element | None, name: str, count: int) -> Array:
    text = element.attrib.get(name) if element is not None else None
    return np.array([float(word) for word in text.split()]) if text else np.zeros(count)


def _moved(a_from_b: Array, points: Array) -> Array:
    return points @ a_from_b[:3, :3].T + a_from_b[:3, 3]


def _whole(builder: MeshBuilder) -> Mesh:
    mesh = builder.mesh()
    if mesh is None:
        raise ValueError("nothing to draw")
    return mesh

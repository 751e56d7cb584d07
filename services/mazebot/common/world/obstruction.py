"""Obstacles for a panel, a view ray or a robot, as convex pieces seen from above."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array, pose_matrix
from mazebot.common.messages.documents import Body, Mesh, Polyline, Shape, Wall, World
from mazebot.common.world.footprint import wall_corners
from mazebot.common.world.geometry import (
    TriangleMesh,
    clipped,
    flat_triangles,
    polygons_of,
    triangles_of,
)

MAX_PIECES = 20_000
"""A mesh with more triangles between two heights is replaced there by its convex hull."""

_THIN_M = 5e-4
"""Half of the thickness given to pieces that have none seen from above."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Convex areas of the floor and the heights between which each is filled."""

    polygons: NDArray[np.object_]
    """(n,) of shapely.Polygon in the map"""
    low_m: Array
    """(n,)"""
    high_m: Array
    """(n,)"""


@dataclass(frozen=True, eq=False)
class Obstruction:
    """One shape of a body at its initial pose."""

    name: str
    """Name of the body."""
    seen: bool
    solid: bool
    low_m: float
    high_m: float
    parts: tuple[TriangleMesh, ...]
    """In the map frame."""
    convex: bool
    """Whether each part is convex; else the parts are surfaces that enclose nothing."""

    def between(self, low_m: float, high_m: float) -> Pieces:
        """Its pieces between two heights: convex parts exactly, else the triangles of their
        surface.
        """
        polygons: list[shapely.Geometry] = []
        spans: list[tuple[float, float]] = []
        if low_m < self.high_m and self.low_m < high_m:
            for part in self.parts:
                left = clipped(part, low_m, high_m)
                if len(left.triangles) == 0:
                    continue
                points = left.vertices_m[left.triangles]
                if self.convex or len(points) > MAX_PIECES:
                    points = points.reshape(1, -1, 3)
                polygons += list(_hulls(points[:, :, :2]))
                spans += zip(
                    points[:, :, 2].min(1).tolist(), points[:, :, 2].max(1).tolist(), strict=True
                )
        lows_highs = np.array(spans).reshape(-1, 2)
        found = np.empty(len(polygons), np.object_)
        found[:] = polygons
        return Pieces(found, lows_highs[:, 0], lows_highs[:, 1])


def wall_polygons(walls: tuple[Wall, ...]) -> NDArray[np.object_]:
    """(n,) of shapely.Polygon: the walls' footprints in the map."""
    corners = np.array([wall_corners(wall) for wall in walls]).reshape(-1, 4, 2)
    return np.asarray(shapely.polygons(corners), np.object_).reshape(-1)


def obstructions(
    world: World, meshes: Mapping[str, TriangleMesh] | None = None
) -> tuple[Obstruction, ...]:
    """The shapes of a world's bodies, in their order, without walls.

    `meshes` are by sha256; a shape whose mesh is missing is left out.
    """
    return tuple(
        one
        for body in world.bodies
        for shape in body.shapes
        if not isinstance(shape.geometry, Mesh) or shape.geometry.sha256 in (meshes or {})
        if (one := _obstruction(body, shape, meshes or {})) is not None
    )


def _obstruction(
    body: Body, shape: Shape, meshes: Mapping[str, TriangleMesh]
) -> Obstruction | None:
    geometry = shape.geometry
    if isinstance(geometry, Polyline):
        surfaces = _prisms(geometry)
    else:
        surfaces = [triangles_of(geometry, meshes)]
    map_from_shape = portable.product(pose_matrix(body), pose_matrix(shape))
    parts = tuple(one.moved(map_from_shape) for one in surfaces if len(one.triangles))
    if not parts:
        return None
    heights = np.concatenate([part.vertices_m[:, 2] for part in parts])
    return Obstruction(
        name=body.name,
        seen=bool(shape.material),
        solid=shape.solid,
        low_m=float(heights.min()),
        high_m=float(heights.max()),
        parts=parts,
        convex=not isinstance(geometry, Mesh),
    )


def _prisms(geometry: Polyline) -> list[TriangleMesh]:
    """Convex prisms that fill a raised polygon."""
    points, triangles = flat_triangles(polygons_of(geometry.polygons_m))
    sides = np.array([[0, 2, 1], [3, 4, 5], *_fence()], np.int32)
    prisms = []
    for triangle in triangles:
        flat = points[triangle]
        corners = np.concatenate(
            [np.column_stack([flat, np.full(3, z)]) for z in (0.0, geometry.height_m)]
        )
        prisms.append(TriangleMesh(corners, np.zeros((6, 3)), np.zeros((6, 2)), sides.copy()))
    return prisms


def _fence() -> list[list[int]]:
    return [
        side for a, b in ((0, 1), (1, 2), (2, 0)) for side in ([a, b, b + 3], [a, b + 3, a + 3])
    ]


def _hulls(points: Array) -> NDArray[np.object_]:
    """(n,) of shapely.Polygon: the convex hulls of n times k points, (n, k, 2)."""
    count, size, _ = points.shape
    clouds = shapely.multipoints(points.reshape(-1, 2), indices=np.repeat(np.arange(count), size))
    hulls = np.asarray(shapely.convex_hull(clouds), np.object_).reshape(-1)
    thin = shapely.area(hulls) < portable.square(_THIN_M)
    hulls[thin] = shapely.buffer(hulls[thin], _THIN_M, quad_segs=1)
    return hulls

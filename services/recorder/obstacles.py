"""What stands in a robot's way on the floor, as polygons in the map."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from services.common.documents import World
from services.common.frames import Array
from services.common.geometry import TriangleMesh, clipped, mesh_from_bytes, triangles_of
from services.common.surfaces import pose_matrix, wall_corners

FOOT_M, TOP_M = 0.02, 0.22
"""Heights above the floor between which a TurtleBot3 waffle meets things."""

_FEW = 5_000
"""Triangles of one mesh that are each taken as they are."""
_CELL_M = 0.05
"""What has more is taken in squares of this side."""


def read_meshes(world: World, assets: Mapping[str, bytes]) -> dict[str, TriangleMesh]:
    """The meshes of a world's bodies that are there and are meshes, by sha256."""
    meshes: dict[str, TriangleMesh] = {}
    for body in world.bodies:
        for shape in body.shapes:
            sha256 = shape.geometry.sha256 if shape.geometry.kind == "mesh" else ""
            if sha256 in assets and sha256 not in meshes:
                # What is no mesh is refused, and told of, by the simulation.
                with contextlib.suppress(ValueError):
                    meshes[sha256] = mesh_from_bytes(assets[sha256])
    return meshes


def obstacles(world: World, meshes: Mapping[str, TriangleMesh]) -> NDArray[np.object_]:
    """Polygons and lines of all that is solid and never moves; what moves may be out of the way.

    `meshes` are by sha256; one that is not there is left out.
    """
    walls = [*shapely.polygons(wall_corners(world.walls))] if world.walls else []
    return np.array([*walls, *_of_bodies(world, meshes)], object)


def _of_bodies(world: World, meshes: Mapping[str, TriangleMesh]) -> Iterator[Any]:
    for body in world.bodies:
        for shape in body.shapes:
            kind = shape.geometry.kind
            if body.mass_kg > 0.0 or not shape.solid:
                continue
            try:
                mesh = triangles_of(shape.geometry, meshes)
            except KeyError:
                continue
            mesh = mesh.moved(pose_matrix(body) @ pose_matrix(shape))
            cut = clipped(mesh, FOOT_M, TOP_M)
            corners = cut.vertices_m[cut.triangles][..., :2]
            if not len(corners):
                continue
            if kind in ("mesh", "polyline"):
                yield from _covered(corners)
            else:
                yield shapely.convex_hull(shapely.multipoints(corners.reshape(-1, 2)))


def _covered(corners: Array) -> Iterator[Any]:
    """The floor under (n, 3, 2) triangles; an upright one covers a line."""
    if len(corners) > _FEW:
        low, high = corners.min(axis=1), corners.max(axis=1)
        large = (high - low).max(axis=1) > _CELL_M
        points = np.concatenate([corners[~large], corners[~large].mean(axis=1, keepdims=True)], 1)
        cells = np.unique(np.floor(points.reshape(-1, 2) / _CELL_M), axis=0) * _CELL_M
        yield from shapely.box(*cells.T, *(cells + _CELL_M).T)
        corners = corners[large]
    # The hull of the same triangle is a line where it stands upright.
    corners = np.unique(np.round(corners, 4), axis=0)
    yield from shapely.convex_hull(shapely.multipoints(corners))

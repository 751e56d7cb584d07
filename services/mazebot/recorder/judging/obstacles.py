"""Obstacles on the robot's level, as polygons in the map."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.messages.documents import Thing, World
from mazebot.common.world.footprint import footprints
from mazebot.common.world.geometry import TriangleMesh, mesh_from_bytes

_FEW = 5_000
"""Up to this many polygons of one body are used individually."""
_CELL_M = 0.05
"""Beyond that, they are merged within squares of this side."""


def read_meshes(bodies: Iterable[Thing], assets: Mapping[str, bytes]) -> dict[str, TriangleMesh]:
    """The meshes of bodies whose assets are available and valid, by sha256."""
    meshes: dict[str, TriangleMesh] = {}
    for body in bodies:
        for shape in body.shapes:
            sha256 = shape.geometry.sha256 if shape.geometry.kind == "mesh" else ""
            if sha256 in assets and sha256 not in meshes:
                # An invalid mesh is refused, and reported, by the simulation.
                with contextlib.suppress(ValueError):
                    meshes[sha256] = mesh_from_bytes(assets[sha256])
    return meshes


def obstacles(
    world: World, meshes: Mapping[str, TriangleMesh], spawned: tuple[Thing, ...] = ()
) -> NDArray[np.object_]:
    """Polygons and lines of everything that is solid and static, in a world and `spawned` in it;
    moving bodies may be out of the way.

    `meshes` are by sha256; a body whose mesh is missing is left out.
    """
    bodies: tuple[Thing, ...] = (*world.bodies, *spawned)
    still = [body for body in bodies if not body.moves and _is_whole(body, meshes)]
    found: list[Any] = []
    for footprint in footprints(world.model_copy(update={"bodies": tuple(still)}), meshes):
        for stack in footprint.polygons_m:
            found += _covered(stack)
        if footprint.outline_m is not None:
            # The robot cannot drive into the area it winds around.
            found += shapely.linestrings(footprint.outline_m).tolist()
    return np.array(found, object)


def _is_whole(body: Thing, meshes: Mapping[str, TriangleMesh]) -> bool:
    shapes = [shape.geometry for shape in body.shapes]
    return all(shape.kind != "mesh" or shape.sha256 in meshes for shape in shapes)


def _covered(corners: Array) -> Iterator[Any]:
    """The floor under (n, k, 2) convex polygons; one that degenerates to a line yields a line."""
    if len(corners) > _FEW:
        low, high = corners.min(axis=1), corners.max(axis=1)
        large = (high - low).max(axis=1) > _CELL_M
        points = np.concatenate([corners[~large], corners[~large].mean(axis=1, keepdims=True)], 1)
        cells = np.unique(np.floor(points.reshape(-1, 2) / _CELL_M), axis=0) * _CELL_M
        yield from shapely.box(*cells.T, *(cells + _CELL_M).T)
        corners = corners[large]
    # The hull of a triangle is a line if the triangle is upright.
    corners = np.unique(np.round(corners, 4), axis=0)
    yield from shapely.convex_hull(shapely.multipoints(corners))

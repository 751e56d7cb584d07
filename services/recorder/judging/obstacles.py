"""What stands in a robot's way on the floor, as polygons in the map."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from services.common.frames import Array
from services.common.node.documents import Thing, World
from services.common.world.footprint import footprints
from services.common.world.geometry import TriangleMesh, mesh_from_bytes

_FEW = 5_000
"""Polygons of one thing that are each taken as they are."""
_CELL_M = 0.05
"""What has more is taken in squares of this side."""


def read_meshes(bodies: Iterable[Thing], assets: Mapping[str, bytes]) -> dict[str, TriangleMesh]:
    """The meshes of bodies that are there and are meshes, by sha256."""
    meshes: dict[str, TriangleMesh] = {}
    for body in bodies:
        for shape in body.shapes:
            sha256 = shape.geometry.sha256 if shape.geometry.kind == "mesh" else ""
            if sha256 in assets and sha256 not in meshes:
                # What is no mesh is refused, and told of, by the simulation.
                with contextlib.suppress(ValueError):
                    meshes[sha256] = mesh_from_bytes(assets[sha256])
    return meshes


def obstacles(
    world: World, meshes: Mapping[str, TriangleMesh], spawned: tuple[Thing, ...] = ()
) -> NDArray[np.object_]:
    """Polygons and lines of all that is solid and never moves, in a world and `spawned` in it; what
    moves may be out of the way.

    `meshes` are by sha256; a body of which one is not there is left out.
    """
    bodies: tuple[Thing, ...] = (*world.bodies, *spawned)
    still = [body for body in bodies if not body.moves and _is_whole(body, meshes)]
    found: list[Any] = []
    for footprint in footprints(world.model_copy(update={"bodies": tuple(still)}), meshes):
        for stack in footprint.polygons_m:
            found += _covered(stack)
        if footprint.outline_m is not None:
            # What it winds around cannot be driven into.
            found += shapely.linestrings(footprint.outline_m).tolist()
    return np.array(found, object)


def _is_whole(body: Thing, meshes: Mapping[str, TriangleMesh]) -> bool:
    shapes = [shape.geometry for shape in body.shapes]
    return all(shape.kind != "mesh" or shape.sha256 in meshes for shape in shapes)


def _covered(corners: Array) -> Iterator[Any]:
    """The floor under (n, k, 2) convex polygons; one as thin as a line covers a line."""
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

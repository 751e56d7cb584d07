"""Whether the robot has room where it is to stand, and on the way there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from services.common.documents import Planar, World
from services.common.footprint import Footprint, footprints
from services.common.frames import Array
from services.common.geometry import TriangleMesh
from services.common.grids import connected_regions, distance_cells
from services.worldgen.occupancy import Grid, grid_of, occupied_cells

ROBOT_RADIUS_M = 0.24
"""Of a TurtleBot3 waffle as a disc, 0.22 m, and 2 cm to spare."""

_FINE_M = 0.02
_MAX_CELLS = 2e6


def clear_m(taken: Sequence[Footprint], places: Sequence[Planar]) -> list[float]:
    """Distance from each place to the nearest edge of a footprint; infinite where there is none."""
    edges = [
        np.stack([stack, np.roll(stack, -1, axis=1)], axis=2).reshape(-1, 2, 2)
        for one in taken
        for stack in one.polygons_m
    ]
    edges += [one.outline_m for one in taken if one.outline_m is not None]
    segments = np.concatenate(edges) if edges else np.empty((0, 2, 2))
    return [_distance_m(segments, np.array([place.x_m, place.y_m])) for place in places]


def cannot_be_reached(
    world: World, meshes: Mapping[str, TriangleMesh], places: Sequence[Planar]
) -> list[bool]:
    """For each place whether no way leads there that is wide enough for the robot.

    Judged on cells of 2 cm, coarser in large worlds, in favour of the way: by up to one and a half
    of a cell's side. `meshes` are by sha256.
    """
    grid, distance_m = _distances(world, meshes)
    regions = connected_regions(distance_m >= ROBOT_RADIUS_M - 1.5 * grid.resolution_m)
    found = []
    start = grid.cell(world.start.x_m, world.start.y_m)
    for place in places:
        cell = grid.cell(place.x_m, place.y_m)
        found.append(start is None or cell is None or regions[cell] != regions[start])
    return found


def nearest_place(world: World, meshes: Mapping[str, TriangleMesh]) -> Planar:
    """The world's start where the robot has room there; else the place nearest to it where it has,
    within walls if there is such a place.

    Where there is room nowhere it is the start all the same. `meshes` are by sha256.
    """
    grid, distance_m = _distances(world, meshes)
    side_m, start = grid.resolution_m, world.start
    room = distance_m >= ROBOT_RADIUS_M + side_m
    cell = grid.cell(start.x_m, start.y_m)
    if not room.any() or (cell is not None and room[cell]):
        return start
    regions = connected_regions(room)
    edge = np.concatenate([regions[0], regions[-1], regions[:, 0], regions[:, -1]])
    within = room & ~np.isin(regions, edge)
    rows, columns = np.nonzero(within if within.any() else room)
    x_m = grid.origin.x_m + (columns + 0.5) * side_m
    y_m = grid.origin.y_m + (rows + 0.5) * side_m
    nearest = int(np.argmin((x_m - start.x_m) ** 2 + (y_m - start.y_m) ** 2))
    # Rounded to what people would write; there is more room than that.
    place = {"x_m": round(float(x_m[nearest]), 3), "y_m": round(float(y_m[nearest]), 3)}
    return start.model_copy(update=place)


def _distances(world: World, meshes: Mapping[str, TriangleMesh]) -> tuple[Grid, Array]:
    """A grid of 2 cm, coarser in large worlds, and from each cell to the nearest solid one."""
    walls = grid_of(world, meshes)
    area_m2 = walls.rows * walls.columns * walls.resolution_m**2
    side_m = max(_FINE_M, math.sqrt(area_m2 / _MAX_CELLS))
    grid = grid_of(world.model_copy(update={"map_resolution_m": side_m}), meshes)
    occupied = occupied_cells(footprints(world, meshes), grid)
    return grid, distance_cells(occupied) * side_m


def _distance_m(segments: Array, point: Array) -> float:
    """From a point to the nearest of (n, 2, 2) segments."""
    if not len(segments):
        return math.inf
    start, step = segments[:, 0], segments[:, 1] - segments[:, 0]
    length_2 = (step**2).sum(1)
    along = ((point - start) * step).sum(1) / np.where(length_2 > 0.0, length_2, 1.0)
    nearest = start + along.clip(0.0, 1.0)[:, None] * step
    return float(np.hypot(*(nearest - point).T).min())

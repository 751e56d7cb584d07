"""A world to an occupancy map.

A cell is occupied where something solid on the robot's level reaches into it, however little: a
lidar's hit on a wall then always falls into an occupied cell, as in a map made by SLAM, and no
planner sees a gap wider than it is. Free is the floor that is connected, over the sides of cells,
to the start; all else is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.common.documents import World
from services.common.footprint import Footprint, footprints
from services.common.frames import SE2, Array
from services.common.geometry import TriangleMesh
from services.common.grids import connected_regions

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
MARGIN_M = 1.0
MAX_CELLS = 16_000_000

_TOUCH_M = 1e-6
"""What reaches into a cell by less only touches it."""
_BATCH = 1_000_000
"""Corners of polygons worked on at a time."""


@dataclass(frozen=True)
class Grid:
    """Where a map's cells lie: row 0 at the smallest y."""

    rows: int
    columns: int
    resolution_m: float
    origin: SE2
    """map_from_grid, of the corner of cell (0, 0)."""

    def cell(self, x_m: float, y_m: float) -> tuple[int, int] | None:
        """(row, column) of a point in the map; None outside the grid."""
        if self.origin.yaw_rad:
            x_m, y_m, _ = self.origin.inverse() @ SE2(x_m, y_m, 0.0)
        else:
            x_m, y_m = x_m - self.origin.x_m, y_m - self.origin.y_m
        column, row = math.floor(x_m / self.resolution_m), math.floor(y_m / self.resolution_m)
        inside = 0 <= row < self.rows and 0 <= column < self.columns
        return (row, column) if inside else None


def grid_of(world: World, meshes: Mapping[str, TriangleMesh], margin_m: float = MARGIN_M) -> Grid:
    """The grid around everything solid on the robot's level, of the world's resolution.

    Its origin lies on multiples of the resolution. Where there are no walls the floor is open, and
    the start and the locations are within it too. `meshes` are by sha256.

    Raises ValueError with a phrase where it has more than MAX_CELLS, KeyError where a mesh is not
    there.
    """
    points = [
        stack.reshape(-1, 2) for taken in footprints(world, meshes) for stack in taken.polygons_m
    ]
    if not world.walls:
        places = (world.start, *world.locations)
        points.append(np.array([(place.x_m, place.y_m) for place in places]))
    corners = np.concatenate(points)
    return grid_around(corners.min(0), corners.max(0), world.map_resolution_m, margin_m)


def grid_around(low_m: Array, high_m: Array, resolution_m: float, margin_m: float) -> Grid:
    """The grid around what reaches from `low_m` to `high_m`, (x, y) each.

    Raises ValueError with a phrase where it has more than MAX_CELLS.
    """
    first = [math.floor((float(value) - margin_m) / resolution_m) for value in low_m]
    last = [math.ceil((float(value) + margin_m) / resolution_m) for value in high_m]
    columns, rows = last[0] - first[0], last[1] - first[1]
    if rows * columns > MAX_CELLS:
        raise ValueError(
            f"makes {columns} x {rows} cells: must be coarser, or things closer together, "
            f"for at most {MAX_CELLS} cells"
        )
    return Grid(
        rows, columns, resolution_m, SE2(first[0] * resolution_m, first[1] * resolution_m, 0.0)
    )


def rasterise(polygons_m: Iterable[Array], grid: Grid) -> NDArray[np.bool_]:
    """(rows, columns) of bool: the cells that a convex polygon reaches into.

    `polygons_m` are stacks of polygons as Footprint has them.
    """
    # +1 at the first column of each run of cells in a row, -1 after its last.
    runs = np.zeros((grid.rows, grid.columns + 1), np.int32)
    alike: dict[int, list[Array]] = {}
    for one in polygons_m:
        alike.setdefault(one.shape[1], []).append(one)
    for stack in map(np.concatenate, alike.values()):
        corners = _in_cells(stack, grid)
        touch = _TOUCH_M / grid.resolution_m
        low = np.floor(corners[..., 1].min(1) + touch).clip(0, grid.rows).astype(np.int64)
        high = np.ceil(corners[..., 1].max(1) - touch).clip(0, grid.rows).astype(np.int64)
        # A line along a row has to be in it.
        for first, last in _batches(high - low, max(1, _BATCH // stack.shape[1])):
            count = (high - low)[first:last].clip(0)
            which = np.repeat(np.arange(first, last), count)
            row = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + low[which]
            left, right = _extent(corners[which], row + touch, row + 1 - touch)
            start = np.floor(left + touch).clip(0, grid.columns).astype(np.int64)
            end = np.ceil(right - touch).clip(0, grid.columns).astype(np.int64)
            there = end > start
            np.add.at(runs, (row[there], start[there]), 1)
            np.add.at(runs, (row[there], end[there]), -1)
    return np.asarray(np.cumsum(runs, axis=1)[:, :-1] > 0)


def fill(outline_m: Array, grid: Grid) -> NDArray[np.bool_]:
    """(rows, columns) of bool: the cells whose centres closed loops of (n, 2, 2) directed segments
    wind around.
    """
    turns = np.zeros((grid.rows, grid.columns + 1), np.int32)
    start, end = np.moveaxis(_in_cells(outline_m, grid), 1, 0) - 0.5
    # Row r's centres lie at r in these, and so do the columns'.
    low = np.ceil(np.minimum(start[:, 1], end[:, 1])).clip(0, grid.rows).astype(np.int64)
    high = np.ceil(np.maximum(start[:, 1], end[:, 1])).clip(0, grid.rows).astype(np.int64)
    for first, last in _batches(high - low, _BATCH):
        count = (high - low)[first:last]
        which = np.repeat(np.arange(first, last), count)
        row = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + low[which]
        a, b = start[which], end[which]
        x = a[:, 0] + (row - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
        column = np.ceil(x).clip(0, grid.columns).astype(np.int64)
        np.add.at(turns, (row, column), np.where(b[:, 1] > a[:, 1], 1, -1))
    return np.asarray(np.cumsum(turns, axis=1)[:, :-1] != 0)


def occupied_cells(taken: Sequence[Footprint], grid: Grid) -> NDArray[np.bool_]:
    """(rows, columns) of bool: the cells that footprints reach into."""
    occupied = rasterise([stack for one in taken for stack in one.polygons_m], grid)
    for one in taken:
        if one.outline_m is not None and len(one.outline_m):
            occupied |= fill(one.outline_m, grid)
    return occupied


def occupancy(world: World, meshes: Mapping[str, TriangleMesh], grid: Grid) -> NDArray[np.int8]:
    """(rows, columns) of int8: 100 what is solid, 0 the floor connected to the start, -1 all else.

    There is no floor where the start is not in the grid or not free. `meshes` are by sha256.
    Raises KeyError where one is not there.
    """
    occupied = occupied_cells(footprints(world, meshes), grid)
    cells = np.full(occupied.shape, UNKNOWN, np.int8)
    start = grid.cell(world.start.x_m, world.start.y_m)
    if start is not None and not occupied[start]:
        rooms = connected_regions(~occupied)
        cells[rooms == rooms[start]] = FREE
    cells[occupied] = OCCUPIED
    return cells


def _in_cells(points_m: Array, grid: Grid) -> Array:
    """Points in the map, in cells from the grid's corner."""
    if grid.origin.yaw_rad:
        c, s = math.cos(grid.origin.yaw_rad), math.sin(grid.origin.yaw_rad)
        points_m = (points_m - grid.origin[:2]) @ np.array([[c, -s], [s, c]])
    else:
        points_m = points_m - grid.origin[:2]
    return np.asarray(points_m / grid.resolution_m)


def _batches(count: NDArray[np.int64], most: int) -> Iterable[tuple[int, int]]:
    """Ranges of items of which the counts add up to about `most`."""
    total = np.cumsum(count.clip(0))
    first = 0
    while first < len(count):
        done = total[first - 1] if first else 0
        last = max(first + 1, int(np.searchsorted(total, done + most, "right")))
        yield first, last
        first = last


def _extent(corners: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Smallest and largest x of (n, k, 2) convex polygons between two values of y each."""
    x, y = corners[..., 0], corners[..., 1]
    low, high = low[:, None], high[:, None]
    inside = (y >= low) & (y <= high)
    left = np.where(inside, x, np.inf).min(1)
    right = np.where(inside, x, -np.inf).max(1)
    next_x, next_y = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    for level in (low, high):
        across = (y < level) != (next_y < level)
        rise = np.where(across, next_y - y, 1.0)
        at = x + (level - y) / rise * (next_x - x)
        left = np.minimum(left, np.where(across, at, np.inf).min(1))
        right = np.maximum(right, np.where(across, at, -np.inf).max(1))
    return left, right

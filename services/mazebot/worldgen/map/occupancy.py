"""Converts a world to an occupancy map.

A cell is occupied if anything solid on the robot's level overlaps it, however little: a lidar's
hit on a wall is then always in an occupied cell, as in a map made by SLAM, and no planner sees a
gap wider than it is. Free is the floor that is connected, over the sides of cells, to the start;
all else is unknown. The floor itself is infinite, as Gazebo's ground planes are: where it is open
the map extends for some metres around all entities on it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.documents import Planar, World
from mazebot.common.world.costmap import FREE, MAX_CELLS, OCCUPIED, UNKNOWN
from mazebot.common.world.footprint import Footprint, footprints
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.grids import connected_regions

MARGIN_M = 1.0
OPEN_MARGIN_M = 10.0
"""Margin of floor on the map around the entities on open floor."""
OPEN_CELLS = 1_000_000
"""The margin of open floor is reduced, down to MARGIN_M, to keep the map below this many cells."""

_TOUCH_M = 1e-6
"""Smaller overlaps with a cell are ignored."""
_ON_BOUNDARY = 0.02
"""A face this near to a cell's boundary, in cells, counts as on it."""
_BATCH = 1_000_000
"""Polygon corners processed at a time."""


@dataclass(frozen=True)
class Grid:
    """Position of a map's cells: row 0 at the smallest y."""

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
    """The grid around everything solid on the robot's level, with the world's resolution.

    Its origin is on multiples of the resolution, or half a cell beside them: see `_phase_m`.
    Without walls the floor is open, and the grid includes the start and the locations too.
    `meshes` are by sha256.

    Raises ValueError with a phrase if it has more than MAX_CELLS, KeyError if a mesh is
    missing.
    """
    return _grid(world, footprints(world, meshes), margin_m)


def grid_around(
    low_m: Array,
    high_m: Array,
    resolution_m: float,
    margin_m: float,
    phase_m: tuple[float, float] = (0.0, 0.0),
) -> Grid:
    """The grid around the range `low_m` to `high_m`, (x, y) each. Its origin is on multiples of the
    resolution, moved by `phase_m`.

    Raises ValueError with a phrase if it has more than MAX_CELLS.
    """
    first, last = [], []
    for low, high, phase in zip(low_m, high_m, phase_m, strict=True):
        first.append(math.floor((float(low) - phase - margin_m) / resolution_m))
        last.append(math.ceil((float(high) - phase + margin_m) / resolution_m))
    columns, rows = last[0] - first[0], last[1] - first[1]
    if rows * columns > MAX_CELLS:
        raise ValueError(
            f"makes {columns} x {rows} cells: must be coarser, or things closer together, "
            f"for at most {MAX_CELLS} cells"
        )
    corner = (first[0] * resolution_m + phase_m[0], first[1] * resolution_m + phase_m[1])
    return Grid(rows, columns, resolution_m, SE2(*corner, 0.0))


def floor_map(world: World, meshes: Mapping[str, TriangleMesh]) -> tuple[Grid, NDArray[np.int8]]:
    """The map of a world and its grid: the result of `occupancy` on the grid around everything
    solid, or on a wider one if the floor connected to the start is open.

    Raises as `grid_of` does.
    """
    taken = footprints(world, meshes)
    grid = _grid(world, taken, MARGIN_M)
    cells = _occupancy(taken, grid, world.start)
    edge = np.concatenate([cells[0], cells[-1], cells[:, 0], cells[:, -1]])
    if not (edge == FREE).any() and grid.cell(world.start.x_m, world.start.y_m) is not None:
        return grid, cells
    width_m, height_m = grid.columns * grid.resolution_m, grid.rows * grid.resolution_m
    # The margin m for which (width + 2 m) (height + 2 m) reaches the limit.
    room_m2 = OPEN_CELLS * portable.square(grid.resolution_m) - width_m * height_m
    sides_m = (width_m + height_m) / 2.0
    more_m = (math.sqrt(max(0.0, portable.square(sides_m) + room_m2)) - sides_m) / 2.0
    margin_m = min(OPEN_MARGIN_M, MARGIN_M + max(0.0, more_m))
    grid = _grid(world, taken, margin_m)
    return grid, _occupancy(taken, grid, world.start)


def _grid(world: World, taken: Sequence[Footprint], margin_m: float) -> Grid:
    points = [stack.reshape(-1, 2) for one in taken for stack in one.polygons_m]
    if not world.walls:
        places = (world.start, *world.locations)
        points.append(np.array([(place.x_m, place.y_m) for place in places]))
    corners = np.concatenate(points)
    resolution_m = world.map_resolution_m
    phase_m = _phase_m(taken, resolution_m, 0), _phase_m(taken, resolution_m, 1)
    return grid_around(corners.min(0), corners.max(0), resolution_m, margin_m, phase_m)


def _phase_m(taken: Sequence[Footprint], resolution_m: float, axis: int) -> float:
    """Half a cell if most faces across an axis, by length, are on cell boundaries; else 0.

    Localisation assumes faces in the middle of their cells, as is true on average. On a boundary
    each would be half a cell off, and all of them to the same side.
    """
    total_m = on_boundary_m = 0.0
    for stack in (stack for one in taken for stack in one.polygons_m):
        along = np.abs(np.roll(stack, -1, axis=1) - stack)
        across = (along[..., axis] < _TOUCH_M) & (along[..., 1 - axis] > _TOUCH_M)
        length_m = along[..., 1 - axis][across]
        place = stack[..., axis][across] / resolution_m
        on_boundary = np.abs(place - np.rint(place)) < _ON_BOUNDARY
        total_m += float(length_m.sum())
        on_boundary_m += float(length_m[on_boundary].sum())
    return resolution_m / 2.0 if on_boundary_m > total_m / 2.0 else 0.0


def rasterise(polygons_m: Iterable[Array], grid: Grid) -> NDArray[np.bool_]:
    """(rows, columns) of bool: the cells that convex polygons overlap.

    `polygons_m` are stacks of polygons as in Footprint.
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
        # A line along a row must be within that row.
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
    """(rows, columns) of bool: the cells whose centres are enclosed by closed loops of (n, 2, 2)
    directed segments.
    """
    turns = np.zeros((grid.rows, grid.columns + 1), np.int32)
    start, end = np.moveaxis(_in_cells(outline_m, grid), 1, 0) - 0.5
    # In these coordinates row r's centres are at r, and likewise for columns.
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
    """(rows, columns) of bool: the cells that footprints overlap."""
    occupied = rasterise([stack for one in taken for stack in one.polygons_m], grid)
    for one in taken:
        if one.outline_m is not None and len(one.outline_m):
            occupied |= fill(one.outline_m, grid)
    return occupied


def occupancy(world: World, meshes: Mapping[str, TriangleMesh], grid: Grid) -> NDArray[np.int8]:
    """(rows, columns) of int8: 100 solid, 0 floor connected to the start, -1 all else.

    There is no floor if the start is not in the grid or not free. `meshes` are by sha256.
    Raises KeyError if one is missing.
    """
    return _occupancy(footprints(world, meshes), grid, world.start)


def _occupancy(taken: Sequence[Footprint], grid: Grid, start: Planar) -> NDArray[np.int8]:
    occupied = occupied_cells(taken, grid)
    cells = np.full(occupied.shape, UNKNOWN, np.int8)
    at = grid.cell(start.x_m, start.y_m)
    if at is not None and not occupied[at]:
        rooms = connected_regions(~occupied)
        cells[rooms == rooms[at]] = FREE
    cells[occupied] = OCCUPIED
    return cells


def _in_cells(points_m: Array, grid: Grid) -> Array:
    """Points in the map, in cells from the grid's corner."""
    if grid.origin.yaw_rad:
        c, s = portable.cos_sin(grid.origin.yaw_rad)
        points_m = portable.product(points_m - grid.origin[:2], np.array([[c, -s], [s, c]]))
    else:
        points_m = points_m - grid.origin[:2]
    return np.asarray(points_m / grid.resolution_m)


def _batches(count: NDArray[np.int64], most: int) -> Iterable[tuple[int, int]]:
    """Ranges of items whose counts add up to about `most`."""
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

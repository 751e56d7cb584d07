"""The occupancy grid: log-odds of cells, by the rays of the keyframes' scans.

A cell is updated by each scan at most once, and by an end of a beam before any ray that passes
it, so that grazing rays do not wear off walls.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.grids import connected_regions
from mazebot.mapping.matching.scan_points import ScanPoints, moved

HIT, MISS, LIMIT = 0.85, -0.4, 3.5
"""Log-odds that one scan adds to a cell, and the most that all may."""
_CHUNK = 64
"""The grid grows by whole chunks of so many cells."""
MAX_CELLS = 25_000_000
"""A grid that would grow beyond this leaves out what lies outside."""
UNKNOWN, FREE, OCCUPIED = -1, 0, 100
_BEHIND_M = 0.3
"""A return is behind a wall that its beam meets so long before it ends."""
_FOLLOWED = 180
"""About so many beams say enough."""
_CROSSINGS = 3
"""So many beams through something say that it is not there."""
_COARSE_M = 0.2
"""Twice as far as what is near to a line and fits."""
_SHOWN_M = 0.12
"""A return so near to something shows it."""


@dataclass(frozen=True)
class MapGrid:
    """An occupancy map as the bus and Nav2 have it."""

    cells: NDArray[np.int8]
    """(rows, columns) 0 free, 100 occupied, -1 unknown; row 0 at the smallest y"""
    resolution_m: float
    origin: SE2
    """map_from_grid, of the corner of cell (0, 0)"""


class Occupancy:
    """A grid that grows with the scans; its cells begin at multiples of the resolution."""

    def __init__(self, resolution_m: float) -> None:
        self._resolution_m = resolution_m
        self._row0 = self._column0 = 0
        self._log_odds: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._seen: NDArray[np.int32] = np.zeros((0, 0), np.int32)
        """Number of the scan that last saw a cell; 0: none did."""
        self._scans = 0

    def clear(self) -> None:
        """Forget all scans; the extent stays."""
        self._log_odds[:] = 0.0
        self._seen[:] = 0
        self._scans = 0

    def rebuild(self, keyframes: Iterable[tuple[SE2, ScanPoints]]) -> None:
        """Start again with these keyframes: map_from_base and what was seen there."""
        self.clear()
        for map_from_base, seen in keyframes:
            self.add(map_from_base, seen)

    def add(self, map_from_base: SE2, seen: ScanPoints) -> None:
        """Add a scan."""
        cells_per_m = 1.0 / self._resolution_m
        sensor = map_from_base @ seen.sensor
        ends = np.concatenate([seen.points_m, seen.misses_m])
        moved = np.empty((len(ends), 2))
        low, high = np.empty(2), np.empty(2)
        _to_cells(
            ends, map_from_base.x_m, map_from_base.y_m, map_from_base.yaw_rad, cells_per_m,
            sensor.x_m * cells_per_m, sensor.y_m * cells_per_m, moved, low, high,
        )  # fmt: skip
        if not self._grow(low, high):
            return
        self._scans += 1
        _trace(
            self._log_odds, self._seen, self._scans, self._row0, self._column0,
            sensor.x_m * cells_per_m, sensor.y_m * cells_per_m, moved, len(seen.points_m),
        )  # fmt: skip

    def grid(self) -> MapGrid:
        """The map as far as it was seen, with a margin of one cell; one unknown cell at least."""
        resolution_m = self._resolution_m
        seen = self._seen > 0
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if not len(rows):
            return MapGrid(np.full((1, 1), UNKNOWN, np.int8), resolution_m, SE2(0.0, 0.0, 0.0))
        row, column = int(rows[0]), int(columns[0])
        window = np.s_[row : int(rows[-1]) + 1, column : int(columns[-1]) + 1]
        cells = np.full(np.array(seen[window].shape) + 2, UNKNOWN, np.int8)
        cells[1:-1, 1:-1] = np.where(
            seen[window], np.where(self._log_odds[window] > 0.0, OCCUPIED, FREE), UNKNOWN
        )
        origin = SE2(
            (self._column0 + column - 1) * resolution_m,
            (self._row0 + row - 1) * resolution_m,
            0.0,
        )
        return MapGrid(cells, resolution_m, origin)

    def _grow(self, low: Array, high: Array) -> bool:
        """Make room for cells from low to high (column, row); False where it would be too large."""
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            return False
        rows, columns = self._log_odds.shape
        column0, row0 = (math.floor(value / _CHUNK) * _CHUNK for value in (low - 1.0).tolist())
        column1, row1 = (-math.floor(-value / _CHUNK) * _CHUNK for value in (high + 2.0).tolist())
        if rows:
            row0, column0 = min(row0, self._row0), min(column0, self._column0)
            row1, column1 = max(row1, self._row0 + rows), max(column1, self._column0 + columns)
        if (row1 - row0, column1 - column0) == (rows, columns):
            return True
        if (row1 - row0) * (column1 - column0) > MAX_CELLS:
            return False
        log_odds = np.zeros((row1 - row0, column1 - column0), np.float32)
        seen = np.zeros(log_odds.shape, np.int32)
        if rows:
            row, column = self._row0 - row0, self._column0 - column0
            log_odds[row : row + rows, column : column + columns] = self._log_odds
            seen[row : row + rows, column : column + columns] = self._seen
        self._row0, self._column0, self._log_odds, self._seen = row0, column0, log_odds, seen
        return True


@dataclass(frozen=True)
class Structures:
    """What stands in a map, each thing for itself: that of which a scan shows nothing, although
    its beams go through it, was there only for a while.
    """

    grid: MapGrid
    regions: NDArray[np.int32]
    """(rows, columns) number of the thing that a cell belongs to; 0: none."""

    @classmethod
    def of(cls, grid: MapGrid) -> Structures:
        """Of a map."""
        return cls(grid, connected_regions(grid.cells == OCCUPIED, diagonally=True))

    def gone(self, map_from_base: SE2, seen: ScanPoints) -> int:
        """How many things a scan shows to be gone."""
        grid_from_base = self.grid.origin.inverse() @ map_from_base
        count = int(self.regions.max(initial=0)) + 1
        shown, crossings = np.zeros(count, np.bool_), np.zeros(count, np.int64)
        ends_m = np.concatenate([seen.points_m, seen.misses_m])
        _cross(
            self.regions, moved(ends_m, grid_from_base), len(seen.points_m),
            *(grid_from_base @ seen.sensor)[:2], self.grid.resolution_m, shown, crossings,
        )  # fmt: skip
        shown[0] = True
        return int(np.count_nonzero((crossings >= _CROSSINGS) & ~shown))

    def without_new(self, map_from_base: SE2, seen: ScanPoints) -> ScanPoints:
        """A scan without returns where the map is free: of what comes and goes."""
        is_new = _cells_at(self.grid, map_from_base, seen.points_m) == FREE
        return replace(seen, points_m=np.ascontiguousarray(seen.points_m[~is_new]))


@kernel(
    "void(int32[:, ::1], float64[:, ::1], int64, float64, float64, float64, boolean[::1], "
    "int64[::1])"
)
def _cross(
    regions: NDArray[np.int32],
    ends_m: Array,
    hits: int,
    sensor_x_m: float,
    sensor_y_m: float,
    resolution_m: float,
    shown: NDArray[np.bool_],
    crossings: NDArray[np.int64],
) -> None:
    """Which regions returns are next to, and how many beams go through each."""
    rows, columns = regions.shape
    reach = math.ceil(_SHOWN_M / resolution_m)
    for i in range(ends_m.shape[0]):
        if i < hits:
            column = math.floor(ends_m[i, 0] / resolution_m)
            row = math.floor(ends_m[i, 1] / resolution_m)
            for r in range(max(0, row - reach), min(rows, row + reach + 1)):
                for c in range(max(0, column - reach), min(columns, column + reach + 1)):
                    shown[regions[r, c]] = True
        dx, dy = ends_m[i, 0] - sensor_x_m, ends_m[i, 1] - sensor_y_m
        length_m = math.sqrt(dx * dx + dy * dy)
        steps = math.floor((length_m - _BEHIND_M) / (0.5 * resolution_m))
        last = 0
        for step in range(1, steps):
            along = step * 0.5 * resolution_m / length_m
            r = math.floor((sensor_y_m + along * dy) / resolution_m)
            c = math.floor((sensor_x_m + along * dx) / resolution_m)
            if 0 <= r < rows and 0 <= c < columns:
                region = regions[r, c]
                if region and region != last:
                    crossings[region] += 1
                    last = region


@kernel(
    "void(float64[:, ::1], float64, float64, float64, float64, float64, float64, "
    "float64[:, ::1], float64[::1], float64[::1])"
)
def _to_cells(
    points: Array, x: float, y: float, yaw: float, cells_per_m: float, sensor_x: float,
    sensor_y: float, moved: Array, low: Array, high: Array,
) -> None:  # fmt: skip
    """Ends of beams in cells of the map, and their extent with the sensor's."""
    c, s = portable_kernels.cos_sin(yaw)
    low[0] = high[0] = sensor_x
    low[1] = high[1] = sensor_y
    for i in range(points.shape[0]):
        u = (x + c * points[i, 0] - s * points[i, 1]) * cells_per_m
        v = (y + s * points[i, 0] + c * points[i, 1]) * cells_per_m
        moved[i, 0], moved[i, 1] = u, v
        low[0], low[1] = min(low[0], u), min(low[1], v)
        high[0], high[1] = max(high[0], u), max(high[1], v)


@kernel(
    "void(float32[:, ::1], int32[:, ::1], int64, int64, int64, float64, float64, "
    "float64[:, ::1], int64)"
)
def _trace(
    log_odds: NDArray[np.float32],
    seen: NDArray[np.int32],
    scan: int,
    row0: int,
    column0: int,
    sensor_x: float,
    sensor_y: float,
    ends: Array,
    hits: int,
) -> None:
    for i in range(hits):
        column, row = math.floor(ends[i, 0]) - column0, math.floor(ends[i, 1]) - row0
        if seen[row, column] != scan:
            seen[row, column] = scan
            log_odds[row, column] = min(log_odds[row, column] + HIT, LIMIT)
    for i in range(ends.shape[0]):
        # From cell to cell along the ray (Amanatides, Woo, 1987), up to the cell where it ended.
        dx, dy = ends[i, 0] - sensor_x, ends[i, 1] - sensor_y
        length = math.sqrt(dx * dx + dy * dy)
        if length < 1e-9:
            continue
        dx, dy = dx / length, dy / length
        column, row = math.floor(sensor_x), math.floor(sensor_y)
        last_column, last_row = math.floor(ends[i, 0]), math.floor(ends[i, 1])
        step_x = 1 if dx > 0.0 else -1
        step_y = 1 if dy > 0.0 else -1
        inverse_x = 1.0 / abs(dx) if abs(dx) > 1e-12 else 1e12
        inverse_y = 1.0 / abs(dy) if abs(dy) > 1e-12 else 1e12
        next_x = (column + 1 - sensor_x if dx > 0.0 else sensor_x - column) * inverse_x
        next_y = (row + 1 - sensor_y if dy > 0.0 else sensor_y - row) * inverse_y
        along = 0.0
        while along < length and not (column == last_column and row == last_row):
            r, c = row - row0, column - column0
            if seen[r, c] != scan:
                seen[r, c] = scan
                log_odds[r, c] = max(log_odds[r, c] + MISS, -LIMIT)
            if next_x < next_y:
                along = next_x
                next_x += inverse_x
                column += step_x
            else:
                along = next_y
                next_y += inverse_y
                row += step_y


def share_behind_walls(
    grid: MapGrid, map_from_base: SE2, returns_m: Array, base_from_scan: SE2
) -> float:
    """The share of returns (n, 2), in base_footprint, that come from behind a wall of the map, and
    are none of its walls themselves.
    """
    if not len(returns_m):
        return 0.0
    returns_m = returns_m[:: max(1, len(returns_m) // _FOLLOWED)]
    grid_from_base = grid.origin.inverse() @ map_from_base
    eye_m = np.array((grid_from_base @ base_from_scan)[:2])
    beams_m = moved(returns_m, grid_from_base) - eye_m
    lengths_m = portable.lengths(beams_m)
    directions = beams_m / np.maximum(lengths_m, 1e-9)[:, None]
    along_m = np.arange(0.0, float(lengths_m.max()) + _BEHIND_M, grid.resolution_m / 2.0)
    places_m = eye_m + directions[:, None] * along_m[:, None]
    columns, rows = np.moveaxis(np.floor(places_m / grid.resolution_m).astype(np.int64), 2, 0)
    inside = (rows >= 0) & (rows < grid.cells.shape[0])
    inside &= (columns >= 0) & (columns < grid.cells.shape[1])
    wall = np.zeros(inside.shape, np.bool_)
    wall[inside] = grid.cells[rows[inside], columns[inside]] == OCCUPIED
    beyond_m = along_m - lengths_m[:, None]
    is_wall = (wall & (np.abs(beyond_m) <= _BEHIND_M / 2.0)).any(axis=1)
    behind = (wall & (beyond_m < -_BEHIND_M)).any(axis=1) & ~is_wall
    return float(behind.mean())


def coarse_grid(keyframes: Iterable[tuple[SE2, ScanPoints]], resolution_m: float) -> MapGrid:
    """The map of keyframes, map_from_base and what was seen there, in cells of this side or larger
    ones, whose walls are as wide as returns scatter.
    """
    occupancy = Occupancy(max(resolution_m, _COARSE_M))
    occupancy.rebuild(keyframes)
    return occupancy.grid()


def share_contradicted(grid: MapGrid, map_from_base: SE2, seen: ScanPoints) -> float:
    """The share of a scan's returns that lie where the map is free, and of those that come from
    behind its walls, together: up to 2.
    """
    free = share_in_free(grid, map_from_base, seen.points_m)
    return free + share_behind_walls(grid, map_from_base, seen.points_m, seen.sensor)


def share_in_free(grid: MapGrid, map_from_base: SE2, returns_m: Array) -> float:
    """The share of returns (n, 2), in base_footprint, that lie where the map is free."""
    if not len(returns_m):
        return 0.0
    return float((_cells_at(grid, map_from_base, returns_m) == FREE).mean())


def _cells_at(grid: MapGrid, map_from_base: SE2, points_m: Array) -> NDArray[np.int8]:
    """(n,) the map's values at points (n, 2) in base_footprint; unknown beyond it."""
    places_m = moved(points_m, grid.origin.inverse() @ map_from_base)
    columns, rows = np.floor(places_m / grid.resolution_m).astype(np.int64).T
    inside = (rows >= 0) & (rows < grid.cells.shape[0])
    inside &= (columns >= 0) & (columns < grid.cells.shape[1])
    values = np.full(len(points_m), UNKNOWN, np.int8)
    values[inside] = grid.cells[rows[inside], columns[inside]]
    return values

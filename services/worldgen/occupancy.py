"""Walls to an occupancy map.

A cell is occupied where a wall reaches into it, however little: a lidar's hit on a wall then always
falls into an occupied cell, as in a map made by SLAM, and no planner sees a gap wider than it is.
Free is the floor that is connected, over the sides of cells, to the start; all else is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from services.common.documents import Wall
from services.common.frames import SE2

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
MARGIN_M = 1.0
MAX_CELLS = 16_000_000

_TOUCH_M = 1e-6
"""A wall that reaches into a cell by less only touches it."""


class Grid:
    """Where a map's cells lie: row 0 at the smallest y, the origin on multiples of resolution."""

    def __init__(
        self, walls: Iterable[Wall], resolution_m: float, margin_m: float = MARGIN_M
    ) -> None:
        corners = [corner for wall in walls for corner in wall_corners(wall)]
        low = [min(c[axis] for c in corners) - margin_m for axis in (0, 1)]
        high = [max(c[axis] for c in corners) + margin_m for axis in (0, 1)]
        first = [math.floor(value / resolution_m) for value in low]
        last = [math.ceil(value / resolution_m) for value in high]
        self.resolution_m = resolution_m
        self.columns, self.rows = last[0] - first[0], last[1] - first[1]
        self.origin = SE2(first[0] * resolution_m, first[1] * resolution_m, 0.0)

    def cell(self, x_m: float, y_m: float) -> tuple[int, int] | None:
        """(row, column) of a point; None outside the map."""
        column = math.floor((x_m - self.origin.x_m) / self.resolution_m)
        row = math.floor((y_m - self.origin.y_m) / self.resolution_m)
        inside = 0 <= row < self.rows and 0 <= column < self.columns
        return (row, column) if inside else None


def wall_corners(wall: Wall) -> list[tuple[float, float]]:
    """The four corners of a wall's footprint, counter-clockwise."""
    x, y = wall.length_m / 2.0, wall.thickness_m / 2.0
    corners = (
        wall.map_from_wall() @ SE2(a, b, 0.0) for a, b in ((x, y), (-x, y), (-x, -y), (x, -y))
    )
    return [(corner.x_m, corner.y_m) for corner in corners]


def rasterise(walls: Sequence[Wall], grid: Grid) -> NDArray[np.bool_]:
    """(rows, columns) of bool: the cells that a wall reaches into."""
    occupied = np.zeros((grid.rows, grid.columns), np.bool_)
    half = grid.resolution_m / 2.0
    for wall in walls:
        corners = np.array(wall_corners(wall))
        low = np.floor((corners.min(0) - grid.origin[:2]) / grid.resolution_m).astype(int) - 1
        high = np.ceil((corners.max(0) - grid.origin[:2]) / grid.resolution_m).astype(int) + 1
        columns = np.arange(max(low[0], 0), min(high[0], grid.columns))
        rows = np.arange(max(low[1], 0), min(high[1], grid.rows))
        dx = (columns + 0.5) * grid.resolution_m + grid.origin.x_m - wall.x_m
        dy = ((rows + 0.5) * grid.resolution_m + grid.origin.y_m - wall.y_m)[:, None]
        c, s = math.cos(wall.yaw_rad), math.sin(wall.yaw_rad)
        reach, length, thickness = half * (abs(c) + abs(s)), wall.length_m / 2, wall.thickness_m / 2
        # Two boxes overlap where they do along each of the four directions of their sides.
        overlap = (
            (np.abs(c * dx + s * dy) < length + reach - _TOUCH_M)
            & (np.abs(c * dy - s * dx) < thickness + reach - _TOUCH_M)
            & (np.abs(dx) < abs(c) * length + abs(s) * thickness + half - _TOUCH_M)
            & (np.abs(dy) < abs(s) * length + abs(c) * thickness + half - _TOUCH_M)
        )
        occupied[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] |= overlap
    return occupied


def occupancy(walls: Sequence[Wall], grid: Grid, start: tuple[int, int]) -> NDArray[np.int8]:
    """(rows, columns) of int8: 100 walls, 0 the floor connected to cell `start`, -1 all else."""
    occupied = rasterise(walls, grid)
    rooms, _ = ndimage.label(~occupied)
    cells = np.full(occupied.shape, UNKNOWN, np.int8)
    if not occupied[start]:
        cells[rooms == rooms[start]] = FREE
    cells[occupied] = OCCUPIED
    return cells

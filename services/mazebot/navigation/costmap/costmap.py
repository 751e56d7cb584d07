"""One state of a costmap: Nav2's cell values, and the distance to the nearest obstacle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2
from mazebot.common.world.costmap import Cells, Clearance
from mazebot.navigation.costmap.footprint import distance_at

Costs = NDArray[np.uint8]

FREE_SPACE: Final = 0
MAX_NON_OBSTACLE: Final = 252
INSCRIBED_INFLATED_OBSTACLE: Final = 253
LETHAL_OBSTACLE: Final = 254
NO_INFORMATION: Final = 255
"""Cell values of nav2_costmap_2d."""

_STRAIGHT_RAD = 1e-6
"""A map rotated by less counts as not rotated."""


@dataclass(frozen=True, slots=True)
class GridFrame:
    """The position of a grid in its frame, map or odom: its axes are the frame's, cell (row 0,
    column 0) is at the origin corner.
    """

    resolution_m: float
    origin_x_m: float
    origin_y_m: float
    rows: int
    columns: int

    def cell(self, x_m: float, y_m: float) -> tuple[int, int] | None:
        """(row, column) of the cell that contains a point; None outside the grid."""
        column, row = self.place(x_m, y_m)
        if 0.0 <= row < self.rows and 0.0 <= column < self.columns:
            return int(row), int(column)
        return None

    def place(self, x_m: float, y_m: float) -> tuple[float, float]:
        """(column, row) of a point, from the corner of cell (0, 0), as the footprint's kernels take
        it.
        """
        return (
            (x_m - self.origin_x_m) / self.resolution_m,
            (y_m - self.origin_y_m) / self.resolution_m,
        )

    def center(self, row: int, column: int) -> tuple[float, float]:
        """(x, y) of a cell's centre."""
        return (
            self.origin_x_m + (column + 0.5) * self.resolution_m,
            self.origin_y_m + (row + 0.5) * self.resolution_m,
        )

    def extent(self) -> str:
        """The area covered, as text."""
        x_max_m = self.origin_x_m + self.columns * self.resolution_m
        y_max_m = self.origin_y_m + self.rows * self.resolution_m
        return (
            f"x {self.origin_x_m:.2f} to {x_max_m:.2f}, y {self.origin_y_m:.2f} to {y_max_m:.2f} m"
        )


def frame_of(resolution_m: float, origin: SE2, cells: Cells) -> GridFrame:
    """Frame of a map's (rows, columns) cells.

    Raises ValueError if the map is rotated: its rows must run along the map's x axis, as
    `straightened` makes them.
    """
    if abs(origin.yaw_rad) > _STRAIGHT_RAD:
        raise ValueError(f"origin yaw {origin.yaw_rad:.3f} rad: must be 0")
    if cells.size == 0 or resolution_m <= 0.0:
        raise ValueError(f"{cells.shape} cells of {resolution_m} m: must be some, of positive size")
    rows, columns = cells.shape
    return GridFrame(resolution_m, origin.x_m, origin.y_m, rows, columns)


@dataclass(frozen=True, slots=True)
class Costmap:
    """One state of a costmap. The layers that made it change its cells with their next update."""

    frame: GridFrame
    inscribed_radius_m: float
    """Cells at most this far from a lethal one cost 253."""
    costs: Costs
    """(rows, columns) uint8, Nav2's cell values."""
    distance_m: Clearance
    """(rows, columns) float32, exact distance from a cell's centre to that of the nearest lethal
    cell, 0 in it, and no more than the distance limit of the layers. Keepout zones cost, but are
    no obstacles here.

    Interpolated, it is the distance to the surface of things, which lies somewhere in the lethal
    cells. Maps have the faces of axis-aligned walls in the middle of their cells, where it is
    exact; others it may report farther by up to half a cell, or nearer by up to 0.71.
    """

    @property
    def clearance_m(self) -> Clearance:
        """The same as `distance_m`."""
        return self.distance_m

    @property
    def robot_radius_m(self) -> float:
        """The same as `inscribed_radius_m`."""
        return self.inscribed_radius_m

    def cost_at(self, x_m: float, y_m: float) -> int:
        """Cost of the cell that contains a point; NO_INFORMATION outside the grid."""
        cell = self.frame.cell(x_m, y_m)
        return NO_INFORMATION if cell is None else int(self.costs[cell])

    def clearance_at(self, x_m: float, y_m: float) -> float:
        """Interpolated distance from a point to the nearest obstacle, in metres; 0 outside the
        grid.
        """
        column, row = self.frame.place(x_m, y_m)
        return float(distance_at(self.distance_m, float(column), float(row)))

    def occupancy(self, part: tuple[slice, slice] = np.s_[:, :]) -> Cells:
        """(rows, columns) int8 as published by nav2's Costmap2DPublisher: 100 lethal, 99 inscribed,
        -1 unknown; of all cells or a part of them.
        """
        return _OCCUPANCY_FROM_COST[self.costs[part]]


def _occupancy_from_cost() -> Cells:
    table = np.empty(256, np.int8)
    table[FREE_SPACE] = 0
    between = np.arange(1, INSCRIBED_INFLATED_OBSTACLE)
    table[between] = 1 + (97 * (between - 1)) // 251
    table[INSCRIBED_INFLATED_OBSTACLE] = 99
    table[LETHAL_OBSTACLE] = 100
    table[NO_INFORMATION] = -1
    return table


_OCCUPANCY_FROM_COST = _occupancy_from_cost()

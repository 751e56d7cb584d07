"""The map as the robot can use it: where it can stand, and what each way costs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Cells,
    Clearance,
    Mask,
    clearance_m,
    inscribed,
    nearest_cell,
    reachable_from,
    roomy,
    straightened,
)
from mazebot.explorer.paths import HIGHEST_PRICE, PRICE_ONE, Prices

_COARSE_M: Final = 0.1
"""Side of the cells in which ways are searched."""
_INFLATION_M: Final = 0.7
"""Beyond it, a way costs its length."""
_PRICE_AT_RADIUS: Final = 2.5
"""As the planner's `cost_travel_multiplier` of 1.5 beside a wall."""
_DECAY_M: Final = 0.14
"""The price's excess falls to a half over 0.7 of it, as navigation's `cost_scaling_factor`."""


@dataclass(frozen=True, eq=False)
class Floor:
    """A map, straight along its axes, from where the robot is. Arrays are (rows, columns), row 0 at
    the smallest y.
    """

    resolution_m: float
    origin_x_m: float
    origin_y_m: float
    cells: Cells
    """int8: 0 free, 100 occupied, -1 unknown."""
    clearance_m: Clearance
    """Distance to the nearest occupied cell."""
    room_m: Clearance
    """Distance to the nearest cell that is not known to be free."""
    passable: Mask
    """The robot's centre hits no occupied cell there; unknown cells may be passable."""
    reachable: Mask
    """Known, and a path leads there from the robot. Of a floor with gaps, that its outline fits
    through; else passable."""
    radius_m: float
    """Of the robot's circle."""
    factor: int
    """Cells along the side of a coarse cell."""
    prices: Prices
    """(rows / factor, columns / factor) of coarse cells, 0 where no cell in it is reachable."""
    coarse_clearance_m: Clearance
    """The greatest of each coarse cell's reachable cells."""

    def cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """(row, column) of a place, which may be outside the map."""
        column = math.floor((x_m - self.origin_x_m) / self.resolution_m)
        return math.floor((y_m - self.origin_y_m) / self.resolution_m), column

    def center(self, row: float, column: float) -> tuple[float, float]:
        """(x, y) of a cell's centre in the map."""
        return (
            self.origin_x_m + (column + 0.5) * self.resolution_m,
            self.origin_y_m + (row + 0.5) * self.resolution_m,
        )

    @property
    def reachable_m2(self) -> float:
        """Area that the robot's centre can reach."""
        cells = int(np.count_nonzero(self.reachable & self.passable))
        return cells * self.resolution_m * self.resolution_m

    def coarse_index(self, x_m: float, y_m: float) -> int | None:
        """Index of the coarse cell nearest to a place that has a way; None: there is none."""
        row, column = self.cell(x_m, y_m)
        found = nearest_cell(self.prices > 0, row // self.factor, column // self.factor)
        return None if found is None else found[0] * int(self.prices.shape[1]) + found[1]

    def stand(self, coarse_index: int) -> tuple[int, int]:
        """(row, column) of the reachable cell of a coarse cell with the greatest clearance."""
        row, column = divmod(coarse_index, int(self.prices.shape[1]))
        top, left = row * self.factor, column * self.factor
        part = np.s_[top : top + self.factor, left : left + self.factor]
        room = np.where(self.reachable[part], self.clearance_m[part], -1.0)
        down, right = divmod(int(np.argmax(room)), int(room.shape[1]))
        return top + down, left + right

    def metres(self, cost: int) -> float:
        """Length of a way through open floor of a cost of `paths.search`."""
        return cost * 0.01 * self.resolution_m * self.factor


@kernel(
    "void(boolean[:, ::1], float32[:, ::1], float64, int64, float64, int32[::1], "
    "int32[:, ::1], float32[:, ::1])"
)
def _make_coarse(
    reachable: Mask, clearance: Clearance, resolution_m: float, factor: int, radius_m: float,
    table: NDArray[np.int32], prices: Prices, coarse_clearance: Clearance,
) -> None:  # fmt: skip
    rows, columns = reachable.shape
    prices[:] = 0
    coarse_clearance[:] = -1.0
    for row in range(rows):
        for column in range(columns):
            if reachable[row, column]:
                r, c = row // factor, column // factor
                coarse_clearance[r, c] = max(coarse_clearance[r, c], clearance[row, column])
    for r in range(prices.shape[0]):
        for c in range(prices.shape[1]):
            if coarse_clearance[r, c] >= 0.0:
                beyond = (coarse_clearance[r, c] - radius_m) / resolution_m * 4.0
                place = min(max(int(beyond), 0), table.size - 1)
                prices[r, c] = table[place]


def _price_table(resolution_m: float) -> NDArray[np.int32]:
    """Prices by the clearance beyond the robot's radius, in quarters of a cell."""
    count = max(int((_INFLATION_M / resolution_m) * 4.0), 2)
    excess = _PRICE_AT_RADIUS - 1.0
    factor = 1.0 / (1.0 + 0.25 * resolution_m / _DECAY_M)
    table = np.empty(count, np.int32)
    for i in range(count):
        table[i] = min(int(PRICE_ONE * (1.0 + excess) + 0.5), HIGHEST_PRICE)
        excess *= factor
    table[-1] = PRICE_ONE
    return table


def floor_from(
    cells: Cells, resolution_m: float, origin: SE2, robot: SE2, radius_m: float, tolerance_m: float,
    inscribed_radius_m: float | None = None,
) -> Floor:  # fmt: skip
    """The floor of a map for a robot at a pose in it.

    Args:
        cells: (rows, columns) int8 occupancy, 100 occupied, -1 unknown.
        resolution_m: side of a cell.
        origin: pose of the corner of cell (0, 0).
        robot: map_from_base.
        radius_m: of the robot's circle.
        tolerance_m: a robot in inflated cells stands at the nearest passable cell this near.
        inscribed_radius_m: half of the width with which it drives through gaps; None: it drives
            only where its circle hits nothing.
    """
    origin, cells = straightened(resolution_m, origin, cells)
    factor = max(round(_COARSE_M / resolution_m), 1)
    # Beyond its edge a map is unknown.
    cells = np.pad(cells, factor, constant_values=UNKNOWN)
    origin = SE2(origin.x_m - factor * resolution_m, origin.y_m - factor * resolution_m, 0.0)
    clearance = np.ascontiguousarray(clearance_m(cells >= OCCUPIED, resolution_m))
    room = np.ascontiguousarray(clearance_m(cells != FREE, resolution_m))
    if inscribed_radius_m is None:
        fits = passable = ~inscribed(clearance, radius_m)
    else:
        inscribed_radius_m = min(inscribed_radius_m, radius_m)
        fits = ~inscribed(clearance, inscribed_radius_m)
        passable = roomy(clearance, cells >= FREE, resolution_m, radius_m, inscribed_radius_m)
    known = (cells >= FREE) & fits
    row = math.floor((robot.y_m - origin.y_m) / resolution_m)
    column = math.floor((robot.x_m - origin.x_m) / resolution_m)
    reachable = np.ascontiguousarray(reachable_from(known, row, column, tolerance_m / resolution_m))
    rows, columns = cells.shape
    shape = -(-rows // factor), -(-columns // factor)
    prices, coarse = np.empty(shape, np.int32), np.empty(shape, np.float32)
    _make_coarse(
        reachable, clearance, resolution_m, factor, radius_m, _price_table(resolution_m), prices,
        coarse,
    )  # fmt: skip
    return Floor(
        resolution_m, origin.x_m, origin.y_m, np.ascontiguousarray(cells), clearance, room,
        passable, reachable, radius_m, factor, prices, coarse,
    )  # fmt: skip

"""The grid that the planners search: a costmap's cells with a border, and what each one costs.

Kernels of this folder count in cells of this grid: x is the column, y the row, and the centre of a
cell has whole numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.costmap.layered_costmap import Costmap, Costs, GridFrame

Prices = NDArray[np.float32]
Cell = tuple[int, int]

NARROW: Final = 253
"""Too near to an obstacle."""
SOLID: Final = 254
"""An obstacle, or unknown where that is not allowed."""
BORDER: Final = 255
"""Around the map."""
HIGHEST_COST: Final = 252
NO_PRICE = np.empty(0, np.float32)


@dataclass(frozen=True, slots=True)
class SearchGrid:
    """A costmap for a search: immutable."""

    cells: Costs
    """(rows + 2, columns + 2) uint8: 0 to 252 the cost, else NARROW, SOLID or BORDER."""
    frame: GridFrame

    def at(self, x_m: float, y_m: float) -> tuple[float, float]:
        """A place in the map as (x, y) in cells."""
        frame = self.frame
        return (
            (x_m - frame.origin_x_m) / frame.resolution_m + 0.5,
            (y_m - frame.origin_y_m) / frame.resolution_m + 0.5,
        )

    def in_map(self, points: Array) -> Array:
        """(n, 2) places in the map of (n, 2) points in cells."""
        origin = np.array([self.frame.origin_x_m, self.frame.origin_y_m])
        return np.asarray((points - 0.5) * self.frame.resolution_m + origin)

    def cell(self, x_m: float, y_m: float) -> Cell | None:
        """(row, column) of the cell that contains a place; None outside the map."""
        cell = self.frame.cell(x_m, y_m)
        return None if cell is None else (cell[0] + 1, cell[1] + 1)

    def center(self, cell: Cell) -> tuple[float, float]:
        """(x, y) of a cell's centre, in the map."""
        return self.frame.center(cell[0] - 1, cell[1] - 1)

    def is_free(self, cell: Cell) -> bool:
        """Whether a path may lead there."""
        return bool(self.cells[cell] < NARROW)


def search_grid(costmap: Costmap, passing_radius_m: float, allow_unknown: bool) -> SearchGrid:
    """The grid of a costmap.

    Args:
        costmap: what is where.
        passing_radius_m: cells nearer than this to an obstacle are NARROW as well.
        allow_unknown: whether unknown cells are passable, at the highest cost, as in Nav2.
    """
    rows, columns = costmap.costs.shape
    cells = np.empty((rows + 2, columns + 2), np.uint8)
    known = HIGHEST_COST if allow_unknown else SOLID
    passing = _least_float32(passing_radius_m)
    _fill(cells, costmap.costs, costmap.clearance_m, passing, np.uint8(known))
    return SearchGrid(cells, costmap.frame)


def _least_float32(value: float) -> np.float32:
    """The least one that is not below a value: a float32 below either is below both."""
    nearest = np.float32(value)
    return nearest if float(nearest) >= value else np.nextafter(nearest, np.float32(np.inf))


def prices(weight: float) -> Prices:
    """(256,) float32: what half a step into a cell of each value costs, in cells; infinite where
    none leads.

    A step costs its length times 1 + weight * cost / 252 (the form of Nav2's Smac 2D), with the
    mean of the costs of its two cells.
    """
    table = np.full(256, np.inf, np.float32)
    table[:NARROW] = 0.5 * (1.0 + weight * np.arange(NARROW) / HIGHEST_COST)
    return table


@kernel(error_model="numpy")
def _fill(
    cells: Costs, costs: Costs, clearance_m: Clearance, passing_m: np.float32, unknown: np.uint8
) -> None:
    rows, columns = costs.shape
    cells[0, :], cells[rows + 1, :] = BORDER, BORDER
    narrow, solid = np.uint8(NARROW), np.uint8(SOLID)
    for row in range(rows):
        cells[row + 1, 0], cells[row + 1, columns + 1] = BORDER, BORDER
        to, costs_here, clearance_here = cells[row + 1], costs[row], clearance_m[row]
        for column in range(columns):
            cost = costs_here[column]
            cost = unknown if cost > solid else cost
            passes = clearance_here[column] >= passing_m or cost >= narrow
            to[column + 1] = cost if passes else narrow

"""How wide the widest way between two regions is, and where it is narrowest."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.navigation.costmap.layered_costmap import LETHAL_OBSTACLE, Costmap
from mazebot.navigation.planning.grid.a_star import Workspace
from mazebot.navigation.planning.grid.regions import OF_GOAL, OF_START, thinnest_place
from mazebot.navigation.planning.grid.search_grid import BORDER, NARROW, SOLID, SearchGrid

_LEAST_M: Final = 0.1
"""What is narrower is no way: the costmap's cells are 5 cm."""
_EXACT_M: Final = 0.005


class Narrows(NamedTuple):
    """Where the widest way is narrowest."""

    place_m: tuple[float, float]
    width_m: float


def widest_way(
    grid: SearchGrid, costmap: Costmap, most_m: float, kept: Workspace
) -> Narrows | None:
    """The narrowest place of the widest way between two regions that no way of a width joins; None
    where nothing as wide as 0.1 m joins them.

    Args:
        grid: the grid with the regions, which the marks of `kept` have.
        costmap: what is where.
        most_m: half of the width of the ways that there are not.
        kept: memory of the search, with both regions marked.
    """
    ends = []
    clearance_m = np.pad(costmap.clearance_m, 1)
    for mark in (OF_START, OF_GOAL):
        there = np.where(kept.marks.reshape(grid.cells.shape) == mark, clearance_m, -1.0)
        ends.append(int(there.argmax()))
    start, goal = ends
    solid = np.pad(costmap.costs >= LETHAL_OBSTACLE, 1)
    regions = kept.regions

    def cells_at(radius_m: float) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
        cells = np.where(clearance_m >= radius_m, 0, NARROW).astype(np.uint8)
        cells[solid] = SOLID
        cells[grid.cells == BORDER] = BORDER
        return cells

    def joined(radius_m: float) -> bool:
        regions.find(cells_at(radius_m))
        region = regions.at(start)
        return region >= 0 and region == regions.at(goal)

    low_m, high_m = _LEAST_M / 2.0, most_m
    if not joined(low_m):
        return None
    while high_m - low_m > _EXACT_M / 2.0:
        middle_m = (low_m + high_m) / 2.0
        low_m, high_m = (middle_m, high_m) if joined(middle_m) else (low_m, middle_m)
    cells = cells_at(high_m)
    regions.find(cells)
    kept.marks[:] = 0
    regions.mark(regions.at(start), OF_START, kept.marks)
    regions.mark(regions.at(goal), OF_GOAL, kept.marks)
    at = int(thinnest_place(
        cells, np.empty((0, 0), np.uint8), start, goal, 1, 3, False, kept.marks
    ))  # fmt: skip
    if at < 0:
        return None
    row, column = divmod(at, grid.cells.shape[1])
    return Narrows(grid.center((row, column)), _width_m(grid, solid, row, column, high_m))


def _width_m(
    grid: SearchGrid, solid: NDArray[np.bool_], row: int, column: int, radius_m: float
) -> float:
    """Distance between what stands on both sides of a cell, the nearest within twice a radius."""
    side_m = grid.frame.resolution_m
    reach = math.ceil(2.0 * radius_m / side_m) + 1
    row0, column0 = max(row - reach, 0), max(column - reach, 0)
    rows, columns = np.nonzero(solid[row0 : row + reach + 1, column0 : column + reach + 1])
    away = np.stack([rows + row0 - row, columns + column0 - column], axis=1) * side_m
    squares = (away * away).sum(axis=1)
    nearest = away[squares.argmin()]
    across = (away * nearest).sum(axis=1) < 0.0
    apart = away[across] - nearest
    if not len(apart):
        return 2.0 * radius_m
    return float(np.sqrt((apart * apart).sum(axis=1).min()))

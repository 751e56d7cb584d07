"""Optimal search over the 8 neighbours of each cell."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.navigation.costmap.layered_costmap import Costs
from mazebot.navigation.planning.grid.regions import Regions
from mazebot.navigation.planning.grid.search_grid import Prices

FOUND: Final = 0
NO_WAY: Final = 1
GAVE_UP: Final = 2

_EXACT: Final = 1024.0
"""Costs are whole multiples of one cell divided by this."""

CostToCome = NDArray[np.float32]
Directions = NDArray[np.uint8]


class Workspace:
    """Arrays of one value a cell, kept from plan to plan: allocating them again would fragment the
    heap.
    """

    def __init__(self) -> None:
        self.cost_to_come: CostToCome = np.empty(0, np.float32)
        self.came_from: Directions = np.empty(0, np.uint8)
        self.marks: Directions = np.empty(0, np.uint8)
        self.regions = Regions()
        self._runs: NDArray[np.int32] = np.empty((2, 0, 0), np.int32)

    def fit(self, cells: int) -> None:
        """Give them the size of a grid of so many cells."""
        if self.cost_to_come.size != cells:
            self.cost_to_come = np.empty(cells, np.float32)
            self.came_from = np.empty(cells, np.uint8)
            self.marks = np.empty(cells, np.uint8)

    def run_ends(self, shape: tuple[int, ...]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Two arrays of the grid's (rows, columns)."""
        if self._runs.shape[1:] != shape:
            self._runs = np.empty((2, *shape), np.int32)
        return self._runs[0], self._runs[1]


def buckets_for(price: Prices, per_cell: float) -> int:
    """How many buckets hold every key that can be open at once: a power of two."""
    dearest = float(price[np.isfinite(price)].max())
    widest = math.sqrt(2.0) * (2.0 * dearest + 1.0) * per_cell + 3.0
    count = 64
    while count < widest:
        count *= 2
    return count


@kernel()
def _quantised(price: Prices, factor: float) -> Prices:
    """Prices times a factor, in whole multiples of 1 / `_EXACT`."""
    exact = np.empty_like(price)
    for i in range(price.size):
        exact[i] = np.float32(np.rint(price[i] * factor * _EXACT) / _EXACT)
    return exact


@kernel()
def a_star(
    cells: Costs,
    limit: int,
    price: Prices,
    start: int,
    goal: int,
    max_iterations: int,
    per_cell: float,
    buckets: int,
    pull: float,
    slack: float,
    cost_to_come: CostToCome,
    came_from: Directions,
) -> tuple[int, int]:
    """Cheapest 8-connected path between two cells, given by their flat indices, that enters no cell
    of value `limit` or more and cuts no corner of one.

    The queue is a ring of buckets of 1 / `per_cell`, last in, first out. Within a bucket the order
    is not by cost, so a cell may be expanded again when a cheaper way to it is found; the search
    ends when no open key is below the goal's cost. The result is therefore optimal (Dial, 1969;
    Denardo and Fox, 1979). The heuristic is the octile distance, which no path can undercut, as no
    price is below 0.5.

    Steps cost whole multiples of 1 / 1024, at most 0.1 % off: so sums are exact, and ways that
    cost the same do not differ by rounding, for which open space would be expanded over and over.

    With `pull` 0 it has no heuristic (Dijkstra), else `pull` is 1. It continues beyond the goal's
    cost by `slack`. `cost_to_come` and `came_from`, one value a cell, are overwritten. Returns
    (status, cells expanded).
    """
    stride = cells.shape[1]
    flat = cells.ravel()
    cost_to_come[:] = np.inf
    straight = _quantised(price, 1.0)
    diagonal = _quantised(price, math.sqrt(2.0))
    goal_row, goal_column = goal // stride, goal % stride
    # As much over 1 as a diagonal step at the least price.
    shorter = 2.0 * np.float64(diagonal[0]) - 1.0
    mask = buckets - 1
    head = np.full(buckets, -1, np.int32)
    size = 4096
    entry_next = np.empty(size, np.int32)
    entry_cell = np.empty(size, np.int32)
    entry_cost = np.empty(size, np.float32)
    used, unused, waiting = 1, -1, 1
    far = abs(start // stride - goal_row)
    near = abs(start % stride - goal_column)
    if far < near:
        far, near = near, far
    bucket = int(pull * (far + shorter * near) * per_cell)
    head[bucket & mask] = 0
    entry_next[0], entry_cell[0], entry_cost[0] = -1, start, 0.0
    cost_to_come[start] = 0.0
    last_bucket = 2**62
    iterations = 0
    # East, west, south, north; then the diagonals between them.
    steps = np.array([1, -1, -stride, stride, -stride + 1, -stride - 1, stride + 1, stride - 1])
    rows = np.array([0, 0, -1, 1, -1, -1, 1, 1])
    columns = np.array([1, -1, 0, 0, 1, -1, 1, -1])
    sides_a = np.array([0, 0, 0, 0, 0, 1, 0, 1])
    sides_b = np.array([0, 0, 0, 0, 2, 2, 3, 3])
    is_open = np.empty(4, np.bool_)
    while waiting > 0:
        entry = head[bucket & mask]
        if entry < 0:
            bucket += 1
            if bucket > last_bucket:
                break
            continue
        head[bucket & mask] = entry_next[entry]
        cell = entry_cell[entry]
        here = entry_cost[entry]
        entry_next[entry] = unused
        unused = entry
        waiting -= 1
        if here > cost_to_come[cell] or (cell == goal and slack <= 0.0):
            continue
        iterations += 1
        if iterations > max_iterations:
            return GAVE_UP, iterations
        row = cell // stride
        column = cell - row * stride
        own, own_diagonal = straight[flat[cell]], diagonal[flat[cell]]
        for k in range(8):
            to = cell + steps[k]
            value = flat[to]
            if k < 4:
                is_open[k] = value < limit
                if value >= limit:
                    continue
                cost = here + (own + straight[value])
            else:
                if value >= limit or not (is_open[sides_a[k]] and is_open[sides_b[k]]):
                    continue
                cost = here + (own_diagonal + diagonal[value])
            if cost >= cost_to_come[to]:
                continue
            cost_to_come[to] = cost
            came_from[to] = k
            far = abs(row + rows[k] - goal_row)
            near = abs(column + columns[k] - goal_column)
            if far < near:
                far, near = near, far
            # Rounding must not put a key behind the bucket that is being emptied.
            key = max(int((cost + pull * (far + shorter * near)) * per_cell), bucket)
            if to == goal:
                last_bucket = key + int(slack * per_cell)
            elif key > last_bucket:
                continue
            if unused >= 0:
                entry = unused
                unused = entry_next[entry]
            else:
                if used == size:
                    entry_next = np.concatenate((entry_next, np.empty(size, np.int32)))
                    entry_cell = np.concatenate((entry_cell, np.empty(size, np.int32)))
                    entry_cost = np.concatenate((entry_cost, np.empty(size, np.float32)))
                    size *= 2
                entry = used
                used += 1
            entry_cell[entry], entry_cost[entry] = to, cost
            entry_next[entry] = head[key & mask]
            head[key & mask] = entry
            waiting += 1
    if np.isfinite(cost_to_come[goal]):
        return FOUND, iterations
    return NO_WAY, iterations


@kernel()
def traced(came_from: Directions, stride: int, start: int, goal: int) -> Array:
    """(n, 2) cells of the path, x and y, from start to goal."""
    steps = np.array([1, -1, -stride, stride, -stride + 1, -stride - 1, stride + 1, stride - 1])
    count, cell = 1, goal
    while cell != start:
        cell -= steps[came_from[cell]]
        count += 1
    points = np.empty((count, 2))
    cell = goal
    for i in range(count - 1, -1, -1):
        points[i, 0], points[i, 1] = cell % stride, cell // stride
        cell -= steps[came_from[cell]]
    return points

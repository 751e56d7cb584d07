"""Which cells belong together, and where two regions are nearest to being one."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.kernels import kernel
from mazebot.navigation.costmap.layered_costmap import Costs
from mazebot.navigation.planning.grid.search_grid import NARROW, SOLID

Marks = NDArray[np.uint8]
Runs = NDArray[np.int32]

OF_START: Final = 1
OF_GOAL: Final = 2


class Regions:
    """Regions of free cells that paths connect. The memory is kept from grid to grid."""

    def __init__(self) -> None:
        self._stride = 0
        self._begin = self._end = self._region = self._first = np.empty(0, np.int32)

    def find(self, cells: Costs) -> None:
        """Find the regions of a search grid."""
        rows, columns = cells.shape
        if (len(self._first), self._stride) != (rows + 1, columns):
            # Runs have a cell that is not free between them. What is not used takes no memory.
            most = rows * (columns // 2 + 1)
            self._begin, self._end, self._region = (np.empty(most, np.int32) for _ in range(3))
            self._first = np.empty(rows + 1, np.int32)
            self._stride = columns
        _label_runs(cells, self._begin, self._end, self._region, self._first)

    def at(self, cell: int) -> int:
        """The number of a cell's region, by the cell's flat index; -1 where it is not free."""
        row, column = divmod(cell, self._stride)
        first, last = self._first[row], self._first[row + 1]
        run = first + int(np.searchsorted(self._begin[first:last], column, side="right")) - 1
        if run < first or column >= self._end[run]:
            return -1
        return int(self._region[run])

    def mark(self, region: int, value: int, marks: Marks) -> int:
        """Set the marks, one a cell, of all cells of a region; their count."""
        return int(
            _mark(self._begin, self._end, self._region, self._first, self._stride, region, value,
                  marks)
        )  # fmt: skip


@kernel()
def _root(parent: Runs, run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@kernel()
def _label_runs(cells: Costs, begin: Runs, end: Runs, region: Runs, first: Runs) -> None:
    """Find the runs of free cells in each row, and join those that have cells above each other.

    Args:
        cells: (rows, columns), with a border.
        begin: of each run the first column.
        end: the column after its last.
        region: the first run of its region.
        first: (rows + 1,) the first run of each row.
    """
    rows, columns = cells.shape
    count, above, above_end = 0, 0, 0
    for row in range(rows):
        line = cells[row]
        first[row] = count
        column = 0
        while True:
            while column < columns and line[column] >= NARROW:
                column += 1
            if column == columns:
                break
            begin[count] = column
            while column < columns and line[column] < NARROW:
                column += 1
            end[count] = column
            region[count] = count
            while above < above_end and end[above] <= begin[count]:
                above += 1
            # The last one that is above this run may be above the next one, too.
            beside, own = above, count
            while beside < above_end and begin[beside] < column:
                root = _root(region, beside)
                if root < own:
                    region[own] = root
                    own = root
                elif root > own:
                    region[root] = own
                beside += 1
            count += 1
        above, above_end = first[row], count
    first[rows] = count
    for run in range(count):
        region[run] = region[region[run]]


@kernel()
def _mark(
    begin: Runs, end: Runs, region: Runs, first: Runs, stride: int, chosen: int, value: int,
    marks: Marks,
) -> int:  # fmt: skip
    count = 0
    for row in range(first.size - 1):
        for run in range(first[row], first[row + 1]):
            if region[run] == chosen:
                marks[row * stride + begin[run] : row * stride + end[run]] = value
                count += end[run] - begin[run]
    return count


@kernel()
def thinnest_place(
    cells: Costs,
    fixed: Costs,
    start: int,
    goal: int,
    narrow_weight: int,
    solid_weight: int,
    from_goal: bool,
    marks: Marks,
) -> int:
    """Where the way from the start's region to the goal's that leads through least cells that are
    not free first meets an obstacle, or else the first NARROW one: a flat index. Of equal ones, the
    least detour from start to goal. -1 if no way leads there. It is searched for from the start's
    region or from the goal's: the smaller one is faster.

    `marks` has both regions. Cells that are SOLID or more in `fixed`, of the same shape, cannot
    open; an empty one leaves out nothing but the border.
    """
    stride = cells.shape[1]
    flat, never = cells.ravel(), fixed.ravel()
    size = flat.size
    source, target = OF_START, OF_GOAL
    if from_goal:
        source, target = OF_GOAL, OF_START
    ring = solid_weight + 1
    head = np.full(ring, -1, np.int32)
    capacity = 4096
    entry_next = np.empty(capacity, np.int32)
    entry_cell = np.empty(capacity, np.int32)
    entry_first = np.empty(capacity, np.int32)
    used = 0
    weight_to = np.full(size, np.int32(2**30), np.int32)
    waiting = 0
    for cell in range(size):
        if marks[cell] != source:
            continue
        for step in (1, -1, stride, -stride):
            value = flat[cell + step]
            if value < NARROW or value > SOLID:
                continue
            if used == capacity:
                entry_next = np.concatenate((entry_next, np.empty(capacity, np.int32)))
                entry_cell = np.concatenate((entry_cell, np.empty(capacity, np.int32)))
                entry_first = np.concatenate((entry_first, np.empty(capacity, np.int32)))
                capacity *= 2
            entry_cell[used], entry_first[used], entry_next[used] = cell, -1, head[0]
            head[0] = used
            weight_to[cell] = 0
            used += 1
            waiting += 1
            break
    best, best_detour, at = -1, np.inf, 0
    start_row, start_column = start // stride, start % stride
    goal_row, goal_column = goal // stride, goal % stride
    while waiting > 0:
        entry = head[at % ring]
        if entry < 0:
            if best >= 0:
                break
            at += 1
            continue
        head[at % ring] = entry_next[entry]
        waiting -= 1
        cell, first = entry_cell[entry], entry_first[entry]
        if weight_to[cell] < at:
            continue
        for step in (1, -1, stride, -stride):
            to = cell + step
            value = flat[to]
            if marks[to] == source or value > SOLID:
                continue
            if never.size > 0 and never[to] >= SOLID:
                continue
            weight = 0
            if value == NARROW:
                weight = narrow_weight
            elif value == SOLID:
                weight = solid_weight
            to_first = first
            if weight > 0:
                # The first of the start's side is the last of the goal's.
                harder = first < 0 or (value == SOLID and flat[first] != SOLID)
                if harder or (from_goal and (value == SOLID or flat[first] != SOLID)):
                    to_first = to
            if marks[to] == target:
                row, column = to_first // stride, to_first % stride
                detour = np.sqrt(
                    float((row - start_row) * (row - start_row))
                    + float((column - start_column) * (column - start_column))
                ) + np.sqrt(
                    float((row - goal_row) * (row - goal_row))
                    + float((column - goal_column) * (column - goal_column))
                )
                if detour < best_detour or (detour == best_detour and to_first < best):
                    best, best_detour = to_first, detour
                continue
            if at + weight >= weight_to[to]:
                continue
            weight_to[to] = at + weight
            if used == capacity:
                entry_next = np.concatenate((entry_next, np.empty(capacity, np.int32)))
                entry_cell = np.concatenate((entry_cell, np.empty(capacity, np.int32)))
                entry_first = np.concatenate((entry_first, np.empty(capacity, np.int32)))
                capacity *= 2
            entry_cell[used], entry_first[used] = to, to_first
            entry_next[used] = head[(at + weight) % ring]
            head[(at + weight) % ring] = used
            used += 1
            waiting += 1
    return best

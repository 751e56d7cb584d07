"""Which cells belong together, and where two regions are nearest to being one."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from services.common.kernels import kernel
from services.navigation.costmap.layered_costmap import Costs
from services.navigation.planning.search_grid import NARROW, SOLID

Marks = NDArray[np.uint8]
Queue = NDArray[np.int32]

OF_START: Final = 1
OF_GOAL: Final = 2


@kernel()
def are_apart(cells: Costs, start: int, goal: int, most: int, marks: Marks, queue: Queue) -> bool:
    """Whether two cells, given by their flat indices, lie in different regions of free cells, as
    far as this shows within so many cells: False may also mean that it does not.

    Both regions grow in turns until they meet or one has no more cells, so that the time is that of
    the smaller one. `marks` and `queue`, one value a cell, are overwritten.
    """
    stride = cells.shape[1]
    flat = cells.ravel()
    if start == goal:
        return False
    marks[:] = 0
    marks[start], marks[goal] = OF_START, OF_GOAL
    # One queue grows from the array's front, the other from its back.
    front, front_end = 0, 1
    last = queue.size - 1
    back, back_end = last, last - 1
    queue[front], queue[back] = start, goal
    while front < front_end and back > back_end:
        cell = queue[front]
        front += 1
        for step in (1, -1, stride, -stride):
            to = cell + step
            if marks[to] == 0:
                if flat[to] < NARROW:
                    marks[to] = OF_START
                    queue[front_end] = to
                    front_end += 1
            elif marks[to] == OF_GOAL:
                return False
        cell = queue[back]
        back -= 1
        for step in (1, -1, stride, -stride):
            to = cell + step
            if marks[to] == 0:
                if flat[to] < NARROW:
                    marks[to] = OF_GOAL
                    queue[back_end] = to
                    back_end -= 1
            elif marks[to] == OF_START:
                return False
        if front > most:
            return False
    return True


@kernel()
def mark_region(cells: Costs, start: int, mark: int, marks: Marks, queue: Queue) -> int:
    """Mark every free cell that a path from a cell reaches; their count. Cells that have the mark
    already are not entered.
    """
    stride = cells.shape[1]
    flat = cells.ravel()
    marks[start] = mark
    queue[0] = start
    at, end = 0, 1
    while at < end:
        cell = queue[at]
        at += 1
        for step in (1, -1, stride, -stride):
            to = cell + step
            if marks[to] != mark and flat[to] < NARROW:
                marks[to] = mark
                queue[end] = to
                end += 1
    return end


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

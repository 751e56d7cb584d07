"""Frontiers: where floor that the robot can reach borders on floor that may be there.

An opening counts if the robot fits through it: unknown cells too near to an obstacle for the
robot's centre are no floor for it, so that slits, and what shows through gaps of a wall, leave no
frontier, and none is left as soon as every cell that the robot can reach is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Cells, Mask
from mazebot.explorer.floor import Floor

Labels = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Frontier:
    """A group of cells that the robot wants to see."""

    cells: NDArray[np.int64]
    """(n, 2) row and column of unknown cells that the robot could reach: what is to be seen."""
    size_m: float
    """The longer side of the rectangle around the group's border, that at obstacles included."""

    def middle(self) -> tuple[int, int]:
        """The one of its cells nearest to their mean."""
        mean = self.cells.mean(0)
        offsets = np.abs(self.cells - mean).sum(1)
        row, column = self.cells[int(np.argmin(offsets))]
        return int(row), int(column)


@kernel("int64(int8[:, ::1], boolean[:, ::1], boolean[:, ::1], int32[:, ::1], int64[:, ::1])")
def _label(
    cells: Cells, passable: Mask, reachable: Mask, labels: Labels, boxes: NDArray[np.int64]
) -> int:
    """Number the groups of border cells: free, connected with the robot's cells over free ones,
    next to an unknown one. Fills labels (0: none), and for each group its rectangle (first row,
    last row, first column, last column) and the number of its cells through which the robot fits.

    Returns the number of groups; more than `boxes` has room for are not numbered.
    """
    rows, columns = cells.shape
    seen = np.zeros((rows, columns), np.bool_)
    stack = np.empty(rows * columns, np.int64)
    count = 0
    for row in range(rows):
        for column in range(columns):
            if reachable[row, column]:
                seen[row, column] = True
                stack[count] = row * columns + column
                count += 1
    labels[:] = 0
    while count > 0:
        count -= 1
        row, column = stack[count] // columns, stack[count] % columns
        for side in range(4):
            r = row + (1 if side == 0 else (-1 if side == 1 else 0))
            c = column + (1 if side == 2 else (-1 if side == 3 else 0))
            if r < 0 or c < 0 or r >= rows or c >= columns:
                continue
            if cells[r, c] < 0:
                labels[row, column] = -1
            elif cells[r, c] == 0 and not seen[r, c]:
                seen[r, c] = True
                stack[count] = r * columns + c
                count += 1
    groups = 0
    for start in range(rows * columns):
        if labels[start // columns, start % columns] != -1 or groups >= boxes.shape[0]:
            continue
        box = boxes[groups]
        box[0], box[1], box[2], box[3], box[4] = rows, -1, columns, -1, 0
        groups += 1
        labels[start // columns, start % columns] = groups
        stack[0] = start
        count = 1
        while count > 0:
            count -= 1
            row, column = stack[count] // columns, stack[count] % columns
            box[0], box[1] = min(box[0], row), max(box[1], row)
            box[2], box[3] = min(box[2], column), max(box[3], column)
            passes = False
            for down in range(-1, 2):
                for right in range(-1, 2):
                    r, c = row + down, column + right
                    if r < 0 or c < 0 or r >= rows or c >= columns:
                        continue
                    if labels[r, c] == -1:
                        labels[r, c] = groups
                        stack[count] = r * columns + c
                        count += 1
                    if (down == 0 or right == 0) and cells[r, c] < 0 and passable[r, c]:
                        passes = True
            if passes and reachable[row, column]:
                box[4] += 1
    return groups


@kernel("int64(int8[:, ::1], boolean[:, ::1], boolean[:, ::1], int32[:, ::1], int64[:, ::1])")
def _wanted(
    cells: Cells, passable: Mask, reachable: Mask, labels: Labels, found: NDArray[np.int64]
) -> int:
    """Fill (row, column, group) of unknown passable cells next to a reachable one."""
    rows, columns = cells.shape
    count = 0
    for row in range(rows):
        for column in range(columns):
            if cells[row, column] >= 0 or not passable[row, column]:
                continue
            for side in range(4):
                r = row + (1 if side == 0 else (-1 if side == 1 else 0))
                c = column + (1 if side == 2 else (-1 if side == 3 else 0))
                if r < 0 or c < 0 or r >= rows or c >= columns:
                    continue
                if reachable[r, c] and labels[r, c] > 0:
                    if count < found.shape[0]:
                        found[count, 0], found[count, 1] = row, column
                        found[count, 2] = labels[r, c]
                        count += 1
                    break
    return count


@kernel("int64(int8[:, ::1], boolean[:, ::1], int64[:, ::1], int64)")
def _guess(cells: Cells, passable: Mask, starts: NDArray[np.int64], most: int) -> int:
    """Number of unknown passable cells at most so many steps over sides from the starts."""
    rows, columns = cells.shape
    steps = np.full((rows, columns), -1, np.int32)
    queue = np.empty(rows * columns, np.int64)
    head, tail = 0, 0
    for i in range(starts.shape[0]):
        row, column = starts[i, 0], starts[i, 1]
        if steps[row, column] < 0:
            steps[row, column] = 0
            queue[tail] = row * columns + column
            tail += 1
    while head < tail:
        row, column = queue[head] // columns, queue[head] % columns
        head += 1
        if steps[row, column] >= most:
            continue
        for side in range(4):
            r = row + (1 if side == 0 else (-1 if side == 1 else 0))
            c = column + (1 if side == 2 else (-1 if side == 3 else 0))
            if r < 0 or c < 0 or r >= rows or c >= columns or steps[r, c] >= 0:
                continue
            if cells[r, c] < 0 and passable[r, c]:
                steps[r, c] = steps[row, column] + 1
                queue[tail] = r * columns + c
                tail += 1
    return tail


_GUESSED_M = 1.5
_MOST_GROUPS = 4096


def guessed_m2(floor: Floor, frontiers: list[Frontier]) -> float:
    """Floor that may lie behind frontiers: what is unknown and not farther from them than 1.5 m."""
    if not frontiers:
        return 0.0
    starts = np.ascontiguousarray(np.concatenate([one.cells for one in frontiers]))
    steps = round(_GUESSED_M / floor.resolution_m)
    count = _guess(floor.cells, floor.passable, starts, steps)
    return float(count * floor.resolution_m * floor.resolution_m)


def find_frontiers(floor: Floor, min_size_m: float) -> list[Frontier]:
    """The frontiers of a floor, in the order of their first border cells, row by row.

    Args:
        floor: the map from where the robot is.
        min_size_m: smaller ones are left out.
    """
    labels = np.empty(floor.cells.shape, np.int32)
    boxes = np.empty((_MOST_GROUPS, 5), np.int64)
    groups = _label(floor.cells, floor.passable, floor.reachable, labels, boxes)
    found = np.empty((int(np.count_nonzero(labels)) * 4 + 1, 3), np.int64)
    count = _wanted(floor.cells, floor.passable, floor.reachable, labels, found)
    of_group = found[:count, 2]
    frontiers = []
    for group in range(groups):
        first_row, last_row, first_column, last_column, passing = boxes[group].tolist()
        longer = max(last_row - first_row, last_column - first_column) + 1
        size_m = longer * floor.resolution_m
        if passing == 0 or size_m < min_size_m:
            continue
        cells = np.ascontiguousarray(found[:count][of_group == group + 1, :2])
        if len(cells):
            frontiers.append(Frontier(cells, size_m))
    return frontiers

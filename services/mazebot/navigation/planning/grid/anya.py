"""Shortest any-angle paths where every free cell costs the same: a search over intervals of rows.

After Anya (Harabor, Grastien, Öz and Aksakalli, 2016). A node is an interval on the line between
two rows of cells, all of which is seen from its root, the last corner of the path to it.
Coordinates are those of corners: cell (row, column) has its corners from (column, row) to
(column + 1, row + 1).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.navigation.costmap.layered_costmap import Costs
from mazebot.navigation.planning.grid.a_star import FOUND, GAVE_UP, NO_WAY, CostToCome
from mazebot.navigation.planning.grid.lines import polyline_cost
from mazebot.navigation.planning.grid.search_grid import NO_PRICE

Ends = NDArray[np.int32]
_LEAST = 1e-7
"""Intervals and bends smaller than this do not count, in cells."""


@kernel()
def _runs(cells: Costs, limit: int, left: Ends, right: Ends) -> None:
    """Where the free cells beside each other in a row begin, and the column after their end."""
    rows, columns = cells.shape
    for row in range(rows):
        begin = 0
        for column in range(columns):
            if cells[row, column] >= limit:
                begin = column + 1
            left[row, column] = begin
        end = columns
        for column in range(columns - 1, -1, -1):
            if cells[row, column] >= limit:
                end = column
            right[row, column] = end


@kernel()
def _least_length(
    root_x: float, root_y: float, y: float, a: float, b: float, goal_x: float, goal_y: float
) -> float:
    """Of a path from the root over the interval to the goal; a goal before it is mirrored."""
    if (goal_y - y) * (root_y - y) > 0.0:
        goal_y = 2.0 * y - goal_y
    at = root_x
    if abs(goal_y - root_y) > 1e-12:
        at = root_x + (goal_x - root_x) * (y - root_y) / (goal_y - root_y)
    at = min(max(at, a), b)
    up, out = y - root_y, goal_y - y
    return math.sqrt((at - root_x) * (at - root_x) + up * up) + math.sqrt(
        (goal_x - at) * (goal_x - at) + out * out
    )


@kernel()
def _larger(values: Array) -> Array:
    return np.concatenate((values, np.empty_like(values)))


@kernel()
def anya(
    cells: Costs,
    limit: int,
    left: Ends,
    right: Ends,
    start_x: float,
    start_y: float,
    goal_x: float,
    goal_y: float,
    max_iterations: int,
    per_cell: float,
    best: CostToCome,
) -> tuple[int, Array]:
    """(status, (n, 2) corners of the shortest path between two points in free cells).

    The path touches the corners of cells of value `limit` or more, and leads through no point where
    only two such cells meet. `left`, `right` and `best`, one value a cell, are overwritten: the
    grid has a border, so that corners have indices of cells.
    """
    stride = cells.shape[1]
    _runs(cells, limit, left, right)
    best[:] = np.inf
    start_row, goal_row = math.floor(start_y), math.floor(goal_y)
    goal_column = math.floor(goal_x)
    # Within a row, not on the line between two.
    root_start_y = min(max(start_y, start_row + 1e-6), start_row + 1.0 - 1e-6)
    # Nodes: a, b, row line, root; roots: x, y, cost, root before.
    size, used = 4096, 0
    node = np.empty((size, 4))
    following = np.empty(size, np.int64)
    roots_size, roots = 1024, 1
    root = np.empty((roots_size, 4))
    root[0, 0], root[0, 1], root[0, 2], root[0, 3] = start_x, root_start_y, 0.0, -1.0
    buckets = 1024
    head = np.full(buckets, -1, np.int64)
    shortest, last_root, waiting = np.inf, -1, 0
    begin = left[start_row, math.floor(start_x)]
    end = right[start_row, math.floor(start_x)]
    straight = math.sqrt(
        (goal_x - start_x) * (goal_x - start_x) + (goal_y - start_y) * (goal_y - start_y)
    )
    if goal_row == start_row and begin <= goal_column < end:
        shortest, last_root = straight, 0
    bucket = int(straight * per_cell)
    # Waiting successors of what is being expanded: root, row line, a, b.
    made = np.empty((4096, 4))
    count = 0
    for line in (start_row, start_row + 1):
        made[count, 0], made[count, 1] = 0.0, line
        made[count, 2], made[count, 3] = begin, end
        count += 1
    iterations = 0
    while True:
        for k in range(count):
            index, y, a, b = int(made[k, 0]), made[k, 1], made[k, 2], made[k, 3]
            if b - a < _LEAST:
                continue
            length = root[index, 2] + _least_length(
                root[index, 0], root[index, 1], y, a, b, goal_x, goal_y
            )
            if length >= shortest:
                continue
            if used == size:
                node = _larger(node)
                following = np.concatenate((following, np.empty(size, np.int64)))
                size *= 2
            node[used, 0], node[used, 1], node[used, 2], node[used, 3] = a, b, y, index
            key = min(max(int(length * per_cell), bucket), bucket + buckets - 1)
            following[used] = head[key % buckets]
            head[key % buckets] = used
            used += 1
            waiting += 1
        count = 0
        while waiting > 0 and head[bucket % buckets] < 0:
            bucket += 1
        if waiting == 0 or bucket > shortest * per_cell:
            break
        entry = head[bucket % buckets]
        head[bucket % buckets] = following[entry]
        waiting -= 1
        a, b, y, index = node[entry, 0], node[entry, 1], node[entry, 2], int(node[entry, 3])
        root_x, root_y, here = root[index, 0], root[index, 1], root[index, 2]
        if index > 0 and here > best[int(root_y) * stride + int(root_x)] * (1.0 + 1e-6) + 1e-4:
            continue
        iterations += 1
        if iterations > max_iterations:
            return GAVE_UP, np.empty((0, 2))
        ahead, line = 1, int(y)
        if root_y > y:
            ahead = -1
        row, behind = line, line - 1
        if ahead < 0:
            row, behind = line - 1, line
        slope = (y + ahead - root_y) / (y - root_y)
        column = math.floor(a + _LEAST)
        while column < b - _LEAST:
            if cells[row, column] >= limit:
                column += 1
                continue
            low, high = left[row, column], right[row, column]
            a1, b1 = max(a, low), min(b, high)
            if goal_row == row and low <= goal_column < high:
                length = here + _least_length(root_x, root_y, y, a1, b1, goal_x, goal_y)
                if length < shortest:
                    shortest = length
                    at = root_x + (goal_x - root_x) * (y - root_y) / (goal_y - root_y)
                    last_root = index
                    if at < a1 - _LEAST or at > b1 + _LEAST:
                        if roots == roots_size:
                            root = _larger(root)
                            roots_size *= 2
                        bend = min(max(at, a1), b1)
                        root[roots, 0], root[roots, 1] = bend, y
                        root[roots, 2], root[roots, 3] = here, index
                        last_root = roots
                        roots += 1
            seen_a = root_x + (a1 - root_x) * slope
            seen_b = root_x + (b1 - root_x) * slope
            made[count, 0], made[count, 1] = index, y + ahead
            made[count, 2], made[count, 3] = max(seen_a, low), min(seen_b, high)
            count += 1
            for side in (-1, 1):
                corner = a1
                beyond = low < a1 - _LEAST
                if side > 0:
                    corner = b1
                    beyond = high > b1 + _LEAST
                whole = math.floor(corner + 0.5)
                if abs(corner - whole) > _LEAST:
                    continue
                beside = whole - 1
                if side > 0:
                    beside = whole
                solid_behind = cells[behind, beside] >= limit
                if not beyond:
                    # The corner of a cell ahead hides what is beside it, unless seen from inwards.
                    hidden = seen_a - low
                    if side > 0:
                        hidden = high - seen_b
                    if solid_behind or hidden < _LEAST:
                        continue
                elif not solid_behind:
                    continue
                across, up = whole - root_x, y - root_y
                cost = here + math.sqrt(across * across + up * up)
                place = line * stride + whole
                if cost > best[place] * (1.0 + 1e-6) + 1e-4:
                    continue
                best[place] = min(best[place], cost)
                if roots == roots_size:
                    root = _larger(root)
                    roots_size *= 2
                turned = roots
                root[turned, 0], root[turned, 1] = whole, y
                root[turned, 2], root[turned, 3] = cost, index
                roots += 1
                if count + 2 * stride + 8 > len(made):
                    made = np.concatenate((made, np.empty((len(made) + 2 * stride, 4))))
                # What the corner hides from the root, in the row ahead.
                made[count, 0], made[count, 1] = turned, y + ahead
                if side < 0:
                    made[count, 2], made[count, 3] = low, min(max(seen_a, low), high)
                else:
                    made[count, 2], made[count, 3] = max(min(seen_b, high), low), high
                count += 1
                if not beyond:
                    continue
                # Along the line, on top of what is behind, to each corner to turn at.
                at_column = whole
                while True:
                    passed = at_column
                    to = at_column + 1
                    if side < 0:
                        passed = at_column - 1
                        to = at_column - 1
                    one_open = cells[line - 1, passed] < limit
                    other_open = cells[line, passed] < limit
                    if not one_open and not other_open:
                        break
                    onward = to
                    if side < 0:
                        onward = to - 1
                    one_next = cells[line - 1, onward] < limit
                    other_next = cells[line, onward] < limit
                    if not one_next and not other_next:
                        break
                    if (one_open != one_next) and (other_open != other_next):
                        # Only two cells meet there, corner to corner.
                        break
                    for step in (-1, 1):
                        turns = one_next and not one_open
                        into = line - 1
                        if step > 0:
                            turns = other_next and not other_open
                            into = line
                        if not turns:
                            continue
                        length = cost + abs(to - whole)
                        place = line * stride + to
                        if length > best[place] * (1.0 + 1e-6) + 1e-4:
                            continue
                        best[place] = min(best[place], length)
                        if roots == roots_size:
                            root = _larger(root)
                            roots_size *= 2
                        root[roots, 0], root[roots, 1] = to, y
                        root[roots, 2], root[roots, 3] = length, turned
                        made[count, 0], made[count, 1] = roots, y + step
                        made[count, 2], made[count, 3] = to, right[into, onward]
                        if side < 0:
                            made[count, 2], made[count, 3] = left[into, onward], to
                        count += 1
                        in_reach = left[into, onward] <= goal_column < right[into, onward]
                        if goal_row == into and in_reach:
                            out, up = goal_x - to, goal_y - y
                            length += math.sqrt(out * out + up * up)
                            if length < shortest:
                                shortest, last_root = length, roots
                        roots += 1
                    at_column = to
            column = high + 1
        if count + 2 * stride + 8 > len(made):
            made = np.concatenate((made, np.empty((len(made) + 2 * stride, 4))))
    if last_root < 0:
        return NO_WAY, np.empty((0, 2))
    length_of_path, index = 2, last_root
    while root[index, 3] >= 0.0:
        index = int(root[index, 3])
        length_of_path += 1
    points = np.empty((length_of_path, 2))
    points[length_of_path - 1, 0], points[length_of_path - 1, 1] = goal_x, goal_y
    index = last_root
    for i in range(length_of_path - 2, -1, -1):
        points[i, 0], points[i, 1] = root[index, 0], root[index, 1]
        index = int(root[index, 3])
    points[0, 0], points[0, 1] = start_x, start_y
    return FOUND, points


@kernel()
def _with_touched(cells: Costs, limit: int, corners: Array) -> Array:
    """The path with every corner of an obstacle that it touches, also those where it goes straight
    on.
    """
    total = 1
    for i in range(len(corners) - 1):
        total += 2 + int(abs(corners[i + 1, 0] - corners[i, 0]))
        total += int(abs(corners[i + 1, 1] - corners[i, 1]))
    points = np.empty((total, 2))
    count = 0
    for i in range(len(corners) - 1):
        points[count, 0], points[count, 1] = corners[i, 0], corners[i, 1]
        count += 1
        x0, y0 = corners[i, 0], corners[i, 1]
        dx, dy = corners[i + 1, 0] - x0, corners[i + 1, 1] - y0
        upright = abs(dy) > abs(dx)
        begin, length, other, rise = x0, dx, y0, dy
        if upright:
            begin, length, other, rise = y0, dy, x0, dx
        step = 1
        if length < 0.0:
            step = -1
        whole = math.floor(begin) + 1
        if step < 0:
            whole = math.ceil(begin) - 1
        while (begin + length - whole) * step > 1e-6:
            at = other + rise * (whole - begin) / length
            near = math.floor(at + 0.5)
            if abs(at - near) < 1e-6:
                column, row = whole, near
                if upright:
                    column, row = near, whole
                if (
                    cells[row - 1, column - 1] >= limit
                    or cells[row - 1, column] >= limit
                    or cells[row, column - 1] >= limit
                    or cells[row, column] >= limit
                ):
                    points[count, 0], points[count, 1] = column, row
                    count += 1
            whole += step
    last = len(corners) - 1
    points[count, 0], points[count, 1] = corners[last, 0], corners[last, 1]
    return points[: count + 1].copy()


@kernel()
def _off_corners(cells: Costs, limit: int, corners: Array, by: float) -> Array:
    """The path in coordinates of cells' centres, each bend moved away from the obstacles there."""
    points = corners - 0.5
    for i in range(1, len(corners) - 1):
        column, row = int(corners[i, 0] + 0.5), int(corners[i, 1] + 0.5)
        away_x, away_y = 0.0, 0.0
        for up in (-1, 0):
            for along in (-1, 0):
                if cells[row + up, column + along] >= limit:
                    away_x -= along + 0.5
                    away_y -= up + 0.5
        length = math.sqrt(away_x * away_x + away_y * away_y)
        if length > 0.0:
            points[i, 0] += by * away_x / length
            points[i, 1] += by * away_y / length
    return points


def pulled_off_corners(cells: Costs, limit: int, corners: Array) -> Array | None:
    """(n, 2) points of a path that touches no cell of value `limit` or more, as near to the given
    corners as can be; None if there is none within half a cell.
    """
    corners = _with_touched(cells, limit, corners)
    for by in (0.004, 0.02, 0.1, 0.5):
        points = np.asarray(_off_corners(cells, limit, corners, by))
        if np.isfinite(polyline_cost(cells, limit, NO_PRICE, points)):
            return points
    return None

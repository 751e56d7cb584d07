"""Finds where a cloud of points lies in an old part of the map, in a wide window.

Correlative matching (Olson, ICRA 2009) by branch and bound (Hess and others, ICRA 2016): a table
holds how near each cell is to a wall, and coarser tables hold the largest values of 2, 4, 8...
cells along each axis, so that one look bounds the score of all poses in a block. The best pose of
the raster is always found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.maths.kernels import kernel
from mazebot.common.maths.portable_kernels import exp
from mazebot.mapping.graph.pose_graph import Ints

Bytes = NDArray[np.uint8]

ELSEWHERE_M = 0.5
ELSEWHERE_RAD = math.radians(15.0)
"""Beyond one of these from the best pose, another one is elsewhere."""
_LEVELS = 5
"""The coarsest table joins 2 ** 5 cells along each axis."""
_FULL = 255
_RETURN_STD_M = 0.03
"""Of a point's distance from its wall at the right pose, noise of both clouds included."""
_CORRELATED = 10.0
"""Points that err together, as neighbours on one wall do."""
_NEIGHBOURS = 3
"""Cells and steps of angle, each way, of which the covariance is made."""
_LEAST_STEP_RAD = math.radians(0.25)
_RELEVANT = 0.2
"""The best pose elsewhere is looked for down to this much below the best score."""


@dataclass(frozen=True)
class SearchMap:
    """Tables of an old part of the map."""

    tables: Bytes
    """(levels + 1, rows, columns) 255 on a wall, and less the farther from it; at level h the
    largest value of 2 ** h cells up and to the right.
    """
    x_m: float
    y_m: float
    """Corner of cell (0, 0)."""
    resolution_m: float
    smear_m: float


@dataclass(frozen=True)
class LoopMatch:
    """Where a cloud fits best."""

    pose: SE2
    """map_from_cloud."""
    score: float
    """0 to 1: how near the points are to walls; above 0.6 where the cloud has been seen before."""
    elsewhere: float
    """The best score of a pose in the window more than 0.5 m or 15 degrees from this one; where
    that is more than 0.2 lower, 0.2 less than `score`. Close to `score`: ambiguous.
    """
    covariance: Array
    """(3, 3) of `pose`, by the map's axes."""


def search_map(points_m: Array, resolution_m: float = 0.05, smear_m: float = 0.06) -> SearchMap:
    """Tables of the occupied points (k, 2) of an old part of the map, by the map's axes.

    `smear_m`: distance from a point at which its value has fallen to 0.61. Raises ValueError
    without points.
    """
    if len(points_m) == 0:
        raise ValueError("no points to search in")
    points_m = np.ascontiguousarray(points_m, np.float64)
    margin = (1 << _LEVELS) + math.ceil(3.0 * smear_m / resolution_m)
    low = np.floor(points_m.min(axis=0) / resolution_m).astype(np.int64) - margin
    high = np.floor(points_m.max(axis=0) / resolution_m).astype(np.int64) + margin
    columns, rows = (high - low + 1).tolist()
    tables = np.zeros((_LEVELS + 1, rows, columns), np.uint8)
    x_m, y_m = (low * resolution_m).tolist()
    _fill(points_m, x_m, y_m, resolution_m, smear_m, tables)
    return SearchMap(tables, x_m, y_m, resolution_m, smear_m)


def loop_search(
    table: SearchMap,
    cloud_m: Array,
    guess: SE2,
    window_m: float,
    window_rad: float,
    least_score: float = 0.0,
) -> LoopMatch | None:
    """The pose of a cloud (m, 2) of points, map_from_cloud, with the highest score of all within
    `window_m` along x and along y and `window_rad` of a guess. None where no score is above
    `least_score`: the higher it is, the sooner that is known.

    The raster is one cell of the table, and the angle by which the farthest point moves one cell;
    the best pose is then moved within its cell to the top of a parabola.
    """
    if len(cloud_m) == 0:
        return None
    full = float(_FULL * len(cloud_m))
    cloud_m = np.ascontiguousarray(cloud_m, np.float64)
    step_rad = _step_rad(cloud_m, table.resolution_m)
    turns = math.ceil(window_rad / step_rad)
    cos, sin = portable_kernels.cos_sin_each(
        guess.yaw_rad + np.arange(-turns, turns + 1) * step_rad
    )
    cells = _cells(table, cloud_m, guess, cos, sin)
    half = math.ceil(window_m / table.resolution_m)
    # Nothing is left out: no angle, and no place.
    best = np.array([math.floor(least_score * full), -1, 0, 0], np.int64)
    none = np.array([0, 0, 0, -1, -1], np.int64)
    _search(table.tables, cells, half, none, best)
    total, turn, column, row = best.tolist()
    if turn < 0:
        return None
    score = total / full
    floor = max(0.0, score - _RELEVANT)
    other = np.array([math.floor(floor * full), -1, 0, 0], np.int64)
    near = np.array(
        [
            turn,
            column,
            row,
            math.floor(ELSEWHERE_RAD / step_rad),
            math.floor(ELSEWHERE_M / table.resolution_m),
        ],
        np.int64,
    )
    _search(table.tables, cells, half, near, other)
    elsewhere = int(other[0]) / full if other[1] >= 0 else floor
    around = _neighbourhood(table, cloud_m, guess, turn - turns, column, row, step_rad)
    offset, covariance = _spread(around / full, len(cloud_m), table, step_rad)
    pose = SE2(
        guess.x_m + (column + offset[0]) * table.resolution_m,
        guess.y_m + (row + offset[1]) * table.resolution_m,
        wrap_angle(guess.yaw_rad + (turn - turns + offset[2]) * step_rad),
    )
    return LoopMatch(pose, score, elsewhere, covariance)


def _step_rad(cloud_m: Array, resolution_m: float) -> float:
    farthest_m = max(float(portable.lengths(cloud_m).max()), resolution_m)
    cosine = 1.0 - resolution_m * resolution_m / (2.0 * farthest_m * farthest_m)
    return max(portable.acos(cosine), _LEAST_STEP_RAD)


def _cells(table: SearchMap, cloud_m: Array, guess: SE2, cos: Array, sin: Array) -> Ints:
    """(angles, 2, m) column and row of each point of the cloud at the guess's place."""
    cells = np.empty((len(cos), 2, len(cloud_m)), np.int64)
    _place(
        cloud_m, cos, sin, guess.x_m - table.x_m, guess.y_m - table.y_m, table.resolution_m, cells
    )
    return cells


def _neighbourhood(
    table: SearchMap, cloud_m: Array, guess: SE2, turn: int, column: int, row: int, step_rad: float
) -> Array:
    """(7, 7, 7) sums by steps of angle, columns and rows around a pose of the raster."""
    steps = np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
    cos, sin = portable_kernels.cos_sin_each(guess.yaw_rad + (turn + steps) * step_rad)
    cells = _cells(table, cloud_m, guess, cos, sin)
    sums = np.empty((steps.size,) * 3)
    _sums(table.tables[0], cells, column, row, sums)
    return sums


def _spread(
    scores: Array, points: int, table: SearchMap, step_rad: float
) -> tuple[tuple[float, float, float], Array]:
    """Offsets of the top within its cell, along columns, rows and angles in steps, and (3, 3)
    covariance, of the scores around the best pose.

    A point's score falls by half of its squared distance over `smear_m` squared, and its
    log-likelihood by half of it over the noise's variance: their ratio makes weights of scores.
    """
    ratio = portable.square(table.smear_m / _RETURN_STD_M)
    middle = _NEIGHBOURS
    weights = portable_kernels.exp_each(
        (scores - scores[middle, middle, middle]) * (points * ratio / _CORRELATED)
    )
    steps = np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1) * 1.0
    yaw, x, y = np.meshgrid(
        steps * step_rad, steps * table.resolution_m, steps * table.resolution_m, indexing="ij"
    )
    numbers = np.stack([x.ravel(), y.ravel(), yaw.ravel()])
    shares = weights.ravel() / weights.sum()
    from_mean = numbers - (numbers * shares).sum(axis=1)[:, None]
    covariance = portable.product(from_mean * shares, from_mean.T)
    # A cell's and a step's own width, evenly spread.
    cell = portable.square(table.resolution_m) / 12.0
    covariance += np.diag([cell, cell, portable.square(step_rad) / 12.0])
    top = float(scores[middle, middle, middle])
    offsets = (
        _top(
            float(scores[middle, middle - 1, middle]),
            top,
            float(scores[middle, middle + 1, middle]),
        ),
        _top(
            float(scores[middle, middle, middle - 1]),
            top,
            float(scores[middle, middle, middle + 1]),
        ),
        _top(
            float(scores[middle - 1, middle, middle]),
            top,
            float(scores[middle + 1, middle, middle]),
        ),
    )
    return offsets, covariance


def _top(before: float, here: float, after: float) -> float:
    """Where a parabola through three values is highest, from -0.5 to 0.5."""
    curve = before - 2.0 * here + after
    if not curve < 0.0:
        return 0.0
    return min(max(0.5 * (before - after) / curve, -0.5), 0.5)


@kernel("void(float64[:, ::1], float64, float64, float64, float64, uint8[:, :, ::1])")
def _fill(
    points: Array, x_m: float, y_m: float, resolution_m: float, smear_m: float, tables: Bytes
) -> None:
    reach = math.ceil(3.0 * smear_m / resolution_m)
    level = tables[0]
    rows, columns = level.shape
    for i in range(points.shape[0]):
        x, y = (points[i, 0] - x_m) / resolution_m, (points[i, 1] - y_m) / resolution_m
        column, row = math.floor(x), math.floor(y)
        for r in range(max(0, row - reach), min(rows, row + reach + 1)):
            for c in range(max(0, column - reach), min(columns, column + reach + 1)):
                dx, dy = (c + 0.5 - x) * resolution_m, (r + 0.5 - y) * resolution_m
                value = 255.0 * exp(-0.5 * (dx * dx + dy * dy) / (smear_m * smear_m))
                rounded = np.uint8(math.floor(value + 0.5))
                level[r, c] = max(level[r, c], rounded)
    for h in range(1, tables.shape[0]):
        below, above = tables[h - 1], tables[h]
        width = 1 << (h - 1)
        for r in range(rows):
            up = r + width
            for c in range(columns):
                right = c + width
                value = below[r, c]
                if right < columns:
                    value = max(value, below[r, right])
                if up < rows:
                    value = max(value, below[up, c])
                    if right < columns:
                        value = max(value, below[up, right])
                above[r, c] = value


@kernel(
    "void(float64[:, ::1], float64[::1], float64[::1], float64, float64, float64, int64[:, :, ::1])"
)
def _place(
    cloud: Array,
    cos: Array,
    sin: Array,
    x_m: float,
    y_m: float,
    resolution_m: float,
    cells: Ints,
) -> None:
    for a in range(cos.size):
        for i in range(cloud.shape[0]):
            x = x_m + cos[a] * cloud[i, 0] - sin[a] * cloud[i, 1]
            y = y_m + sin[a] * cloud[i, 0] + cos[a] * cloud[i, 1]
            cells[a, 0, i] = math.floor(x / resolution_m)
            cells[a, 1, i] = math.floor(y / resolution_m)


@kernel("int64(uint8[:, ::1], int64[:, ::1], int64, int64)")
def _sum(table: Bytes, cells: Ints, column: int, row: int) -> int:
    rows, columns = np.uint64(table.shape[0]), np.uint64(table.shape[1])
    total = 0
    for i in range(cells.shape[1]):
        # Negative ones become large.
        c, r = np.uint64(cells[0, i] + column), np.uint64(cells[1, i] + row)
        if c < columns and r < rows:
            total += table[r, c]
    return total


@kernel("void(uint8[:, ::1], int64[:, :, ::1], int64, int64, float64[:, :, ::1])")
def _sums(table: Bytes, cells: Ints, column: int, row: int, sums: Array) -> None:
    for a in range(sums.shape[0]):
        for c in range(sums.shape[1]):
            for r in range(sums.shape[2]):
                sums[a, c, r] = _sum(
                    table,
                    cells[a],
                    column + c - sums.shape[1] // 2,
                    row + r - sums.shape[2] // 2,
                )


@kernel("void(uint8[:, :, ::1], int64[:, :, ::1], int64, int64[::1], int64[::1])")
def _search(tables: Bytes, cells: Ints, half: int, near: Ints, best: Ints) -> None:
    """Write sum, angle, column and row of the best pose to `best`, if its sum is above the one
    there. `near`: angle, column, row of a pose, and the steps and cells within which none counts;
    -1 steps: all count.
    """
    coarsest = tables.shape[0] - 1
    width = 1 << coarsest
    across = (2 * half + width) // width
    count = cells.shape[0] * across * across
    heads = np.empty((count, 4), np.int64)
    k = 0
    for a in range(cells.shape[0]):
        for i in range(across):
            for j in range(across):
                column, row = i * width - half, j * width - half
                heads[k, 0] = _sum(tables[coarsest], cells[a], column, row)
                heads[k, 1], heads[k, 2], heads[k, 3] = a, column, row
                k += 1
    order = np.argsort(-heads[:, 0], kind="mergesort")
    stack = np.empty((4 * (coarsest + 1), 5), np.int64)
    four = np.empty((4, 3), np.int64)
    for index in order:
        if heads[index, 0] <= best[0]:
            break
        stack[0, 0], stack[0, 1] = heads[index, 0], coarsest
        stack[0, 2], stack[0, 3], stack[0, 4] = heads[index, 1], heads[index, 2], heads[index, 3]
        depth = 1
        while depth > 0:
            depth -= 1
            bound, level, a = stack[depth, 0], stack[depth, 1], stack[depth, 2]
            column, row = stack[depth, 3], stack[depth, 4]
            if bound <= best[0]:
                continue
            width = 1 << level
            if abs(a - near[0]) <= near[3]:
                if (
                    column >= near[1] - near[4]
                    and column + width - 1 <= near[1] + near[4]
                    and row >= near[2] - near[4]
                    and row + width - 1 <= near[2] + near[4]
                ):
                    continue
            if level == 0:
                best[0], best[1], best[2], best[3] = bound, a, column, row
                continue
            width >>= 1
            found = 0
            for i in range(2):
                for j in range(2):
                    c, r = column + i * width, row + j * width
                    if c > half or r > half:
                        continue
                    total = _sum(tables[level - 1], cells[a], c, r)
                    if total <= best[0]:
                        continue
                    # Ascending, so that the best is on top of the stack.
                    at = found
                    while at > 0 and four[at - 1, 0] > total:
                        four[at] = four[at - 1]
                        at -= 1
                    four[at, 0], four[at, 1], four[at, 2] = total, c, r
                    found += 1
            for i in range(found):
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = four[i, 0], level - 1, a
                stack[depth, 3], stack[depth, 4] = four[i, 1], four[i, 2]
                depth += 1

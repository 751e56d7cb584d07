"""Where a scan fits the local map, searched in a window: every pose of it, coarse and fine.

Correlative scan matching (Olson, ICRA 2009): the score of a pose is the mean, over the returns, of
a table that falls with the distance to the nearest surfel. A second table holds at each cell the
maximum of the cells that a block of shifts can reach, so a block's coarse score is never below the
score of any pose in it: blocks are expanded, the best first, until no other can win. The result is
that of trying all poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.maths.kernels import kernel
from mazebot.mapping.matching.local_map import LocalMap

_BLOCK = 4
"""Shifts of a block, to each side of a square."""
NOT_UNLIKELY = np.zeros((3, 3))
_SHARP = 60.0
"""How fast the likelihood of a pose falls with its score below the best one."""


@dataclass(frozen=True)
class Correlated:
    """The pose with the highest score, to the fineness of the search."""

    map_from_base: SE2
    score: float
    """0 to 1: 1 where every return is on a surfel"""
    covariance: Array
    """(3, 3) of x, y in the map and yaw, by the scores of all poses that were tried"""


def score_tables(
    local: LocalMap, smear_deviation_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(rows, columns) scores of a return in each cell, and the maxima over blocks of shifts."""
    squared = portable.square(local.distance_m.astype(np.float64))
    finite = np.isfinite(squared)
    scores = np.zeros(squared.shape)
    scores[finite] = portable_kernels.exp_each(
        squared[finite] * (-0.5 / (smear_deviation_m * smear_deviation_m))
    )
    fine = np.ascontiguousarray(scores, np.float32)
    coarse = np.empty((fine.shape[0] + _BLOCK - 1, fine.shape[1] + _BLOCK - 1), np.float32)
    _pool(fine, coarse)
    return fine, coarse


def correlate(
    local: LocalMap,
    guess: SE2,
    points_m: Array,
    window_m: float,
    window_rad: float,
    step_rad: float,
    smear_deviation_m: float,
    unlikely: Array = NOT_UNLIKELY,
    cost: float = 0.0,
) -> Correlated:
    """Search x and y within `window_m` and yaw within `window_rad` of a guess, map_from_base, for
    where returns (n, 2), in the base's frame, fit a local map.

    x and y are searched by the local map's cells. `unlikely`: (3, 3) information of the guess; a
    pose at a squared Mahalanobis distance d from it counts `cost` log(1 + d / 3) less.
    """
    none = Correlated(guess, 0.0, np.diag([window_m * window_m] * 2 + [window_rad * window_rad]))
    if len(points_m) == 0 or not local.has_surfels:
        return none
    fine, coarse = score_tables(local, smear_deviation_m)
    half = max(1, math.ceil(window_m / local.cell_m))
    turns = max(0, math.ceil(window_rad / step_rad - 1e-9))
    sums = np.zeros(10)
    best = _search(
        fine, coarse, np.ascontiguousarray(points_m), guess.x_m - local.x_m, guess.y_m - local.y_m,
        guess.yaw_rad, 1.0 / local.cell_m, half, turns, step_rad,
        np.ascontiguousarray(unlikely, np.float64), cost, sums,
    )  # fmt: skip
    score, row, column, turn = best
    if score <= 0.0:
        return none
    pose = SE2(
        guess.x_m + column * local.cell_m,
        guess.y_m + row * local.cell_m,
        wrap_angle(guess.yaw_rad + turn * step_rad),
    )
    return Correlated(pose, float(score), _covariance(sums, local.cell_m, step_rad))


def _covariance(sums: Array, cell_m: float, step_rad: float) -> Array:
    """From the sums of weights, first and second moments, in steps (Olson, section 4)."""
    w, x, y, t, xx, xy, yy, xt, yt, tt = sums.tolist()
    x, y, t = x / w, y / w, t / w
    steps = np.array(
        [
            [xx / w - x * x, xy / w - x * y, xt / w - x * t],
            [xy / w - x * y, yy / w - y * y, yt / w - y * t],
            [xt / w - x * t, yt / w - y * t, tt / w - t * t],
        ]
    )
    size = np.array([cell_m, cell_m, step_rad])
    # A pose is known to a step at best.
    covariance: Array = (steps + np.eye(3) / 12.0) * size[:, None] * size
    return covariance


@kernel("void(float32[:, ::1], float32[:, ::1])")
def _pool(fine: NDArray[np.float32], coarse: NDArray[np.float32]) -> None:
    """coarse[r + B - 1, c + B - 1] is the maximum of fine[r : r + B, c : c + B]."""
    rows, columns = fine.shape
    across = np.zeros((rows, columns + _BLOCK - 1), np.float32)
    for r in range(rows):
        for c in range(columns + _BLOCK - 1):
            most = np.float32(0.0)
            for k in range(max(0, c - _BLOCK + 1), min(columns, c + 1)):
                most = max(most, fine[r, k])
            across[r, c] = most
    for r in range(rows + _BLOCK - 1):
        for c in range(columns + _BLOCK - 1):
            most = np.float32(0.0)
            for k in range(max(0, r - _BLOCK + 1), min(rows, r + 1)):
                most = max(most, across[k, c])
            coarse[r, c] = most


@kernel(
    "UniTuple(float64, 4)(float32[:, ::1], float32[:, ::1], float64[:, ::1], float64, float64, "
    "float64, float64, int64, int64, float64, float64[:, ::1], float64, float64[::1])"
)
def _search(
    fine: NDArray[np.float32],
    coarse: NDArray[np.float32],
    points: Array,
    x: float,
    y: float,
    yaw: float,
    cells_per_m: float,
    half: int,
    turns: int,
    step: float,
    unlikely: Array,
    cost: float,
    sums: Array,
) -> tuple[float, float, float, float]:
    rows, columns = fine.shape
    n = points.shape[0]
    angles = 2 * turns + 1
    blocks = (2 * half + 1 + _BLOCK - 1) // _BLOCK
    cells = np.empty((angles, n, 2), np.int64)
    bounds = np.zeros(angles * blocks * blocks)
    for a in range(angles):
        c, s = portable_kernels.cos_sin(yaw + (a - turns) * step)
        for j in range(n):
            u = (x + c * points[j, 0] - s * points[j, 1]) * cells_per_m
            v = (y + s * points[j, 0] + c * points[j, 1]) * cells_per_m
            cells[a, j, 0], cells[a, j, 1] = math.floor(v), math.floor(u)
        for by in range(blocks):
            for bx in range(blocks):
                total = 0.0
                for j in range(n):
                    r = cells[a, j, 0] - half + by * _BLOCK + _BLOCK - 1
                    k = cells[a, j, 1] - half + bx * _BLOCK + _BLOCK - 1
                    if r >= 0 and k >= 0 and r < coarse.shape[0] and k < coarse.shape[1]:
                        total += coarse[r, k]
                bounds[(a * blocks + by) * blocks + bx] = total / n
    best, best_row, best_column, best_turn = 0.0, 0, 0, 0
    # The order is by bound, and of equals by place: the same everywhere.
    order = np.argsort(-bounds, kind="mergesort")
    # Poses that are nearly as good count for the covariance.
    slack = 4.0 / _SHARP
    tried = np.empty((0, 4))
    room = 0
    used = 0
    for o in range(order.size):
        block = order[o]
        if bounds[block] <= 0.0 or bounds[block] < best - slack:
            break
        a = block // (blocks * blocks)
        by, bx = (block // blocks) % blocks, block % blocks
        for dy in range(_BLOCK):
            row = by * _BLOCK + dy - half
            if row > half:
                break
            for dx in range(_BLOCK):
                column = bx * _BLOCK + dx - half
                if column > half:
                    break
                total = 0.0
                for j in range(n):
                    r, k = cells[a, j, 0] + row, cells[a, j, 1] + column
                    if r >= 0 and k >= 0 and r < rows and k < columns:
                        total += fine[r, k]
                score = total / n
                if cost > 0.0 and score > best - slack:
                    ex, ey, et = column / cells_per_m, row / cells_per_m, (a - turns) * step
                    q = unlikely
                    d = q[0, 0] * ex * ex + q[1, 1] * ey * ey + q[2, 2] * et * et
                    d += 2.0 * (q[0, 1] * ex * ey + q[0, 2] * ex * et + q[1, 2] * ey * et)
                    score -= cost * portable_kernels.log(1.0 + d / 3.0)
                if score > best:
                    best, best_row, best_column, best_turn = score, row, column, a - turns
                if score >= best - slack:
                    if used == room:
                        room = 2 * room + 256
                        grown = np.empty((room, 4))
                        grown[:used] = tried[:used]
                        tried = grown
                    tried[used, 0], tried[used, 1] = score, column
                    tried[used, 2], tried[used, 3] = row, a - turns
                    used += 1
    for i in range(used):
        w = portable_kernels.exp(_SHARP * (tried[i, 0] - best))
        px, py, pt = tried[i, 1], tried[i, 2], tried[i, 3]
        sums[0] += w
        sums[1] += w * px
        sums[2] += w * py
        sums[3] += w * pt
        sums[4] += w * px * px
        sums[5] += w * px * py
        sums[6] += w * py * py
        sums[7] += w * px * pt
        sums[8] += w * py * pt
        sums[9] += w * pt * pt
    return best, float(best_row), float(best_column), float(best_turn)

"""Whether two parts of the map contradict each other where a loop lays them over one another.

A score says how much of the one fits the other. Rooms that look alike fit well, too, but one of
them has a wall where the other has been seen to be empty: that no right loop has, however little of
the two is in common.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel

Bytes = NDArray[np.uint8]

MOST_CONTRADICTION = 0.03
"""Of a right loop: with keyframes 3 cm and 1 degree off each other, one in a hundred has more; of
loops of a maze to places that look alike, one in twenty has less.
"""
_CELL_M = 0.05
_CLEAR_M = 0.15
"""Nearer to its end than this, a beam does not show that the floor is free."""
_NEAR_CELLS = 3
"""So near to an end of the one part, ends of the other do not contradict."""
_MOST_BEAMS = 3000
_LEAST_COMMON = 20
"""With fewer ends in the common part, nothing can be decided."""


def contradiction(old_m: Array, new_m: Array, cell_m: float = _CELL_M) -> float:
    """The share, 0 to 1, of the beams' ends of one part that stand where beams of the other part
    passed and none ended near; of both parts the larger share. 0 where they have little in common.

    `old_m`, `new_m`: (n, 4) ends of beams and the lidar's places, x, y, x, y in one frame. See
    MOST_CONTRADICTION.
    """
    old_m, new_m = _fewer(old_m), _fewer(new_m)
    if not (len(old_m) and len(new_m)):
        return 0.0
    low = np.maximum(_low(old_m), _low(new_m)) - cell_m
    high = np.minimum(_high(old_m), _high(new_m)) + cell_m
    if not (high > low).all():
        return 0.0
    columns, rows = (np.floor((high - low) / cell_m).astype(np.int64) + 1).tolist()
    shares = []
    for beams, ends in ((old_m, new_m), (new_m, old_m)):
        cells = np.zeros((rows, columns), np.uint8)
        _draw(beams, float(low[0]), float(low[1]), cell_m, _CLEAR_M, _NEAR_CELLS, cells)
        common, wrong = _judge(ends, float(low[0]), float(low[1]), cell_m, cells)
        shares.append(wrong / common if common >= _LEAST_COMMON else 0.0)
    return max(shares)


def _fewer(beams_m: Array) -> Array:
    """Evenly chosen ones."""
    stride = -(-len(beams_m) // _MOST_BEAMS) if len(beams_m) else 1
    return np.ascontiguousarray(beams_m[::stride], np.float64)


def _low(beams_m: Array) -> Array:
    return np.asarray(np.minimum(beams_m[:, :2].min(axis=0), beams_m[:, 2:].min(axis=0)))


def _high(beams_m: Array) -> Array:
    return np.asarray(np.maximum(beams_m[:, :2].max(axis=0), beams_m[:, 2:].max(axis=0)))


@kernel("void(float64[:, ::1], float64, float64, float64, float64, int64, uint8[:, ::1])")
def _draw(
    beams: Array,
    x_m: float,
    y_m: float,
    cell_m: float,
    clear_m: float,
    near: int,
    cells: Bytes,
) -> None:
    """Write 1 where beams passed, and 2 near their ends."""
    rows, columns = cells.shape
    for i in range(beams.shape[0]):
        dx, dy = beams[i, 0] - beams[i, 2], beams[i, 1] - beams[i, 3]
        length = math.sqrt(dx * dx + dy * dy)
        steps = math.floor((length - clear_m) / (0.7 * cell_m))
        for k in range(steps):
            share = k * 0.7 * cell_m / length
            c = math.floor((beams[i, 2] + share * dx - x_m) / cell_m)
            r = math.floor((beams[i, 3] + share * dy - y_m) / cell_m)
            if 0 <= r < rows and 0 <= c < columns:
                cells[r, c] = 1
    for i in range(beams.shape[0]):
        column = math.floor((beams[i, 0] - x_m) / cell_m)
        row = math.floor((beams[i, 1] - y_m) / cell_m)
        for r in range(max(0, row - near), min(rows, row + near + 1)):
            for c in range(max(0, column - near), min(columns, column + near + 1)):
                cells[r, c] = 2


@kernel("UniTuple(int64, 2)(float64[:, ::1], float64, float64, float64, uint8[:, ::1])")
def _judge(ends: Array, x_m: float, y_m: float, cell_m: float, cells: Bytes) -> tuple[int, int]:
    """How many ends are where something is known, and how many of them where it is free."""
    rows, columns = cells.shape
    common, wrong = 0, 0
    for i in range(ends.shape[0]):
        c = math.floor((ends[i, 0] - x_m) / cell_m)
        r = math.floor((ends[i, 1] - y_m) / cell_m)
        if 0 <= r < rows and 0 <= c < columns and cells[r, c] > 0:
            common += 1
            if cells[r, c] == 1:
                wrong += 1
    return common, wrong

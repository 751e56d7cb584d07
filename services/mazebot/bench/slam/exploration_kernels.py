"""A lidar for the offline benchmark of exploration: rays over the true map."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Cells


@kernel("int64(int8[:, ::1], float64, float64, float64, int64, int8[:, ::1])")
def reveal(
    truth: Cells, row: float, column: float, range_cells: float, beams: int, known: Cells
) -> int:
    """Copy into `known` the cells of `truth` that a lidar sees: free ones along each beam, up to
    the first occupied one. Positions in cells, centres at whole numbers. Returns how many are new.
    """
    rows, columns = truth.shape
    new = 0
    for beam in range(beams):
        angle = 2.0 * math.pi * beam / beams
        down, right = math.sin(angle), math.cos(angle)
        for step in range(int(range_cells * 2.0) + 1):
            r = math.floor(row + 0.5 * step * down + 0.5)
            c = math.floor(column + 0.5 * step * right + 0.5)
            if r < 0 or c < 0 or r >= rows or c >= columns:
                break
            if known[r, c] < 0:
                new += 1
            if truth[r, c] != 0:
                known[r, c] = 100
                break
            known[r, c] = 0
    return new


@kernel("void(int8[:, ::1], int64, int64, float64, int64, boolean[:, ::1])")
def mark_seen(
    truth: Cells, row: int, column: int, range_cells: float, beams: int, seen: NDArray[np.bool_]
) -> None:
    """Mark the free cells that a lidar sees from a cell."""
    rows, columns = truth.shape
    for beam in range(beams):
        angle = 2.0 * math.pi * beam / beams
        down, right = math.sin(angle), math.cos(angle)
        for step in range(int(range_cells * 2.0) + 1):
            r = math.floor(row + 0.5 * step * down + 0.5)
            c = math.floor(column + 0.5 * step * right + 0.5)
            if r < 0 or c < 0 or r >= rows or c >= columns or truth[r, c] != 0:
                break
            seen[r, c] = True

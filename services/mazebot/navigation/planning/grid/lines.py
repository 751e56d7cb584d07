"""Straight lines over the search grid: exact over every cell that they touch."""

from __future__ import annotations

import math

import numpy as np

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.navigation.costmap.layered_costmap import Costs
from mazebot.navigation.planning.grid.search_grid import Prices

_CORNER = 1e-9
"""A line this near to a cell's corner, as a share of its length, goes through the corner."""


@kernel("float64(uint8[:, ::1], int64, float32[::1], float64, float64, float64, float64, float64)")
def line_cost(
    cells: Costs, limit: int, price: Prices, x0: float, y0: float, x1: float, y1: float, most: float
) -> float:
    """Cost of a straight line, in cells; infinite if it touches a cell of value `limit` or more,
    or costs more than `most`.

    The line is cut at the sides of the cells (Amanatides and Woo, 1987); each piece costs its
    length times twice its cell's price. Through a corner it touches all four cells there. An empty
    `price` is 0.5 everywhere.
    """
    column, row = math.floor(x0 + 0.5), math.floor(y0 + 0.5)
    rows, columns = cells.shape
    if not (0 <= row < rows and 0 <= column < columns) or cells[row, column] >= limit:
        return np.inf
    dx, dy = x1 - x0, y1 - y0
    length = math.sqrt(dx * dx + dy * dy)
    if length > most:
        return np.inf
    step_x, step_y = 1, 1
    if dx < 0.0:
        step_x = -1
    if dy < 0.0:
        step_y = -1
    next_x, next_y, per_x, per_y = np.inf, np.inf, np.inf, np.inf
    if dx != 0.0:
        per_x = abs(1.0 / dx)
        next_x = (column + 0.5 * step_x - x0) / dx
    if dy != 0.0:
        per_y = abs(1.0 / dy)
        next_y = (row + 0.5 * step_y - y0) / dy
    priced = price.size > 0
    at, total = 0.0, 0.0
    while True:
        leaves = min(next_x, next_y)
        if leaves >= 1.0:
            break
        if priced:
            total += (leaves - at) * price[cells[row, column]]
            at = leaves
        if abs(next_x - next_y) <= _CORNER:
            if cells[row, column + step_x] >= limit or cells[row + step_y, column] >= limit:
                return np.inf
            column += step_x
            row += step_y
            next_x += per_x
            next_y += per_y
        elif next_x < next_y:
            column += step_x
            next_x += per_x
        else:
            row += step_y
            next_y += per_y
        if not (0 <= row < rows and 0 <= column < columns) or cells[row, column] >= limit:
            return np.inf
    if not priced:
        return length
    total = 2.0 * length * (total + (1.0 - at) * price[cells[row, column]])
    if total > most:
        return np.inf
    return float(total)


@kernel()
def polyline_cost(cells: Costs, limit: int, price: Prices, points: Array) -> float:
    """Cost of a polyline of (n, 2) points; infinite where it touches a cell of value `limit`."""
    total = 0.0
    for i in range(len(points) - 1):
        total += line_cost(
            cells, limit, price, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1],
            np.inf,
        )  # fmt: skip
    return total

"""Shorter and rounder paths that stay in free space: each changed segment is examined over every
cell that it touches.
"""

from __future__ import annotations

import math

import numpy as np

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.costmap.footprint import distance_at
from mazebot.navigation.costmap.layered_costmap import Costs
from mazebot.navigation.planning.grid.lines import line_cost
from mazebot.navigation.planning.grid.search_grid import Prices

_LOOK_BACK = 48
"""Earlier points to which a line is tried from each."""
_KEEP_EACH = 4
"""Of the points on a straight part of a path, every so many are candidates for corners."""


@kernel()
def thinned(points: Array) -> Array:
    """(m, 2) of (n, 2) points, without most of those on straight parts."""
    n = len(points)
    kept = np.empty((n, 2))
    count, since = 0, 0
    for i in range(n):
        since += 1
        if 0 < i < n - 1 and since < _KEEP_EACH:
            ax, ay = points[i, 0] - kept[count - 1, 0], points[i, 1] - kept[count - 1, 1]
            bx, by = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
            if abs(ax * by - ay * bx) < 1e-9 and ax * bx + ay * by > 0.0:
                continue
        kept[count, 0], kept[count, 1] = points[i, 0], points[i, 1]
        count += 1
        since = 0
    return kept[:count].copy()


@kernel()
def cheapest_polyline(cells: Costs, limit: int, price: Prices, points: Array) -> Array:
    """(m, 2) of those of (n, 2) points that make the cheapest polyline from the first to the last
    of lines over a limited number of points each.
    """
    n = len(points)
    best = np.full(n, np.inf)
    came_from = np.zeros(n, np.int64)
    best[0] = 0.0
    for j in range(1, n):
        # From near to far: the nearest ones give a limit that ends most of the far ones early.
        for i in range(j - 1, max(-1, j - 1 - _LOOK_BACK), -1):
            most = best[j] - best[i]
            if most <= 0.0:
                continue
            cost = best[i] + line_cost(
                cells, limit, price, points[i, 0], points[i, 1], points[j, 0], points[j, 1], most
            )
            if cost < best[j]:
                best[j] = cost
                came_from[j] = i
    count, j = 1, n - 1
    while j > 0:
        j = came_from[j]
        count += 1
    chosen = np.empty((count, 2))
    j = n - 1
    for k in range(count - 1, -1, -1):
        chosen[k] = points[j]
        j = came_from[j]
    return chosen


@kernel()
def tightened(cells: Costs, limit: int, price: Prices, points: Array, passes: int) -> Array:
    """(n, 2) points, each moved towards the line between its neighbours as long as that makes the
    path cheaper: a string drawn tight, where every cell costs the same.
    """
    points = points.copy()
    n = len(points)
    for _ in range(passes):
        gained = 0.0
        for i in range(1, n - 1):
            ax, ay = points[i - 1, 0], points[i - 1, 1]
            bx, by = points[i + 1, 0], points[i + 1, 1]
            x, y = points[i, 0], points[i, 1]
            ux, uy = bx - ax, by - ay
            square = ux * ux + uy * uy
            share = 0.5
            if square > 0.0:
                share = min(max(((x - ax) * ux + (y - ay) * uy) / square, 0.0), 1.0)
            to_x, to_y = ax + share * ux - x, ay + share * uy - y
            if to_x * to_x + to_y * to_y < 1e-6:
                continue
            now = line_cost(cells, limit, price, ax, ay, x, y, np.inf)
            now += line_cost(cells, limit, price, x, y, bx, by, np.inf)
            part = 1.0
            for _ in range(7):
                new_x, new_y = x + part * to_x, y + part * to_y
                cost = line_cost(cells, limit, price, ax, ay, new_x, new_y, now)
                if cost < now:
                    cost += line_cost(cells, limit, price, new_x, new_y, bx, by, now - cost)
                if cost < now - 1e-9:
                    points[i, 0], points[i, 1] = new_x, new_y
                    gained += now - cost
                    break
                part *= 0.5
        if gained < 1e-3:
            break
    return points


@kernel()
def densified(points: Array, spacing: float) -> Array:
    """(m, 2) points on a polyline of (n, 2): its corners, and others at most `spacing` apart."""
    n = len(points)
    total = 1
    for i in range(n - 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        total += max(1, math.ceil(math.sqrt(dx * dx + dy * dy) / spacing - 1e-6))
    dense = np.empty((total, 2))
    at = 0
    for i in range(n - 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        parts = max(1, math.ceil(math.sqrt(dx * dx + dy * dy) / spacing - 1e-6))
        for k in range(parts):
            dense[at, 0] = points[i, 0] + dx * k / parts
            dense[at, 1] = points[i, 1] + dy * k / parts
            at += 1
    dense[at, 0], dense[at, 1] = points[n - 1, 0], points[n - 1, 1]
    return dense


@kernel()
def _is_free(
    cells: Costs, limit: int, no_price: Prices, x0: float, y0: float, x1: float, y1: float
) -> bool:
    """Whether a line touches no cell of value `limit` or more; both its ends are in the grid.

    A line within a cell, or between two beside each other, touches no other.
    """
    row, column = math.floor(y0 + 0.5), math.floor(x0 + 0.5)
    to_row, to_column = math.floor(y1 + 0.5), math.floor(x1 + 0.5)
    if abs(to_row - row) + abs(to_column - column) <= 1:
        return bool(cells[row, column] < limit and cells[to_row, to_column] < limit)
    return bool(np.isfinite(line_cost(cells, limit, no_price, x0, y0, x1, y1, np.inf)))


@kernel()
def rounded(
    cells: Costs,
    limit: int,
    no_price: Prices,
    clearance_m: Clearance,
    safe_m: float,
    give_m: float,
    points: Array,
    passes: int,
) -> Array:
    """(n, 2) points with their corners rounded by Gauss-Seidel relaxation held to the original.

    No point comes nearer to an obstacle than `safe_m`, or by `give_m` than it was if that was
    nearer, and no segment touches a cell of value `limit`.
    """
    pull_to_neighbours, pull_to_original = 0.45, 0.02
    original = points
    points = points.copy()
    nearest_m = np.empty(len(points))
    for i in range(len(points)):
        here_m = distance_at(clearance_m, points[i, 0] - 0.5, points[i, 1] - 0.5)
        nearest_m[i] = min(safe_m, here_m - give_m)
    for _ in range(passes):
        moved = 0.0
        for i in range(1, len(points) - 1):
            x, y = points[i, 0], points[i, 1]
            dx = pull_to_neighbours * (points[i - 1, 0] + points[i + 1, 0] - 2.0 * x)
            dy = pull_to_neighbours * (points[i - 1, 1] + points[i + 1, 1] - 2.0 * y)
            dx += pull_to_original * (original[i, 0] - x)
            dy += pull_to_original * (original[i, 1] - y)
            square = dx * dx + dy * dy
            if square < 1e-6:
                continue
            new_x, new_y = x + dx, y + dy
            row, column = math.floor(new_y + 0.5), math.floor(new_x + 0.5)
            if cells[row, column] >= limit:
                continue
            if distance_at(clearance_m, new_x - 0.5, new_y - 0.5) < nearest_m[i]:
                continue
            if _is_free(
                cells, limit, no_price, new_x, new_y, points[i - 1, 0], points[i - 1, 1]
            ) and _is_free(
                cells, limit, no_price, new_x, new_y, points[i + 1, 0], points[i + 1, 1]
            ):
                points[i, 0], points[i, 1] = new_x, new_y
                moved = max(moved, square)
        if moved < 1e-5:
            break
    return points

"""Free poses of a round robot on a map: the rule of Nav2's costmap, shared by map generation, pose
checks and planning.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2
from mazebot.common.robot.waffle import WAFFLE_FOOTPRINT_M, WAFFLE_RADIUS_M
from mazebot.common.world.grids import connected_regions, distance_cells

Cells = NDArray[np.int8]
Clearance = NDArray[np.float32]
Mask = NDArray[np.bool_]

ROBOT_RADIUS_M = WAFFLE_RADIUS_M + 0.02
"""Navigation's default `robot_radius`: a waffle as a disc, and 2 cm margin."""
INSCRIBED_RADIUS_M = max(y_m for _, y_m in WAFFLE_FOOTPRINT_M)
"""Navigation's default `custom_inscribed_radius`: half of a waffle's width, with which it drives
straight through a gap.
"""
FREE, OCCUPIED, UNKNOWN = 0, 100, -1
"""Values of a map's cells; one of at least OCCUPIED is a lethal obstacle, below 0 it is unknown."""
START_TOLERANCE_M = 0.5
"""Navigation's default `start_tolerance`: a start in inflated cells moves to a free cell this near.
"""

MAX_MAP_CELLS = 4_000_000
"""Of a map, e.g. 100 m by 100 m in cells of 5 cm: costmap and localisation take some 100 bytes for
each.
"""

MAX_CELLS = 16_000_000
"""Of a map's file, and of what a world is made into."""

_STRAIGHT_RAD = 1e-6
"""A map rotated by less counts as not rotated."""


def clearance_m(lethal: Mask, resolution_m: float) -> Clearance:
    """(rows, columns) float32, distance from a cell's centre to that of the nearest lethal cell; no
    more than the grid's diagonal.
    """
    rows, columns = lethal.shape
    far_m = math.hypot(rows, columns) * resolution_m
    cells = np.asarray(distance_cells(lethal), np.float32)
    return np.asarray(np.minimum(cells * resolution_m, far_m), np.float32)


def inscribed(clearance: Clearance, robot_radius_m: float = ROBOT_RADIUS_M) -> Mask:
    """(rows, columns): cells where the robot's circle hits a lethal cell (cost 253 and more)."""
    return np.asarray(clearance.astype(np.float64) - robot_radius_m <= 0.0)


def roomy(
    clearance: Clearance, known: Mask, resolution_m: float, robot_radius_m: float,
    inscribed_radius_m: float,
) -> Mask:  # fmt: skip
    """(rows, columns): cells that are floor for a robot which drives straight through gaps: those
    where its circle hits nothing, and the middle of what is narrower. The strips along walls, where
    it could only drive beside its circle's `known` floor, are none.
    """
    free = ~inscribed(clearance, robot_radius_m)
    fits = ~inscribed(clearance, inscribed_radius_m)
    # In a corner between walls the strip is wider, by half and a cell.
    strip_m = 1.5 * (robot_radius_m - inscribed_radius_m) + resolution_m
    return np.asarray(free | (fits & (clearance_m(free & known, resolution_m) > strip_m)))


def traversable(
    cells: Cells, resolution_m: float, robot_radius_m: float = ROBOT_RADIUS_M
) -> tuple[Mask, Clearance]:
    """(rows, columns) each: cells that a planner allows for the robot's centre (known, cost below
    253), and the clearance. `cells` are occupancy: 100 occupied, -1 unknown.
    """
    clearance = clearance_m(cells >= OCCUPIED, resolution_m)
    return ~inscribed(clearance, robot_radius_m) & (cells >= 0), clearance


def reachable_from(free: Mask, row: int, column: int, tolerance_cells: float = 0.0) -> Mask:
    """(rows, columns): the traversable cells that a path from a cell can reach.

    If the cell itself is not traversable, the path starts at the nearest traversable cell within
    the tolerance; without one, no cell is reachable. Planners that move diagonally without cutting
    corners reach the same cells.
    """
    start = nearest_cell(free, row, column, tolerance_cells)
    if start is None:
        return np.zeros(free.shape, np.bool_)
    regions = connected_regions(free)
    return np.asarray(regions == regions[start])


def nearest_cell(
    where: Mask, row: int, column: int, within_cells: float = math.inf
) -> tuple[int, int] | None:
    """The true cell of `where` nearest to a cell; of several the first by row and column."""
    rows, columns = np.nonzero(where)
    if not len(rows):
        return None
    squares = portable.square(rows - row) + portable.square(columns - column)
    best = int(np.argmin(squares))
    if squares[best] > portable.square(within_cells):
        return None
    return int(rows[best]), int(columns[best])


def straightened(resolution_m: float, origin: SE2, cells: Cells) -> tuple[SE2, Cells]:
    """A possibly rotated map, resampled with its rows along the x axis: origin and (rows, columns)
    cells.

    Each new cell has the value at its centre, but no occupied cell is lost between centres; cells
    beyond the map are unknown.
    """
    if abs(origin.yaw_rad) <= _STRAIGHT_RAD or cells.size == 0 or not resolution_m > 0.0:
        return origin, cells
    rows, columns = cells.shape
    c, s = portable.cos_sin(origin.yaw_rad)
    corners = portable.product(
        np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)]), [[c, s], [-s, c]]
    )
    # In cells from the old origin, along the map's axes.
    low, high = np.floor(corners.min(0) + 1e-6), np.ceil(corners.max(0) - 1e-6)
    x, y = (np.arange(a, b) + 0.5 for a, b in zip(low, high, strict=True))

    def at(dx: float, dy: float) -> Cells:
        along, up = x[None, :] + dx, y[:, None] + dy
        column = np.floor(c * along + s * up).astype(np.int64)
        row = np.floor(c * up - s * along).astype(np.int64)
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        found = cells[row.clip(0, rows - 1), column.clip(0, columns - 1)]
        return np.where(inside, found, np.int8(-1))

    turned = at(0.0, 0.0)
    # At any rotation, each old cell contains the middle of a quarter of some new cell.
    for dx, dy in ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)):
        turned = np.where((near := at(dx, dy)) >= 100, near, turned)
    moved = SE2(
        origin.x_m + float(low[0]) * resolution_m, origin.y_m + float(low[1]) * resolution_m, 0.0
    )
    return moved, turned.astype(np.int8)

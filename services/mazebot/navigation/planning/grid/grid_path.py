"""The path of a point between two free cells: searched, shortened and rounded."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from mazebot.common.maths.frames import Array
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.grid.a_star import (
    GAVE_UP,
    NO_WAY,
    Workspace,
    a_star,
    buckets_for,
    traced,
)
from mazebot.navigation.planning.grid.anya import anya, pulled_off_corners
from mazebot.navigation.planning.grid.lines import polyline_cost
from mazebot.navigation.planning.grid.search_grid import NARROW, NO_PRICE, Cell, Prices, SearchGrid
from mazebot.navigation.planning.grid.smoothing import (
    cheapest_polyline,
    densified,
    rounded,
    thinned,
    tightened,
)
from mazebot.navigation.planning.interface import PlannerParams

_PER_CELL: Final = 64.0
"""Buckets of the search for a length of one cell: the finer they are, the fewer cells it expands
again.
"""
_ANY_ANGLE_PER_CELL: Final = 8.0
_TIGHTENING_PASSES: Final = 12
_GIVE: Final = 0.5
"""How much nearer to an obstacle a rounded corner may come, in cells."""
_DEARER: Final = 1.01
_LONGER: Final = 1.002
"""A rounded path may cost this many times what it did with corners; the shortest, be this many
times as long.
"""


class Ends(NamedTuple):
    """What is to be joined; places are (x, y) in cells."""

    start_cell: Cell
    goal_cell: Cell
    start_at: tuple[float, float] | None
    """Within the start's cell; None: its centre."""
    goal_at: tuple[float, float]
    """Within the goal's cell."""

    def begin(self) -> tuple[float, float]:
        """Where the path begins."""
        return self.start_at or (float(self.start_cell[1]), float(self.start_cell[0]))


def free_path(
    grid: SearchGrid,
    costmap: Costmap,
    ends: Ends,
    params: PlannerParams,
    price: Prices,
    kept: Workspace,
) -> Array:
    """(n, 2) points in cells of a path that touches only cells below NARROW; both ends must be in
    one region of these.

    Raises NavigationError with PLANNER_TIMEOUT.
    """
    path = None
    if params.algorithm == "any_angle" and params.settings.cost_travel_multiplier <= 0.0:
        path = _shortest(grid, ends, params, kept)
    if path is None:
        path = _cheapest(grid, ends, params, price, kept)
        if params.algorithm == "any_angle":
            path = cheapest_polyline(grid.cells, NARROW, price, thinned(path))
            path = tightened(grid.cells, NARROW, price, path, _TIGHTENING_PASSES)
    return _rounded(grid, costmap, params, price, path)


def _cheapest(
    grid: SearchGrid, ends: Ends, params: PlannerParams, price: Prices, kept: Workspace
) -> Array:
    """In the cells' 8 directions."""
    stride = grid.cells.shape[1]
    start = ends.start_cell[0] * stride + ends.start_cell[1]
    goal = ends.goal_cell[0] * stride + ends.goal_cell[1]
    status, _ = a_star(
        grid.cells, NARROW, price, start, goal, params.settings.most_cells, _PER_CELL,
        buckets_for(price, _PER_CELL), 1.0, 0.0, kept.cost_to_come, kept.came_from,
    )  # fmt: skip
    _raise(status, params)
    path = traced(kept.came_from, stride, start, goal)
    return _with_end(_with_end(path, ends.begin(), 0), ends.goal_at, len(path) + 1)


def _shortest(grid: SearchGrid, ends: Ends, params: PlannerParams, kept: Workspace) -> Array | None:
    """At any angle; None where its corners cannot be kept off those of obstacles."""
    left, right = kept.run_ends(grid.cells.shape)
    (start_x, start_y), (goal_x, goal_y) = ends.begin(), ends.goal_at
    status, corners = anya(
        grid.cells, NARROW, left, right, start_x + 0.5, start_y + 0.5, goal_x + 0.5, goal_y + 0.5,
        params.settings.most_cells, _ANY_ANGLE_PER_CELL, kept.cost_to_come,
    )  # fmt: skip
    _raise(status, params)
    return pulled_off_corners(grid.cells, NARROW, corners)


def _raise(status: int, params: PlannerParams) -> None:
    if status == GAVE_UP:
        raise NavigationError(
            ErrorCode.PLANNER_TIMEOUT,
            f"no path found within {params.settings.most_cells} cells: raise max_iterations",
        )
    assert status != NO_WAY


def _rounded(
    grid: SearchGrid, costmap: Costmap, params: PlannerParams, price: Prices, path: Array
) -> Array:
    """The path with points at even distances and round corners, if it hardly costs more."""
    resolution_m = grid.frame.resolution_m
    dense = densified(path, max(params.path_spacing_m / resolution_m, 0.5))
    safe_m = costmap.robot_radius_m + resolution_m
    if params.footprint is not None:
        safe_m = params.footprint.circumscribed_radius_m + resolution_m
    dearer = _DEARER if params.settings.cost_travel_multiplier > 0.0 else _LONGER
    most = dearer * polyline_cost(grid.cells, NARROW, price, dense)
    passes = params.smoothing_iterations
    while passes > 0:
        smooth = rounded(
            grid.cells, NARROW, NO_PRICE, costmap.clearance_m, safe_m, _GIVE * resolution_m,
            dense, passes,
        )  # fmt: skip
        if polyline_cost(grid.cells, NARROW, price, smooth) <= most:
            return smooth
        passes //= 4
    return dense


def _with_end(path: Array, point: tuple[float, float], at: int) -> Array:
    """The path with one more point before its first or after its last, if that is another."""
    there = path[0 if at == 0 else -1]
    if abs(there[0] - point[0]) + abs(there[1] - point[1]) < 1e-9:
        return path
    return np.insert(path, min(at, len(path)), point, axis=0)

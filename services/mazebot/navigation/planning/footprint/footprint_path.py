"""Paths of the footprint's search, made as smooth as the footprint allows."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.costmap.footprint import Footprint
from mazebot.navigation.costmap.layered_costmap import LETHAL_OBSTACLE, Costmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.footprint.footprint_check import CLEAR, first_obstruction
from mazebot.navigation.planning.footprint.footprint_search import (
    AHEAD,
    REVERSE_FACTOR,
    drive_through,
)
from mazebot.navigation.planning.footprint.way_out import LONGEST_M, ways_out
from mazebot.navigation.planning.grid.a_star import (
    FOUND,
    GAVE_UP,
    NO_WAY,
    Workspace,
    a_star,
    buckets_for,
)
from mazebot.navigation.planning.grid.search_grid import (
    HIGHEST_COST,
    NARROW,
    NO_PRICE,
    SOLID,
    Prices,
    SearchGrid,
)
from mazebot.navigation.planning.grid.smoothing import rounded

_HEADINGS_RAD: Final = portable.atan2_each(AHEAD[:, 1], AHEAD[:, 0])
_PER_CELL: Final = 4.0
_NARROW_EXTRA: Final = 3.0
"""How much half a step into a NARROW cell adds to the estimate of what is left, in cells."""
_SMALL_CELLS: Final = 500_000
_SLACK_CELLS: Final = 400.0
"""On larger maps, by how much a way may be longer than the shortest one of a point."""
_MOST_STATES: Final = 500_000
_SAMPLES: Final = 8
"""Of a segment, which is no longer than a cell, that are tested for keepout zones."""
_BLEND: Final = 10
"""Over so many points the path leads from the exact start to the lattice, and from it to the goal.
"""


class Found(NamedTuple):
    """A path that the footprint can be driven along."""

    points: Array
    """(n, 2), in cells."""
    yaws_rad: Array
    """(n,)"""
    backwards: NDArray[np.bool_] | None
    """(n,) where it drives backwards; None: nowhere."""
    begin: SE2
    """Where it begins: the start, or a place straight ahead of it or behind it."""
    back: bool
    """Whether it is behind it."""


def through_narrow_places(
    grid: SearchGrid, costmap: Costmap, footprint: Footprint, start: SE2, goal: SE2,
    price: Prices, kept: Workspace, passes: int, allow_reverse: bool, max_iterations: int,
) -> Found | None:  # fmt: skip
    """A path that the footprint can be driven along; None if there is none. From a start where it
    cannot turn, it begins where it can, if that is a little way ahead or back.

    Raises NavigationError with PLANNER_TIMEOUT.
    """
    start_cell, goal_cell = grid.cell(*start[:2]), grid.cell(*goal[:2])
    assert start_cell is not None
    assert goal_cell is not None
    stride = grid.cells.shape[1]
    guide = price.copy()
    guide[NARROW] = guide[HIGHEST_COST] + _NARROW_EXTRA
    slack = 1e6 if grid.cells.size <= _SMALL_CELLS else _SLACK_CELLS
    status, _ = a_star(
        grid.cells, SOLID, guide, goal_cell[0] * stride + goal_cell[1],
        start_cell[0] * stride + start_cell[1], max_iterations, _PER_CELL,
        buckets_for(guide, _PER_CELL), 0.0, slack, kept.cost_to_come, kept.came_from,
    )  # fmt: skip
    if status != FOUND:
        return None
    found = _searched(
        grid, costmap, footprint, start, goal, guide, kept.cost_to_come, allow_reverse,
        min(_MOST_STATES, max_iterations),
    )  # fmt: skip
    if found is None:
        return None
    poses, begin = found
    points, yaws_rad, backwards = _without_turns(poses, goal.yaw_rad)
    at_start, at_goal = grid.at(*start[:2]), grid.at(*goal[:2])
    back = bool(begin[3] < 0.0)
    if begin[3] != 0.0:
        at_start = float(begin[0]), float(begin[1])
        x_m, y_m = grid.in_map(begin[None, :2])[0].tolist()
        start = SE2(x_m, y_m, start.yaw_rad)
    if len(points) == 1:
        points, yaws_rad = np.repeat(points, 2, axis=0), np.repeat(yaws_rad, 2)
    points, lattice = _ended(points, at_start, at_goal), points
    if _enters_zone(costmap, grid, points):
        points = lattice.copy()
        points[0], points[-1] = at_start, at_goal
        if _enters_zone(costmap, grid, points):
            return None
    if backwards.any():
        return Found(points, yaws_rad, backwards, start, back)
    smooth = _smoothed(grid, costmap, footprint, points, start.yaw_rad, goal.yaw_rad, passes)
    return Found(points if smooth is None else smooth, yaws_rad, None, start, back)


def _searched(
    grid: SearchGrid, costmap: Costmap, footprint: Footprint, start: SE2, goal: SE2,
    guide: Prices, cost_to_come: Prices, allow_reverse: bool, max_states: int,
) -> tuple[Array, Array] | None:  # fmt: skip
    """The poses of a path, and the (x, y, yaw, way) in cells from where it begins; None if there is
    no path. Raises NavigationError with PLANNER_TIMEOUT.
    """
    distance_m, resolution_m = costmap.clearance_m, grid.frame.resolution_m
    begins = np.array([[*grid.at(*start[:2]), start.yaw_rad, 0.0]])
    reverse_within = math.inf if allow_reverse else -1.0

    def search(costs: Array, reverse_within: float, exact: bool) -> tuple[int, Array, int]:
        starts = np.column_stack((begins[: len(costs), :3], costs))
        return drive_through(
            grid.cells, guide, cost_to_come, distance_m, resolution_m, footprint.points_m,
            footprint.circles, _HEADINGS_RAD, AHEAD, starts,
            np.array([*grid.at(*goal[:2]), goal.yaw_rad]), reverse_within, exact, max_states,
        )  # fmt: skip

    status, poses, begin = search(np.zeros(1), reverse_within, True)
    if status == NO_WAY:
        out = ways_out(
            grid.cells, distance_m, resolution_m, footprint.points_m, footprint.circles,
            begins[0, :3].copy(), LONGEST_M,
        )  # fmt: skip
        if len(out):
            begins, way = out, out[:, 3]
            costs = np.where(way < 0.0, -REVERSE_FACTOR * way, way)
            reach = max(reverse_within, LONGEST_M / resolution_m)
            status, poses, begin = search(costs, reach, True)
            if status == NO_WAY:
                status, poses, begin = search(np.zeros(1), reverse_within, False)
    if status == GAVE_UP:
        raise NavigationError(
            ErrorCode.PLANNER_TIMEOUT,
            f"no path found for the footprint within {_MOST_STATES} poses",
        )
    return (poses, begins[begin]) if status == FOUND else None


def _smoothed(
    grid: SearchGrid, costmap: Costmap, footprint: Footprint, points: Array,
    start_yaw_rad: float, goal_yaw_rad: float, passes: int,
) -> Array | None:  # fmt: skip
    """The points made as smooth as the footprint allows; None: not at all."""
    distance_m, resolution_m = costmap.clearance_m, grid.frame.resolution_m
    tried = max(passes, 1)
    while tried > 0:
        smooth = rounded(
            grid.cells, SOLID, NO_PRICE, distance_m, footprint.circumscribed_radius_m,
            0.5 * resolution_m, points, tried,
        )  # fmt: skip
        at, _ = first_obstruction(
            distance_m, resolution_m, footprint.points_m, footprint.circles, smooth,
            start_yaw_rad, goal_yaw_rad, -math.inf,
        )  # fmt: skip
        if at == CLEAR and not _enters_zone(costmap, grid, smooth):
            return smooth
        tried //= 2
    return None


def _without_turns(poses: Array, goal_yaw_rad: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points, headings to leave them with, and whether backwards, of poses of which some turn on
    the spot.
    """
    moved = np.concatenate([np.abs(np.diff(poses[:, :2], axis=0)).sum(1) > 0.0, [True]])
    left = poses[moved]
    backwards = np.zeros(len(left), np.bool_)
    # A pose holds how it was reached; the point before it is the one left that way.
    reached = np.concatenate([poses[1:, 3], [0.0]])[moved] > 0.0
    backwards[:-1] = reached[:-1]
    yaws_rad = left[:, 2].copy()
    yaws_rad[-1] = goal_yaw_rad
    return np.ascontiguousarray(left[:, :2]), yaws_rad, backwards


def _enters_zone(costmap: Costmap, grid: SearchGrid, points: Array) -> bool:
    """Whether a path of (n, 2) points in cells touches a keepout zone: lethal cells that are no
    obstacles, of which the footprint's checks know nothing.
    """
    zones = (costmap.costs == LETHAL_OBSTACLE) & (costmap.distance_m > 0.0)
    if not zones.any():
        return False
    shares = np.arange(_SAMPLES)[:, None, None] / _SAMPLES
    fine = points[:-1] + shares * np.diff(points, axis=0)
    places_m = grid.in_map(np.concatenate([fine.reshape(-1, 2), points[-1:]]))
    cells = [costmap.frame.cell(x_m, y_m) for x_m, y_m in places_m.tolist()]
    return any(cell is not None and zones[cell] for cell in cells)


def _ended(points: Array, start: tuple[float, float], goal: tuple[float, float]) -> Array:
    """The points bent to begin and end where the path should."""
    points = points.copy()
    for end, order in ((start, 1), (goal, -1)):
        from_end = points[::order]
        reach = min(_BLEND, len(points) - 1)
        share = np.clip(1.0 - np.arange(len(points)) / reach, 0.0, 1.0)
        from_end += share[:, None] * (np.array(end) - from_end[0])
    return points

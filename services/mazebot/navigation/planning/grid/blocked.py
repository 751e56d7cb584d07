"""Where the way to a goal is blocked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.costmap.layered_costmap import NO_INFORMATION, Costmap
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.grid.a_star import Workspace
from mazebot.navigation.planning.grid.regions import OF_GOAL, OF_START, thinnest_place
from mazebot.navigation.planning.grid.search_grid import NARROW, Cell, SearchGrid
from mazebot.navigation.planning.grid.widest import widest_way

_NARROW_WEIGHT, _SOLID_WEIGHT = 1, 3
"""A cell of an obstacle counts as so many that are merely too near to one."""


@dataclass(frozen=True, slots=True)
class Query:
    """What was asked."""

    start: SE2
    goal: SE2
    start_cell: Cell
    goal_cell: Cell
    needs: str
    """The robot's size, as text."""
    passing_m: float
    """Half of the width of a way that it needs."""
    zones: Zones | None
    """Those of the costmap; None: not known, or none."""


def no_way(
    grid: SearchGrid, costmap: Costmap, static: SearchGrid | None, asked: Query, kept: Workspace
) -> NavigationError:
    """The error about a goal in another region than the start, with the place where the fewest
    cells would have to become free. Where the static map alone has a way, only what stands in it
    counts, not its walls.
    """
    text = (
        f"no path from ({asked.start.x_m:.2f}, {asked.start.y_m:.2f}) "
        f"to ({asked.goal.x_m:.2f}, {asked.goal.y_m:.2f}) for a robot of {asked.needs}"
    )
    stride = grid.cells.shape[1]
    start = asked.start_cell[0] * stride + asked.start_cell[1]
    goal = asked.goal_cell[0] * stride + asked.goal_cell[1]
    kept.marks[:] = 0
    regions = kept.regions
    of_start = regions.mark(regions.at(start), OF_START, kept.marks)
    of_goal = regions.mark(regions.at(goal), OF_GOAL, kept.marks)
    from_goal = of_goal < of_start
    at = -1
    for fixed in ([] if static is None else [static.cells]) + [np.empty((0, 0), np.uint8)]:
        at = int(
            thinnest_place(
                grid.cells,
                fixed,
                start,
                goal,
                _NARROW_WEIGHT,
                _SOLID_WEIGHT,
                from_goal,
                kept.marks,
            )
        )
        if at >= 0:
            break
    if at < 0:
        return NavigationError(ErrorCode.NO_VALID_PATH, text)
    cell = divmod(at, stride)
    place_m = grid.center(cell)
    # What is not on the map may be seen in part alone: its width is not for the costmap to tell.
    narrow = None if fixed.size else widest_way(grid, costmap, asked.passing_m, kept)
    if narrow is not None and narrow.width_m < 2.0 * asked.passing_m:
        return NavigationError(
            ErrorCode.NO_VALID_PATH, too_narrow(text, *narrow, 2.0 * asked.passing_m),
            narrow.place_m,
        )  # fmt: skip
    what = _what_blocks(grid, costmap, cell, asked)
    return NavigationError(
        ErrorCode.NO_VALID_PATH,
        f"{text}: blocked at ({place_m[0]:.2f}, {place_m[1]:.2f}), {what}",
        place_m,
    )


def too_narrow(text: str, place_m: tuple[float, float], width_m: float, needs_m: float) -> str:
    """The message about a way that is too narrow."""
    return (
        f"{text}: too narrow at ({place_m[0]:.2f}, {place_m[1]:.2f}), {width_m:.2f} m wide: must "
        f"be at least {needs_m:.2f} m"
    )


def _what_blocks(grid: SearchGrid, costmap: Costmap, cell: Cell, asked: Query) -> str:
    row, column = cell[0] - 1, cell[1] - 1
    if costmap.clearance_m[row, column] > asked.passing_m and asked.zones is not None:
        # A zone closes the cells beside it too, for the robot's side.
        zone = asked.zones.keepout_near(*grid.center(cell), asked.passing_m)
        if zone is not None:
            return zone
    if grid.cells[cell] == NARROW:
        return f"{costmap.clearance_m[row, column]:.2f} m from an obstacle"
    if costmap.costs[row, column] == NO_INFORMATION:
        return "unknown space"
    return "an obstacle"

"""Where a path begins and ends: starts and goals in inflated cells, and the nearest free poses."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.costmap.footprint import Footprint
from mazebot.navigation.costmap.layered_costmap import (
    LETHAL_OBSTACLE,
    NO_INFORMATION,
    Costmap,
    Costs,
)
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.footprint.footprint_check import hits
from mazebot.navigation.planning.grid.lines import line_cost
from mazebot.navigation.planning.grid.regions import Marks
from mazebot.navigation.planning.grid.search_grid import NO_PRICE, SOLID, Cell, Prices, SearchGrid

ANY_REGION: Final = np.empty(0, np.uint8)
_NO_OUTLINE: Final = np.empty((0, 2))
_NO_CIRCLES: Final = np.empty(0)


def check_inside(costmap: Costmap, pose: SE2, what: str, code: ErrorCode) -> None:
    """Raise NavigationError where a pose lies outside the map."""
    if costmap.frame.cell(pose.x_m, pose.y_m) is None:
        raise NavigationError(
            code,
            f"{what} ({_short(pose.x_m)}, {_short(pose.y_m)}) lies outside the map: "
            f"it covers {costmap.frame.extent()}",
        )


def _short(value_m: float) -> str:
    return f"{value_m:.2f}" if abs(value_m) < 1e6 else f"{value_m:.4g}"


def occupied_goal(
    costmap: Costmap, goal: SE2, nearest_free: SE2 | None, needs: str = ""
) -> NavigationError:
    """The error about a goal where the robot cannot be."""
    at = f"goal ({goal.x_m:.2f}, {goal.y_m:.2f})"
    instead = ""
    if nearest_free is not None:
        instead = f"; the nearest free pose is ({nearest_free.x_m:.2f}, {nearest_free.y_m:.2f})"
    unknown = costmap.cost_at(goal.x_m, goal.y_m) == NO_INFORMATION
    place_m = (goal.x_m, goal.y_m)
    if unknown and costmap.clearance_at(goal.x_m, goal.y_m) > costmap.robot_radius_m:
        return NavigationError(
            ErrorCode.NO_VALID_PATH,
            f"{at} is in unknown space: must be on floor the map shows as free{instead}",
            place_m,
            nearest_free,
        )
    must = needs or f"must be more than {costmap.robot_radius_m:.2f} m from every obstacle"
    return NavigationError(
        ErrorCode.GOAL_OCCUPIED,
        f"{at} is {_what_is_there(costmap, goal)}: {must}{instead}",
        place_m,
        nearest_free,
    )


def occupied_start(
    costmap: Costmap, start: SE2, tolerance_m: float, nearest_free: SE2 | None
) -> NavigationError:
    """The error about a start that no free cell is near enough to."""
    return NavigationError(
        ErrorCode.START_OCCUPIED,
        f"start ({start.x_m:.2f}, {start.y_m:.2f}) is {_what_is_there(costmap, start)}: "
        f"must be within {tolerance_m:.2f} m of free space",
        (start.x_m, start.y_m),
        nearest_free,
    )


def _what_is_there(costmap: Costmap, pose: SE2) -> str:
    cost = costmap.cost_at(pose.x_m, pose.y_m)
    if cost == LETHAL_OBSTACLE:
        return "inside an obstacle"
    if cost == NO_INFORMATION:
        return "in unknown space"
    return f"{costmap.clearance_at(pose.x_m, pose.y_m):.2f} m from an obstacle"


def nearest_free_cell(
    grid: SearchGrid,
    x_m: float,
    y_m: float,
    within_m: float,
    marks: Marks = ANY_REGION,
    mark: int = 0,
    in_sight: bool = False,
) -> Cell | None:
    """The free cell nearest to a place; of several the first by row and column.

    Args:
        grid: what is free.
        x_m: the place.
        y_m: the place.
        within_m: how far it may be.
        marks: if not empty, only cells with the value `mark` there.
        mark: see `marks`.
        in_sight: only cells to which no obstacle is in the way.
    """
    return _nearest(grid, (x_m, y_m), within_m, marks, mark, in_sight, None, None, 0.0)


def nearest_free_pose(
    grid: SearchGrid,
    costmap: Costmap,
    footprint: Footprint | None,
    goal: SE2,
    within_m: float,
    marks: Marks = ANY_REGION,
    mark: int = 0,
) -> SE2 | None:
    """The cell nearest to a goal where the robot can be with the goal's heading."""
    cell = _nearest(
        grid, (goal.x_m, goal.y_m), within_m, marks, mark, False, footprint, costmap, goal.yaw_rad
    )
    return None if cell is None else SE2(*grid.center(cell), goal.yaw_rad)


def _nearest(
    grid: SearchGrid, place_m: tuple[float, float], within_m: float, marks: Marks, mark: int,
    in_sight: bool, footprint: Footprint | None, costmap: Costmap | None, yaw_rad: float,
) -> Cell | None:  # fmt: skip
    outline, circles, distance_m = _NO_OUTLINE, _NO_CIRCLES, np.empty((0, 0), np.float32)
    if footprint is not None and costmap is not None:
        outline, circles = footprint.points_m, footprint.circles
        distance_m = costmap.clearance_m
    x, y = grid.at(*place_m)
    reach = min(within_m / grid.frame.resolution_m, float(sum(grid.cells.shape)))
    row, column = _nearest_cell(
        grid.cells, NO_PRICE, x, y, reach, marks, mark, in_sight, distance_m,
        grid.frame.resolution_m, outline, circles, yaw_rad,
    )  # fmt: skip
    return None if row < 0 else (int(row), int(column))


@kernel()
def _nearest_cell(
    cells: Costs,
    no_price: Prices,
    x: float,
    y: float,
    reach: float,
    marks: Marks,
    mark: int,
    in_sight: bool,
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    yaw_rad: float,
) -> tuple[int, int]:
    """Examines square rings around the place, until none can have a nearer cell."""
    rows, columns = cells.shape
    middle_row, middle_column = math.floor(y + 0.5), math.floor(x + 0.5)
    best, best_row, best_column = reach * reach + 1e-9, -1, -1
    for ring in range(math.ceil(reach) + 2):
        nearest = max(0.0, ring - 1.0)
        if nearest * nearest > best:
            break
        for row in range(max(1, middle_row - ring), min(rows - 2, middle_row + ring) + 1):
            step = 2 * ring
            if abs(row - middle_row) == ring or ring == 0:
                step = 1
            for column in range(middle_column - ring, middle_column + ring + 1, step):
                if not 1 <= column < columns - 1 or cells[row, column] >= 253:
                    continue
                if marks.size > 0 and marks[row * columns + column] != mark:
                    continue
                square = (row - y) * (row - y) + (column - x) * (column - x)
                if square >= best:
                    continue
                if in_sight and not np.isfinite(
                    line_cost(cells, SOLID, no_price, x, y, column, row, np.inf)
                ):
                    continue
                if len(outline_m) > 0 and hits(
                    distance_m, resolution_m, outline_m, circles, column, row, yaw_rad
                ):
                    continue
                best, best_row, best_column = square, row, column
    return best_row, best_column

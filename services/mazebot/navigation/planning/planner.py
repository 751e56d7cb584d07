"""The global planner: a search on the costmap, and its path shortened and rounded in free space."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.ends import (
    check_inside,
    nearest_free_cell,
    nearest_free_pose,
    occupied_goal,
    occupied_start,
)
from mazebot.navigation.planning.footprint.footprint_check import (
    CLEAR,
    first_obstruction,
    hits,
    start_margin_m,
)
from mazebot.navigation.planning.footprint.footprint_path import Found, through_narrow_places
from mazebot.navigation.planning.grid.a_star import Workspace
from mazebot.navigation.planning.grid.blocked import Query, no_way
from mazebot.navigation.planning.grid.grid_path import Ends, free_path
from mazebot.navigation.planning.grid.lines import polyline_cost
from mazebot.navigation.planning.grid.regions import OF_GOAL, OF_START
from mazebot.navigation.planning.grid.search_grid import (
    NARROW,
    SOLID,
    Cell,
    SearchGrid,
    prices,
    search_grid,
)
from mazebot.navigation.planning.interface import (
    GlobalPlanner,
    GridPlannerParams,
    PlannerName,
    PlannerParams,
)
from mazebot.navigation.planning.path import PlannedPath, path_through

__all__ = [
    "GlobalPlanner",
    "GridPlannerParams",
    "Planner",
    "PlannerName",
    "PlannerParams",
]


@dataclass(frozen=True, slots=True)
class _Task:
    """A start and a goal that a path may join."""

    grid: SearchGrid
    costmap: Costmap
    start: SE2
    goal: SE2
    start_cell: Cell
    goal_cell: Cell

    def index(self, cell: Cell) -> int:
        return cell[0] * int(self.grid.cells.shape[1]) + cell[1]


class Planner:
    """Finds the cheapest paths for the robot's circle or its footprint."""

    def __init__(self, params: PlannerParams) -> None:
        self._params = params
        self._price = prices(params.settings.cost_travel_multiplier)
        self._kept = Workspace()

    def plan(
        self,
        costmap: Costmap,
        start: SE2,
        goal: SE2,
        tolerance_m: float = 0.0,
        static: Costmap | None = None,
        zones: Zones | None = None,
    ) -> PlannedPath:
        """Path from `start` to `goal`, on which the robot touches no obstacle.

        Args:
            costmap: all layers.
            start: pose in the map; in inflated cells the path leads to the nearest free one first.
            goal: pose in the map.
            tolerance_m: where the goal is occupied or out of reach, the nearest place this near to
                it that can be reached takes its place.
            static: the costmap of the map alone: where there is no way, the error names what stands
                in it instead of its thinnest wall.
            zones: the costmap's, for their names: where one is in the way, the error tells which.

        Raises NavigationError with START_OUTSIDE_MAP, START_OCCUPIED, GOAL_OUTSIDE_MAP,
        GOAL_OCCUPIED (with `nearest_free`), NO_VALID_PATH (with `place_m`) or PLANNER_TIMEOUT.
        """
        params = self._params
        check_inside(costmap, start, "start", ErrorCode.START_OUTSIDE_MAP)
        check_inside(costmap, goal, "goal", ErrorCode.GOAL_OUTSIDE_MAP)
        passing_m = params.footprint.half_width_m if params.footprint else 0.0
        grid = search_grid(costmap, passing_m, params.allow_unknown)
        self._kept.fit(grid.cells.size)
        task = self._task(grid, costmap, start, goal, tolerance_m)
        task = self._joined(task, tolerance_m, static, zones)
        if not grid.is_free(task.goal_cell):
            return self._narrow(
                task, f"does not fit through on the way to ({goal.x_m:.2f}, {goal.y_m:.2f})"
            )
        path = self._searched(task)
        footprint = params.footprint
        if footprint is None:
            return self._planned(task, path)
        outline = (
            costmap.clearance_m, grid.frame.resolution_m, footprint.points_m, footprint.circles
        )  # fmt: skip
        margin_m = start_margin_m(*outline, np.array([*grid.at(*start[:2]), start.yaw_rad]))
        ends_rad = start.yaw_rad, goal.yaw_rad
        at, turning = first_obstruction(*outline, path, *ends_rad, margin_m)
        if at == CLEAR:
            return self._planned(task, path)
        x_m, y_m = grid.in_map(path[at : at + 1])[0]
        what = "cannot turn" if turning else "does not fit"
        try:
            return self._narrow(task, f"{what} at ({x_m:.2f}, {y_m:.2f})", (float(x_m), float(y_m)))
        except NavigationError:
            # Deep in what it touches, where it may not be: the shortest way out is as good as any.
            if margin_m == 0.0 or first_obstruction(*outline, path, *ends_rad, -np.inf)[0] != CLEAR:
                raise
            return self._planned(task, path)

    def _task(
        self, grid: SearchGrid, costmap: Costmap, start: SE2, goal: SE2, tolerance_m: float
    ) -> _Task:
        start_cell, goal_cell = grid.cell(*start[:2]), grid.cell(*goal[:2])
        assert start_cell is not None
        assert goal_cell is not None
        within_m = self._params.settings.start_tolerance
        if not grid.is_free(start_cell):
            inside = grid.cells[start_cell] >= SOLID
            free = nearest_free_cell(grid, *start[:2], within_m, in_sight=not inside)
            if inside or free is None:
                pose = None if free is None else SE2(*grid.center(free), start.yaw_rad)
                raise occupied_start(costmap, start, within_m, pose)
            start_cell = free
        task = _Task(grid, costmap, start, goal, start_cell, goal_cell)
        if self._fits(task):
            return task
        footprint = self._params.footprint
        remark_region(task, self._kept)
        nearest = nearest_free_pose(
            grid, costmap, footprint, goal, np.inf, self._kept.marks, OF_START
        )
        needs = "must leave room for the robot with this heading" if footprint else ""
        if nearest is None or _distance_m(nearest, goal) > tolerance_m:
            raise occupied_goal(costmap, goal, nearest, needs)
        cell = grid.cell(*nearest[:2])
        assert cell is not None
        return replace(task, goal=nearest, goal_cell=cell)

    def _fits(self, task: _Task) -> bool:
        """Whether the robot can be at the goal."""
        footprint, grid = self._params.footprint, task.grid
        if footprint is None:
            return grid.is_free(task.goal_cell)
        if grid.cells[task.goal_cell] >= SOLID:
            return False
        return not hits(
            task.costmap.clearance_m, grid.frame.resolution_m, footprint.points_m,
            footprint.circles, *grid.at(*task.goal[:2]), task.goal.yaw_rad,
        )  # fmt: skip

    def _joined(
        self, task: _Task, tolerance_m: float, static: Costmap | None, zones: Zones | None
    ) -> _Task:
        """The task with ends in one region of free cells."""
        if not task.grid.is_free(task.goal_cell) or self._in_one_region(task, task.start_cell):
            return task
        return self._rejoined(task, tolerance_m, static, zones)

    def _in_one_region(self, task: _Task, cell: Cell) -> bool:
        """Whether free cells join a cell and the goal."""
        regions = self._kept.regions
        regions.find(task.grid.cells)
        region = regions.at(task.index(cell))
        return region >= 0 and region == regions.at(task.index(task.goal_cell))

    def _rejoined(
        self, task: _Task, tolerance_m: float, static: Costmap | None, zones: Zones | None
    ) -> _Task:
        """The task with another start or goal, as far as tolerances allow it; else raises."""
        grid, kept = task.grid, self._kept
        goal = task.index(task.goal_cell)
        if not grid.is_free(grid.cell(*task.start[:2]) or task.start_cell):
            # The nearest free cell may be in a pocket that the start is not.
            kept.marks[:] = 0
            kept.regions.mark(kept.regions.at(goal), OF_GOAL, kept.marks)
            other = nearest_free_cell(
                grid,
                *task.start[:2],
                self._params.settings.start_tolerance,
                kept.marks,
                OF_GOAL,
                True,
            )
            if other is not None:
                return replace(task, start_cell=other)
        if tolerance_m > 0.0:
            remark_region(task, kept)
            near = nearest_free_pose(
                grid, task.costmap, self._params.footprint, task.goal, tolerance_m,
                kept.marks, OF_START,
            )  # fmt: skip
            cell = None if near is None else grid.cell(*near[:2])
            if near is not None and cell is not None:
                return replace(task, goal=near, goal_cell=cell)
        fixed = None
        if static is not None and static.frame == task.costmap.frame:
            fixed = search_grid(static, 0.0, self._params.allow_unknown)
        raise no_way(grid, task.costmap, fixed, self._query(task, zones), kept)

    def _query(self, task: _Task, zones: Zones | None) -> Query:
        footprint = self._params.footprint
        needs = f"radius {task.costmap.robot_radius_m:.2f} m"
        if footprint is not None:
            needs = f"width {2.0 * footprint.half_width_m:.2f} m"
        passing_m = footprint.half_width_m if footprint else task.costmap.robot_radius_m
        return Query(
            task.start, task.goal, task.start_cell, task.goal_cell, needs, passing_m, zones
        )  # fmt: skip

    def _searched(self, task: _Task) -> Array:
        """(n, 2) points of the path in cells."""
        grid, start = task.grid, task.start
        ends = Ends(task.start_cell, task.goal_cell, None, grid.at(*task.goal[:2]))
        inside = grid.cell(*start[:2]) == task.start_cell
        if inside:
            ends = ends._replace(start_at=grid.at(*start[:2]))
        path = free_path(grid, task.costmap, ends, self._params, self._price, self._kept)
        return path if inside else np.concatenate([[grid.at(*start[:2])], path])

    def _narrow(
        self, task: _Task, reason: str, place_m: tuple[float, float] | None = None
    ) -> PlannedPath:
        """A path searched for with the footprint at every step."""
        footprint, params = self._params.footprint, self._params
        assert footprint is not None
        found = through_narrow_places(
            task.grid, task.costmap, footprint, task.start, task.goal, self._price, self._kept,
            params.smoothing_iterations, params.allow_reverse, params.settings.most_cells,
        )  # fmt: skip
        if found is not None:
            if found.begin is task.start and (found.backwards is None or params.allow_reverse):
                path = self._planned(task, found.points)
                return path if found.backwards is None else replace(path, yaws_rad=found.yaws_rad)
            return self._after_way_out(task, found)
        start, goal = task.start, task.goal
        raise NavigationError(
            ErrorCode.NO_VALID_PATH,
            f"no path from ({start.x_m:.2f}, {start.y_m:.2f}) to ({goal.x_m:.2f}, {goal.y_m:.2f}): "
            f"the robot's footprint {reason}",
            place_m or (goal.x_m, goal.y_m),
        )

    def _after_way_out(self, task: _Task, found: Found) -> PlannedPath:
        """The path from a start that is left straight ahead or back; behind its last piece
        backwards it is searched for again, since a path in free space is smoother.
        """
        grid, footprint = task.grid, self._params.footprint
        assert footprint is not None
        points, yaws_rad = found.points, found.yaws_rad
        if found.begin is not task.start:
            begin = np.array(grid.at(*task.start[:2]))
            count = max(2, round(2.0 * float(np.abs(points[0] - begin).max())))
            way_out = begin + (np.arange(count) / count)[:, None] * (points[0] - begin)
            points = np.concatenate([way_out, points])
            yaws_rad = np.concatenate([np.full(count, task.start.yaw_rad), yaws_rad])
        else:
            count = 0
        last = count
        if found.backwards is not None:
            last += int(np.flatnonzero(found.backwards)[-1]) + 1
        x_m, y_m = grid.in_map(points[last : last + 1])[0].tolist()
        free = SE2(x_m, y_m, float(yaws_rad[last - 1]))
        cell = grid.cell(*free[:2])
        if cell is not None and self._in_one_region(task, cell):
            smooth = self._searched(replace(task, start=free, start_cell=cell))
            at, _ = first_obstruction(
                task.costmap.clearance_m, grid.frame.resolution_m, footprint.points_m,
                footprint.circles, smooth, free.yaw_rad, task.goal.yaw_rad, 0.0,
            )  # fmt: skip
            if at == CLEAR:
                points = np.concatenate([points[:last], smooth])
        path = self._planned(task, points)
        headings = path.yaws_rad.copy()
        headings[:last] = yaws_rad[:last]
        way_out_m = float(path.along_m[count])
        return replace(path, yaws_rad=headings, way_out_m=way_out_m)

    def _planned(self, task: _Task, path: Array) -> PlannedPath:
        resolution_m = task.grid.frame.resolution_m
        # From a start in inflated cells the way out is free of obstacles, but not of inflation.
        open_price = self._price.copy()
        open_price[NARROW] = open_price[NARROW - 1]
        cost = polyline_cost(task.grid.cells, SOLID, open_price, path)
        points_m = task.grid.in_map(path)
        points_m[0], points_m[-1] = task.start[:2], task.goal[:2]
        planned = path_through(points_m, task.goal.yaw_rad)
        return replace(planned, cost_m=float(cost) * resolution_m)


def remark_region(task: _Task, kept: Workspace) -> None:
    """Mark the region of the start alone."""
    kept.regions.find(task.grid.cells)
    kept.marks[:] = 0
    kept.regions.mark(kept.regions.at(task.index(task.start_cell)), OF_START, kept.marks)


def _distance_m(one: SE2, other: SE2) -> float:
    dx, dy = one.x_m - other.x_m, one.y_m - other.y_m
    return float(np.sqrt(dx * dx + dy * dy))

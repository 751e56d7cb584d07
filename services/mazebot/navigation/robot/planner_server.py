"""The planner server: paths by the planners, checks and smoothing of paths."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.world.costmap import Cells
from mazebot.navigation.behavior.context import PathCheck
from mazebot.navigation.behavior.nodes.path_parts import joined, nearest_index, piece, pose_on
from mazebot.navigation.costmap.costmap import NO_INFORMATION
from mazebot.navigation.costmap.footprint import Footprint, footprint_in_collision
from mazebot.navigation.costmap.layered_costmap import (
    INSCRIBED_INFLATED_OBSTACLE,
    LETHAL_OBSTACLE,
    Costmap,
    GridFrame,
    LayeredCostmap,
)
from mazebot.navigation.costmap.path_check import new_collisions
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.ends import nearest_free_pose
from mazebot.navigation.planning.grid.search_grid import search_grid
from mazebot.navigation.planning.interface import GlobalPlanner, GridPlannerParams
from mazebot.navigation.planning.path import PlannedPath
from mazebot.navigation.planning.planner import Planner
from mazebot.navigation.planning.smoother import check_smoother, smoothed
from mazebot.navigation.robot.detours import Detours

_NAV2_DEFAULTS = ("", "GridBased")
"""What Nav2's trees and parameter files call their planner: here, the one that is configured."""
_ON_PATH_CELLS = 3.0
"""A path is kept only while the robot is this near to it."""


class PlannerServerParams(Params):
    """Which planner, and which of its paths are kept."""

    planner: str = Field(
        "any_angle",
        description="any_angle, a_star, my_package.my_module:MyPlanner or FILE.py:MyPlanner",
    )
    GridBased: GridPlannerParams = GridPlannerParams()
    path_improvement: float = Field(
        0.05,
        ge=0,
        lt=1,
        description="a new path replaces a valid one only if it is shorter by this share",
    )


class SmootherServerParams(Params):
    """How paths are smoothed, those of the planners as well."""

    smoothing_iterations: int = Field(100, ge=0, description="most passes of the path smoother")


class PlannerServer:
    """Plans on the global costmap, and keeps the last path while it is as good as a new one."""

    def __init__(
        self,
        params: PlannerServerParams,
        smoother: SmootherServerParams,
        footprint: Footprint,
        costmap: LayeredCostmap,
        planners: Mapping[str, GlobalPlanner],
        zones: Zones | None,
    ) -> None:
        """`zones`: keepout zones, which the costmap has as well; None: there are none."""
        self._params = params
        self._smoother = smoother
        self._footprint = footprint
        self._costmap = costmap
        self._planners = planners
        self.zones = zones
        self._kept: PlannedPath | None = None
        self.detours = Detours(costmap)

    def take_map(
        self, frame: GridFrame, cells: Cells, static_margin_m: float, zones: Zones | None
    ) -> None:
        """Drive on in a map that has grown or changed, with the zones on its grid. A path that the
        map now shows to be blocked is not kept.
        """
        costmap = self._costmap
        costmap.take_map(frame, cells, static_margin_m)
        if zones is not None:
            costmap.set_keepout(zones.costs(costmap.master.inscribed_radius_m))
        self.zones = zones
        kept = self._kept
        if kept is not None:
            nothing = Costmap(
                frame, costmap.master.inscribed_radius_m,
                np.zeros_like(costmap.master.costs),
                np.full_like(costmap.master.distance_m, np.inf),
            )  # fmt: skip
            hit = new_collisions(
                costmap.static, nothing, self._footprint, kept.points_m, kept.yaws_rad,
                LETHAL_OBSTACLE, True,
            )  # fmt: skip
            if len(hit):
                self._kept = None

    def clear(self) -> None:
        """Keep no path."""
        self._kept = None

    def check_goals(self, pose: SE2, goals: Sequence[SE2]) -> None:
        """Raise NavigationError (200s) for a goal that no plan can reach on the static map. A robot
        that seems to stand in a wall may have a wrong pose: that is found out on the way.
        """
        planner = self._planner("")
        for goal in goals:
            try:
                pose = self._leg(planner, pose, goal, static_only=True).goal
            except NavigationError as error:
                if error.code != ErrorCode.START_OCCUPIED:
                    raise
                return

    def compute_path(
        self, start: SE2, goals: Sequence[SE2], planner_id: str,
        followed: PlannedPath | None, keep: bool,
    ) -> PlannedPath:  # fmt: skip
        """Path through all goals to the last one.

        Args:
            start: where it begins.
            goals: at least one.
            planner_id: empty: the configured one.
            followed: the path that the robot follows; None: it follows none.
            keep: whether the path begins at the robot: then it may be the followed one, where
                that is as good.

        Raises NavigationError with a code of ComputePathToPose (200s).
        """
        planner = self._planner(planner_id)
        if not goals:
            raise NavigationError(ErrorCode.NO_VALID_PATH, "no goals: must be at least one")
        if not keep:
            return self._through(planner, start, goals)
        self.detours.begin(goals[-1])
        try:
            path = self._through(planner, start, goals)
        except NavigationError:
            # No way is left but those that were blocked.
            if not self.detours.forget():
                raise
            path = self._through(planner, start, goals)
        kept = self._kept
        if len(goals) == 1 and kept is not None and kept is followed:
            if self._is_as_good(kept, path, start):
                return kept
            self._note_detour(kept, path, start)
        self._kept = path
        return path

    def _through(self, planner: GlobalPlanner, start: SE2, goals: Sequence[SE2]) -> PlannedPath:
        path = self._leg(planner, start, goals[0])
        for goal in goals[1:]:
            path = joined(path, self._leg(planner, path.goal, goal))
        return path

    def on_map(self, start: SE2, goal: SE2) -> PlannedPath | None:
        """The path that there would be if nothing stood there but what the map has, if any."""
        try:
            return self._leg(self._planner(""), start, goal, static_only=True)
        except NavigationError:
            return None

    def _note_detour(self, kept: PlannedPath, path: PlannedPath, pose: SE2) -> None:
        """Note where the path before is blocked, if it is."""
        if kept.goal != path.goal:
            return
        index = nearest_index(kept, pose)
        hit = self.collisions(piece(kept, index, len(kept.points_m)), PathCheck())
        if hit:
            self.detours.note(kept.length_m - float(kept.along_m[index]), hit[0], path)

    def _leg(
        self, planner: GlobalPlanner, start: SE2, goal: SE2, static_only: bool = False
    ) -> PlannedPath:
        """A path to one goal; raises NavigationError, which names a keepout zone at the goal."""
        static, master = self._costmaps_from(start, goal)
        costmap = static if static_only else master
        tolerance_m = self._params.GridBased.tolerance
        try:
            if isinstance(planner, Planner) and not static_only:
                # With the map alone too, it names the obstacle that is in the way.
                return planner.plan(costmap, start, goal, tolerance_m, static, self.zones)
            return planner.plan(costmap, start, goal, tolerance_m)
        except NavigationError as error:
            zone = self.zones.keepout_at(*goal[:2]) if self.zones is not None else None
            if zone is None or error.code != ErrorCode.GOAL_OCCUPIED:
                raise
            raise forbidden_goal(goal, zone, error.nearest_free) from error

    def _costmaps_from(self, start: SE2, goal: SE2) -> tuple[Costmap, Costmap]:
        """The static and the combined costmap for a path from a place: where that is in a keepout
        zone, it can be left.

        Raises NavigationError for a goal in the same zone.
        """
        costmap, zones = self._costmap, self.zones
        if zones is None or zones.keepout_at(*start[:2]) is None:
            return costmap.static, costmap.master
        costs = zones.costs(costmap.master.inscribed_radius_m, leaving_m=start[:2])
        assert costs is not None
        static, master = costmap.with_keepout(costs)
        zone, cell = zones.keepout_at(*goal[:2]), master.frame.cell(*goal[:2])
        if zone is not None and cell is not None and costs[cell] < LETHAL_OBSTACLE:
            grid = search_grid(costmap.master, self._footprint.half_width_m, False)
            near = nearest_free_pose(grid, costmap.master, self._footprint, goal, math.inf)
            raise forbidden_goal(goal, zone, near)
        return static, master

    def _is_as_good(self, kept: PlannedPath, path: PlannedPath, pose: SE2) -> bool:
        """Whether the path before leads to the same goal, is free, and hardly longer."""
        if kept.goal != path.goal:
            return False
        index = nearest_index(kept, pose)
        off_m = float(np.abs(kept.points_m[index] - np.array(pose[:2])).max())
        if off_m > _ON_PATH_CELLS * self._costmap.frame.resolution_m:
            return False
        left_m = kept.length_m - float(kept.along_m[index])
        if path.length_m < left_m * (1.0 - self._params.path_improvement):
            return False
        return not self.collisions(piece(kept, index, len(kept.points_m)), PathCheck())

    def smooth_path(
        self, path: PlannedPath, smoother_id: str, check_for_collisions: bool
    ) -> PlannedPath:
        """The path, smoothed. Raises NavigationError with Nav2's codes of SmoothPath."""
        check_smoother(smoother_id)
        costmap = self._costmap.master
        safe_m = self._footprint.circumscribed_radius_m
        smooth = smoothed(
            costmap, path, costmap.frame.resolution_m, safe_m, self._smoother.smoothing_iterations
        )
        for index in range(len(smooth.points_m)) if check_for_collisions else ():
            pose = pose_on(smooth, index)
            if self.cost_at(pose, use_footprint=True) >= INSCRIBED_INFLATED_OBSTACLE:
                raise NavigationError(
                    ErrorCode.SMOOTHED_PATH_IN_COLLISION,
                    f"the smoothed path touches an obstacle at ({pose.x_m:.2f}, {pose.y_m:.2f})",
                    (pose.x_m, pose.y_m),
                )
        return smooth

    def collisions(self, path: PlannedPath, check: PathCheck) -> tuple[SE2, ...]:
        """Poses of a path at which the robot collides, in order. What the static map has in the way
        already is no collision: a path may begin near a wall.
        """
        end = len(path.points_m)
        if check.max_lookahead_distance_m >= 0.0:
            end = int(np.searchsorted(path.along_m, check.max_lookahead_distance_m, side="right"))
        found = new_collisions(
            self._costmap.master, self._costmap.static, self._footprint, path.points_m[:end],
            path.yaws_rad, check.max_cost, check.stop_at_first_collision,
        )  # fmt: skip
        if check.consider_unknown_as_obstacle:
            found = np.union1d(found, self._unknown(path.points_m[:end]))
            found = found[: 1 if check.stop_at_first_collision else None]
        return tuple(pose_on(path, index) for index in found.tolist())

    def _unknown(self, points_m: Array) -> NDArray[np.int64]:
        """Indices of the (n, 2) places of which the costmap knows nothing."""
        costmap = self._costmap.master
        costs = np.array([costmap.cost_at(x_m, y_m) for x_m, y_m in points_m.tolist()])
        return np.flatnonzero(costs == NO_INFORMATION)

    def _touches(self, costmap: Costmap, pose: SE2) -> bool:
        footprint, frame = self._footprint, costmap.frame
        column, row = frame.place(pose.x_m, pose.y_m)
        x_axis = pose @ SE2(1.0, 0.0, 0.0)
        return bool(
            footprint_in_collision(
                costmap.distance_m, frame.resolution_m, footprint.points_m, footprint.circles,
                column, row, x_axis.x_m - pose.x_m, x_axis.y_m - pose.y_m, 0.0,
            )
        )  # fmt: skip

    def cost_at(self, pose: SE2, use_footprint: bool) -> int:
        """Cost of the costmap under the robot's centre or its footprint at a pose."""
        if use_footprint and self._touches(self._costmap.master, pose):
            return LETHAL_OBSTACLE
        return self._costmap.master.cost_at(pose.x_m, pose.y_m)

    def check_name(self, planner_id: str) -> None:
        """Raise NavigationError with INVALID_PLANNER where no planner has this name."""
        self._planner(planner_id)

    def _planner(self, planner_id: str) -> GlobalPlanner:
        name = self._params.planner if planner_id in _NAV2_DEFAULTS else planner_id
        if name not in self._planners:
            raise NavigationError(
                ErrorCode.INVALID_PLANNER,
                f"planner {name!r:.60}: must be one of {', '.join(sorted(self._planners))}",
            )
        return self._planners[name]


def forbidden_goal(goal: SE2, zone: str, nearest_free: SE2 | None) -> NavigationError:
    """The error of a goal in a keepout zone."""
    at = f"goal ({goal.x_m:.2f}, {goal.y_m:.2f})"
    instead = ""
    if nearest_free is not None:
        instead = f"; the nearest free pose is ({nearest_free.x_m:.2f}, {nearest_free.y_m:.2f})"
    return NavigationError(
        ErrorCode.GOAL_OCCUPIED, f"{at} is in {zone}: must be outside of it{instead}",
        (goal.x_m, goal.y_m), nearest_free,
    )  # fmt: skip

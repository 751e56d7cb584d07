"""The robot as behaviours see it: costmaps, planners, controllers and the command."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from services.common.error_codes import ErrorCode
from services.common.frames import SE2, Array
from services.navigation.behavior.context import (
    ClearRequest,
    FollowRequest,
    MarkerPose,
    PathCheck,
    TrackingFeedback,
)
from services.navigation.behavior.path_parts import joined, nearest_index, piece, pose_on
from services.navigation.control.collision import STOP, Surroundings, Velocity, first_contact_s
from services.navigation.control.controller import Controller
from services.navigation.control.progress_checker import ProgressChecker, ProgressParams
from services.navigation.control.stuck_detector import StuckDetector, StuckDetectorParams
from services.navigation.control.track import Track
from services.navigation.costmap.footprint import Footprint, footprint_in_collision
from services.navigation.costmap.layered_costmap import (
    INSCRIBED_INFLATED_OBSTACLE,
    LETHAL_OBSTACLE,
    Costmap,
    LayeredCostmap,
    LocalCostmap,
)
from services.navigation.errors import NavigationError
from services.navigation.planning.interface import GlobalPlanner
from services.navigation.planning.path import PlannedPath
from services.navigation.planning.planner import Planner

_LOG = logging.getLogger("navigation")
_LOOK_AHEAD_S = 2.0
NAV2_DEFAULTS = ("GridBased", "FollowPath")
"""What Nav2's trees and parameter files call their planner and their controller: here, whatever is
configured.
"""
_MIN_ECHOES = 3
"""Fewer echoes are noise."""
_ON_PATH_CELLS = 3.0
"""A path is kept only while the robot is this near to it."""


@dataclass(frozen=True, slots=True)
class RobotParams:
    """Limits of the robot's control."""

    control_period_s: float
    failure_tolerance_s: float
    """How long the controller may find no valid command."""
    path_improvement: float
    """A path that is still free is replaced only by one shorter by this fraction."""
    tolerance_m: float
    """A goal that is occupied is replaced by the nearest free place within this."""
    footprint: Footprint
    default_planner: str
    default_controller: str
    progress: ProgressParams


@dataclass(frozen=True, slots=True)
class View:
    """What the robot knows of itself at one step."""

    now_ns: int
    map_from_base: SE2 | None
    """None: it is not localised."""
    odom_from_base: SE2
    velocity: Velocity
    echoes_m: Array
    """(n, 2) float64, the newest scan's echoes in the current base frame."""
    tracks: tuple[Track, ...] = ()
    teleop: Velocity | None = None


@dataclass
class RobotContext:
    """See NavigationContext. The caller gives it a view, lets behaviours act, and takes the
    command.
    """

    params: RobotParams
    costmap: LayeredCostmap
    local_costmap: LocalCostmap
    planners: Mapping[str, GlobalPlanner]
    controllers: Mapping[str, Controller]
    docks: dict[str, SE2] = field(default_factory=dict)
    """Pose of the docked robot in the map, by the dock's name."""
    markers: dict[str, MarkerPose] = field(default_factory=dict)
    """The newest sighting of each dock's marker."""
    view: View | None = None
    command: Velocity | None = None
    """What behaviours want in this step; None: nothing."""
    new_path: PlannedPath | None = None
    """A path adopted in this step."""
    controlled: bool = False
    """Whether the command is the controller's."""
    wants_global_localization: bool = False
    monitor_enabled: bool = True

    def __post_init__(self) -> None:
        self._controller = self.controllers[self.params.default_controller]
        self._progress = ProgressChecker(self.params.progress)
        self._stuck = StuckDetector(StuckDetectorParams())
        self._followed: PlannedPath | None = None
        self._kept: PlannedPath | None = None
        self._blocked_since_ns: int | None = None
        self._controlled_ns = 0

    def begin(self, view: View) -> None:
        """Begin a step."""
        self.view = view
        self.command, self.new_path, self.controlled = None, None, False

    @property
    def controller(self) -> Controller:
        """The controller that was used last."""
        return self._controller

    def around(self) -> Surroundings:
        """The pose and the obstacles around it."""
        view = self._view()
        return Surroundings(
            self.pose(), self.costmap.master, view.echoes_m, self.params.footprint, view.tracks,
            view.velocity, min_echoes=_MIN_ECHOES,
        )  # fmt: skip

    def _view(self) -> View:
        assert self.view is not None
        return self.view

    def pose(self) -> SE2:
        """See NavigationContext."""
        pose = self._view().map_from_base
        if pose is None:
            raise NavigationError(ErrorCode.TF_ERROR, "the robot does not know where it is")
        return pose

    def odom_from_base(self) -> SE2:
        """See NavigationContext."""
        return self._view().odom_from_base

    def velocity(self) -> Velocity:
        """See NavigationContext."""
        return self._view().velocity

    def check_goals(self, goals: Sequence[SE2]) -> None:
        """See NavigationContext."""
        planner = self._planner("")
        at = self.pose()
        for goal in goals:
            at = planner.plan(self.costmap.static, at, goal, self.params.tolerance_m).goal

    def compute_path(self, start: SE2 | None, goals: Sequence[SE2], planner_id: str) -> PlannedPath:
        """See NavigationContext."""
        planner = self._planner(planner_id)
        at = start or self.pose()
        path: PlannedPath | None = None
        for goal in goals:
            leg = self._leg(planner, at, goal)
            path = leg if path is None else joined(path, leg)
            at = leg.goal
        if path is None:
            raise NavigationError(ErrorCode.NO_VALID_PATH, "no goals: must be at least one")
        if start is None and len(goals) == 1 and self._is_as_good(path):
            assert self._kept is not None
            return self._kept
        if start is None:
            self._kept = path
        return path

    def _leg(self, planner: GlobalPlanner, start: SE2, goal: SE2) -> PlannedPath:
        tolerance_m = self.params.tolerance_m
        if isinstance(planner, Planner):
            # With the map alone too, it names the obstacle that is in the way.
            return planner.plan(
                self.costmap.master, start, goal, tolerance_m, static=self.costmap.static
            )
        return planner.plan(self.costmap.master, start, goal, tolerance_m)

    def _is_as_good(self, path: PlannedPath) -> bool:
        """Whether the path before leads to the same goal, is free, and hardly longer."""
        kept = self._kept
        if kept is None or kept is not self._followed or kept.goal != path.goal:
            return False
        pose = self.pose()
        index = nearest_index(kept, pose)
        off_m = float(np.abs(kept.points_m[index] - np.array(pose[:2])).max())
        if off_m > _ON_PATH_CELLS * self.costmap.frame.resolution_m:
            return False
        left_m = kept.length_m - float(kept.along_m[index])
        if path.length_m < left_m * (1.0 - self.params.path_improvement):
            return False
        return not self.collisions(piece(kept, index, len(kept.points_m)), PathCheck())

    def collisions(self, path: PlannedPath, check: PathCheck) -> tuple[SE2, ...]:
        """See NavigationContext. What the static map has in the way already is no collision: a path
        may begin near a wall.
        """
        found = []
        for index in range(len(path.points_m)):
            if 0.0 <= check.max_lookahead_distance_m < float(path.along_m[index]):
                break
            pose = pose_on(path, index)
            if not self._is_blocked(self.costmap.master, pose, check.max_cost):
                continue
            if self._is_blocked(self.costmap.static, pose, check.max_cost):
                continue
            found.append(pose)
            if check.stop_at_first_collision:
                break
        return tuple(found)

    def _is_blocked(self, costmap: Costmap, pose: SE2, max_cost: int) -> bool:
        cost = costmap.cost_at(pose.x_m, pose.y_m)
        if max_cost < INSCRIBED_INFLATED_OBSTACLE:
            return cost >= max_cost
        return cost >= INSCRIBED_INFLATED_OBSTACLE or self._touches(costmap, pose)

    def _touches(self, costmap: Costmap, pose: SE2) -> bool:
        footprint, frame = self.params.footprint, costmap.frame
        column, row = frame.place(pose.x_m, pose.y_m)
        x_axis = pose @ SE2(1.0, 0.0, 0.0)
        return bool(
            footprint_in_collision(
                costmap.distance_m, frame.resolution_m, footprint.points_m, footprint.circles,
                column, row, x_axis.x_m - pose.x_m, x_axis.y_m - pose.y_m, 0.0,
            )
        )  # fmt: skip

    def cost_at(self, pose: SE2, use_footprint: bool) -> int:
        """See NavigationContext."""
        if use_footprint and self._touches(self.costmap.master, pose):
            return LETHAL_OBSTACLE
        return self.costmap.master.cost_at(pose.x_m, pose.y_m)

    def follow(self, request: FollowRequest) -> None:
        """See NavigationContext."""
        name = request.controller_id or self.params.default_controller
        if name in NAV2_DEFAULTS:
            name = self.params.default_controller
        if name not in self.controllers:
            raise NavigationError(
                ErrorCode.INVALID_CONTROLLER,
                f"controller {name!r:.60}: must be one of {', '.join(sorted(self.controllers))}",
            )
        controller, followed = self.controllers[name], self._followed
        going_on = (
            controller is self._controller
            and controller.path is not None
            and followed is not None
            and followed.goal == request.path.goal
        )
        if controller is not self._controller:
            self._controller.stop()
        if not going_on:
            self._progress.reset()
            self._stuck.reset()
            self._blocked_since_ns = None
        if followed is not request.path or not going_on:
            self.new_path = request.path
        self._controller = controller
        self._followed = request.path
        # A path that is kept began further back.
        first = nearest_index(request.path, self.pose())
        rest = piece(request.path, first, len(request.path.points_m))
        controller.set_path(rest, same_goal=going_on)

    def control(self, now_ns: int) -> TrackingFeedback:
        """See NavigationContext."""
        view, params = self._view(), self.params
        elapsed_s = (view.now_ns - self._controlled_ns) * 1e-9
        # A late step is followed by one in time: less than a period after it.
        if not 0.0 < elapsed_s < params.control_period_s:
            elapsed_s = params.control_period_s
        self._controlled_ns = view.now_ns
        made = self._controller.step(elapsed_s, self.around())
        pose = self.pose()
        where = f"at ({pose.x_m:.2f}, {pose.y_m:.2f})"
        if not made.blocked:
            self._blocked_since_ns = None
        elif self._blocked_since_ns is None:
            self._blocked_since_ns = now_ns
        elif now_ns - self._blocked_since_ns > params.failure_tolerance_s * 1e9:
            raise NavigationError(
                ErrorCode.NO_VALID_CONTROL, f"every motion along the path collides {where}"
            )
        if not self._progress.makes_progress(now_ns, pose):
            allowance_s = params.progress.movement_time_allowance_s
            raise NavigationError(
                ErrorCode.FAILED_TO_MAKE_PROGRESS, f"no progress for {allowance_s:.1f} s {where}"
            )
        stuck = self._stuck.update(now_ns, made.velocity, view.odom_from_base, pose)
        if stuck is not None:
            self._stuck.reset()
            raise NavigationError(ErrorCode.FAILED_TO_MAKE_PROGRESS, f"{stuck.text} {where}")
        self.command, self.controlled = made.velocity, True
        return TrackingFeedback(made.reached, made.distance_remaining_m)

    def drive(self, velocity: Velocity) -> None:
        """See NavigationContext."""
        self.command = velocity

    def stop(self) -> None:
        """See NavigationContext."""
        self._controller.stop()
        self._followed = self._kept = None
        self._blocked_since_ns = None
        self.command = STOP

    def time_to_collision(self, velocity: Velocity) -> float:
        """See NavigationContext. Without a pose, by the echoes alone."""
        view = self._view()
        if view.map_from_base is None:
            return first_contact_s(
                Surroundings(
                    view.odom_from_base, self.local_costmap.master, view.echoes_m,
                    self.params.footprint,
                ),
                velocity, _LOOK_AHEAD_S,
            )  # fmt: skip
        return first_contact_s(self.around(), velocity, _LOOK_AHEAD_S)

    def clear_costmap(self, request: ClearRequest) -> None:
        """See NavigationContext."""
        view = self._view()
        costmap: LayeredCostmap
        if request.costmap == "local":
            costmap, here = self.local_costmap, view.odom_from_base
        else:
            costmap, here = self.costmap, self.pose()
        if request.area == "entirely":
            costmap.clear()
        elif request.area == "except_region":
            costmap.clear_except(here, request.reset_distance_m)
        else:
            there = request.pose if request.area == "around_pose" else here
            costmap.clear_around(there or here, request.reset_distance_m)

    def selected(self, topic_name: str) -> str | None:
        """See NavigationContext."""
        return None

    def updated_goals(self) -> tuple[SE2, ...]:
        """See NavigationContext."""
        return ()

    def teleop(self) -> Velocity | None:
        """See NavigationContext."""
        return self._view().teleop

    def marker(self, dock_id: str) -> MarkerPose | None:
        """See NavigationContext."""
        if dock_id:
            return self.markers.get(dock_id)
        seen = sorted(self.markers.values(), key=lambda one: -one.stamp_ns)
        return seen[0] if seen else None

    def dock(self, dock_id: str) -> SE2:
        """See NavigationContext."""
        if dock_id not in self.docks:
            known = ", ".join(sorted(self.docks)) or "none"
            raise NavigationError(
                ErrorCode.DOCK_NOT_IN_DB, f"dock {dock_id!r:.60}: must be one of {known}"
            )
        return self.docks[dock_id]

    def is_localized(self) -> bool:
        """See NavigationContext."""
        return self._view().map_from_base is not None

    def reinitialize_global_localization(self) -> None:
        """See NavigationContext."""
        self.wants_global_localization = True

    def toggle_collision_monitor(self, enable: bool) -> None:
        """See NavigationContext."""
        self.monitor_enabled = enable

    def _planner(self, planner_id: str) -> GlobalPlanner:
        name = planner_id or self.params.default_planner
        if name in NAV2_DEFAULTS:
            name = self.params.default_planner
        if name not in self.planners:
            raise NavigationError(
                ErrorCode.INVALID_PLANNER,
                f"planner {name!r:.60}: must be one of {', '.join(sorted(self.planners))}",
            )
        return self.planners[name]

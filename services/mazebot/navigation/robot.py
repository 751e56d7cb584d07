"""The robot as behaviours see it: costmaps, planners, controllers and the command."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.world.costmap import Cells
from mazebot.navigation.behavior.context import (
    ClearRequest,
    Dock,
    FollowRequest,
    MarkerPose,
    PathCheck,
    TrackingFeedback,
)
from mazebot.navigation.behavior.docking.docks import Docks
from mazebot.navigation.behavior.nodes.path_parts import joined, nearest_index, piece, pose_on
from mazebot.navigation.control.collision import STOP, Surroundings, Velocity, first_contact_s
from mazebot.navigation.control.controller import Controller
from mazebot.navigation.control.safety.progress_checker import ProgressChecker, ProgressParams
from mazebot.navigation.control.safety.stuck_detector import StuckDetector, StuckDetectorParams
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.footprint import Footprint, footprint_in_collision
from mazebot.navigation.costmap.layered_costmap import (
    INSCRIBED_INFLATED_OBSTACLE,
    LETHAL_OBSTACLE,
    Costmap,
    GridFrame,
    LayeredCostmap,
    LocalCostmap,
)
from mazebot.navigation.costmap.path_check import new_collisions
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.ends import nearest_free_pose
from mazebot.navigation.planning.grid.search_grid import search_grid
from mazebot.navigation.planning.interface import GlobalPlanner
from mazebot.navigation.planning.path import PlannedPath
from mazebot.navigation.planning.planner import Planner
from mazebot.navigation.planning.smoother import smoothed

_LOG = logging.getLogger("navigation")
_LOOK_AHEAD_S = 2.0
NAV2_DEFAULTS = ("GridBased", "FollowPath")
SMOOTHERS = ("", "simple_smoother", "SmoothPath")
"""Names in Nav2's parameters and trees; all stand for the one that there is."""
"""What Nav2's trees and parameter files call their planner and their controller: here, whatever is
configured.
"""
_MIN_ECHOES = 3
"""Fewer echoes are noise."""
_GIVES_WAY_M = 1.2
_GIVES_WAY_M_S = 0.1
_GIVES_WAY_NS = 15_000_000_000
"""For so long a robot may stand, or drive slowly, with a moving obstacle this near."""
_ON_PATH_CELLS = 3.0
"""A path is kept only while the robot is this near to it."""
_LIMIT_DECEL_M_S2 = 0.5
"""The robot brakes this strongly before a speed limit (Nav2's max_decel of the speed filter)."""
_LATE_PERIODS = 2.0


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
    max_speed_m_s: float
    """The controllers' highest."""
    footprint: Footprint
    default_planner: str
    default_controller: str
    progress: ProgressParams
    smoothing_iterations: int = 100
    """Most passes of the path smoother."""


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
    turning: tuple[Track, ...] = ()
    """Obstacles that stand and are expected to turn back."""


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
    zones: Zones | None = None
    """Keepout zones, which the costmap has as well, and speed limits; None: there are none."""
    docks: Docks = field(default_factory=Docks)
    markers: dict[str, MarkerPose] = field(default_factory=dict)
    """The newest sighting of each marker, by its id."""
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
        self._forbidden = self.zones.forbidden if self.zones is not None else None
        self._gives_way_since_ns: int | None = None

    def take_map(
        self, frame: GridFrame, cells: Cells, static_margin_m: float, zones: Zones | None
    ) -> None:
        """Drive on in a map that has grown or changed, with the zones on its grid. A path that the
        map now shows to be blocked is not kept.
        """
        costmap = self.costmap
        costmap.take_map(frame, cells, static_margin_m)
        if zones is not None:
            costmap.set_keepout(zones.costs(costmap.master.inscribed_radius_m))
        self.zones = zones
        self._forbidden = zones.forbidden if zones is not None else None
        kept = self._kept
        if kept is not None:
            nothing = Costmap(
                frame, costmap.master.inscribed_radius_m,
                np.zeros_like(costmap.master.costs),
                np.full_like(costmap.master.distance_m, np.inf),
            )  # fmt: skip
            hit = new_collisions(
                costmap.static, nothing, self.params.footprint, kept.points_m, kept.yaws_rad,
                LETHAL_OBSTACLE, True,
            )  # fmt: skip
            if len(hit):
                self._kept = None

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
            view.velocity, min_echoes=_MIN_ECHOES, speed_limit_m_s=self._speed_limit_m_s(),
            forbidden=self._forbidden, turning=view.turning,
        )  # fmt: skip

    def _speed_limit_m_s(self) -> float:
        """The highest speed here from which the robot can brake before every lower limit on its
        path.
        """
        if self.zones is None:
            return math.inf
        pose, path = self.pose(), self._followed
        limit_m_s = float(self.zones.limits_at(np.array([pose[:2]]))[0])
        if path is None:
            return limit_m_s
        first = nearest_index(path, pose)
        # A command is obeyed in the period after it, and the pose is as old as that again.
        late_m = abs(self.velocity().linear_m_s) * _LATE_PERIODS * self.params.control_period_s
        # The nearest point of the path may be behind the robot.
        late_m += self.zones.frame.resolution_m
        ahead_m = np.maximum(path.along_m[first:] - path.along_m[first] - late_m, 0.0)
        highest_m_s = self.params.max_speed_m_s
        near = ahead_m <= 0.5 * highest_m_s * highest_m_s / _LIMIT_DECEL_M_S2
        limits_m_s = self.zones.limits_at(path.points_m[first:][near])
        squares = limits_m_s * limits_m_s + 2.0 * _LIMIT_DECEL_M_S2 * ahead_m[near]
        return min(limit_m_s, float(np.sqrt(squares.min(initial=math.inf))))

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
            at = self._leg(planner, at, goal, static_only=True).goal

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

    def _leg(
        self, planner: GlobalPlanner, start: SE2, goal: SE2, static_only: bool = False
    ) -> PlannedPath:
        """A path to one goal; raises NavigationError, which names a keepout zone at the goal."""
        static, master = self._costmaps_from(start, goal)
        costmap = static if static_only else master
        tolerance_m = self.params.tolerance_m
        try:
            if isinstance(planner, Planner) and not static_only:
                # With the map alone too, it names the obstacle that is in the way.
                return planner.plan(costmap, start, goal, tolerance_m, static=static)
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
        costmap, zones = self.costmap, self.zones
        if zones is None or zones.keepout_at(*start[:2]) is None:
            return costmap.static, costmap.master
        costs = zones.costs(costmap.master.inscribed_radius_m, leaving_m=start[:2])
        assert costs is not None
        static, master = costmap.with_keepout(costs)
        zone, cell = zones.keepout_at(*goal[:2]), master.frame.cell(*goal[:2])
        if zone is not None and cell is not None and costs[cell] < LETHAL_OBSTACLE:
            grid = search_grid(costmap.master, self.params.footprint.half_width_m, False)
            near = nearest_free_pose(grid, costmap.master, self.params.footprint, goal, math.inf)
            raise forbidden_goal(goal, zone, near)
        return static, master

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

    def smooth_path(
        self, path: PlannedPath, smoother_id: str, check_for_collisions: bool
    ) -> PlannedPath:
        """The path, smoothed. Raises NavigationError with Nav2's codes of SmoothPath."""
        if smoother_id not in SMOOTHERS:
            raise NavigationError(
                ErrorCode.INVALID_SMOOTHER,
                f"smoother_id: {smoother_id!r:.60}: must be empty or one of "
                f"{', '.join(filter(None, SMOOTHERS))}",
            )
        costmap = self.costmap.master
        safe_m = self.params.footprint.circumscribed_radius_m
        smooth = smoothed(
            costmap, path, costmap.frame.resolution_m, safe_m, self.params.smoothing_iterations
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
        """See NavigationContext. What the static map has in the way already is no collision: a path
        may begin near a wall.
        """
        end = len(path.points_m)
        if check.max_lookahead_distance_m >= 0.0:
            end = int(np.searchsorted(path.along_m, check.max_lookahead_distance_m, side="right"))
        found = new_collisions(
            self.costmap.master, self.costmap.static, self.params.footprint, path.points_m[:end],
            path.yaws_rad, check.max_cost, check.stop_at_first_collision,
        )  # fmt: skip
        return tuple(pose_on(path, index) for index in found.tolist())

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
        if self._gives_way(now_ns, made.velocity):
            self._blocked_since_ns = None
            self._progress.reset()
        elif not made.blocked:
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

    def _gives_way(self, now_ns: int, velocity: Velocity) -> bool:
        """Whether the robot stands because something that moves is near: for a while, that is no
        failure.
        """
        pose, view = self.pose(), self._view()
        near = any(
            math.hypot(each.x_m - pose.x_m, each.y_m - pose.y_m) < _GIVES_WAY_M
            for each in (*view.tracks, *view.turning)
        )
        if not near or abs(velocity.linear_m_s) > _GIVES_WAY_M_S:
            self._gives_way_since_ns = None
            return False
        if self._gives_way_since_ns is None:
            self._gives_way_since_ns = now_ns
        return now_ns - self._gives_way_since_ns <= _GIVES_WAY_NS

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

    def marker(self, marker_id: str) -> MarkerPose | None:
        """See NavigationContext."""
        return self.markers.get(marker_id)

    def dock(self, dock_id: str) -> Dock:
        """See NavigationContext."""
        return self.docks.by_name(dock_id)

    def dock_at(self, map_from_dock: SE2) -> Dock:
        """See NavigationContext."""
        return self.docks.at(map_from_dock)

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

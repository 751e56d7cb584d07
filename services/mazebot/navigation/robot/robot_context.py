"""The robot as behaviors see it: costmaps, planners, controllers and the command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import action_documents as act
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.world.costmap import Cells
from mazebot.navigation.behavior.context import (
    BatteryCharge,
    ClearRequest,
    Dock,
    FollowRequest,
    MarkerPose,
    PathCheck,
    TrackingFeedback,
)
from mazebot.navigation.behavior.docking.docks import Docks
from mazebot.navigation.control.collision import (
    STOP,
    Surroundings,
    Velocity,
    first_contact_s,
    first_entry,
)
from mazebot.navigation.costmap.footprint import Footprint
from mazebot.navigation.costmap.layered_costmap import GridFrame, LayeredCostmap, LocalCostmap
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.grid.blocked import too_narrow
from mazebot.navigation.planning.path import PlannedPath
from mazebot.navigation.robot.controller_server import ControllerServer
from mazebot.navigation.robot.narrow_gaps import NarrowGaps
from mazebot.navigation.robot.planner_server import PlannerServer
from mazebot.navigation.robot.speed_limit import speed_limit_m_s
from mazebot.navigation.robot.view import View

_LOOK_AHEAD_S = 2.0
_MIN_ECHOES = 3
"""Fewer echoes are noise."""
_LATE_PERIODS = 2.0
_SENT_WITH_NS = 500_000_000
"""An update that is sent right after a goal may have been sent before the goal was taken."""


@dataclass
class Told:
    """What navigation was told while it runs: it holds for all worlds and maps."""

    monitor_enabled: bool = True
    """Whether the collision monitor checks commands."""
    speed_limit: act.SpeedLimit = field(default_factory=act.SpeedLimit)
    """The newest heard on /speed_limit."""
    names_heard: dict[str, str] = field(default_factory=dict)
    """Last name of a plugin heard on each selector topic, such as `planner_selector`."""


@dataclass
class RobotContext:
    """See NavigationContext. The caller gives it a view, lets behaviors act, and takes the
    command.
    """

    footprint: Footprint
    costmap: LayeredCostmap
    local_costmap: LocalCostmap
    planner_server: PlannerServer
    controller_server: ControllerServer
    docks: Docks = field(default_factory=Docks)
    markers: dict[str, tuple[MarkerPose, ...]] = field(default_factory=dict)
    """All sightings of each marker's id in the newest picture that has any."""
    view: View | None = None
    command: Velocity | None = None
    """What behaviors want in this step; None: nothing."""
    new_path: PlannedPath | None = None
    """A path adopted in this step."""
    controlled: bool = False
    """Whether the command is the controller's."""
    wants_global_localization: bool = False
    told: Told = field(default_factory=Told)
    _goal_ns: int = 0
    """When the task got its goal."""
    _goal_update: SE2 | None = None
    """Heard since then."""

    def __post_init__(self) -> None:
        self.gaps = NarrowGaps(self.costmap, self.footprint)
        zones = self.zones
        self._forbidden = zones.forbidden if zones is not None else None

    @property
    def zones(self) -> Zones | None:
        """Keepout zones, which the costmap has as well, and speed limits; None: there are none."""
        return self.planner_server.zones

    def take_map(
        self, frame: GridFrame, cells: Cells, static_margin_m: float, zones: Zones | None
    ) -> None:
        """Drive on in a map that has grown or changed, with the zones on its grid."""
        self.planner_server.take_map(frame, cells, static_margin_m, zones)
        self._forbidden = zones.forbidden if zones is not None else None

    def forget_places(self) -> None:
        """Forget what was found out about places in the map: detours and narrow gaps."""
        self.planner_server.detours.forget()
        self.gaps.forget()

    def begin(self, view: View) -> None:
        """Begin a step."""
        self.view = view
        self.command, self.new_path, self.controlled = None, None, False

    def around(self) -> Surroundings:
        """The pose and the obstacles around it."""
        view, pose, server = self._view(), self.pose(), self.controller_server
        # A command is obeyed in the period after it, and the pose is as old as that again.
        late_m = abs(view.velocity.linear_m_s) * _LATE_PERIODS * server.control_period_s
        limit_m_s = speed_limit_m_s(
            self.zones, server.followed, server.nearest, pose, late_m, server.params.max_linear_vel
        )
        limit_m_s = min(limit_m_s, self.told.speed_limit.highest_m_s(server.params.max_linear_vel))
        if view.slows_down:
            limit_m_s = min(limit_m_s, server.params.slowdown_ratio * server.params.max_linear_vel)
        return Surroundings(
            pose, self.costmap.master, view.echoes_m, self.footprint, view.tracks,
            view.velocity, min_echoes=_MIN_ECHOES, speed_limit_m_s=limit_m_s,
            forbidden=self._forbidden, turning=view.turning,
        )  # fmt: skip

    def _view(self) -> View:
        assert self.view is not None
        return self.view

    def pose(self) -> SE2:
        """See NavigationContext."""
        pose = self._view().map_from_base
        if pose is None:
            raise NavigationError(ErrorCode.TF_ERROR, "the robot is not localized")
        return pose

    def odom_from_base(self) -> SE2:
        """See NavigationContext."""
        return self._view().odom_from_base

    def pose_std(self) -> tuple[float, float]:
        """See NavigationContext."""
        return self._view().pose_std

    def velocity(self) -> Velocity:
        """See NavigationContext."""
        return self._view().velocity

    def check_goals(self, goals: Sequence[SE2]) -> None:
        """See NavigationContext."""
        if self.is_localized():
            self.planner_server.check_goals(self.pose(), goals)
        # A new task begins.
        self.forget_places()

    def compute_path(self, start: SE2 | None, goals: Sequence[SE2], planner_id: str) -> PlannedPath:
        """See NavigationContext."""
        try:
            path = self.planner_server.compute_path(
                start or self.pose(), goals, planner_id, self.controller_server.followed,
                start is None,
            )  # fmt: skip
        except NavigationError as error:
            if start is None and error.code == ErrorCode.NO_VALID_PATH:
                raise self._too_narrow(error, goals) from None
            raise
        return path

    def _too_narrow(self, error: NavigationError, goals: Sequence[SE2]) -> NavigationError:
        """The error about a way, with the width of the gap in it where that can be measured."""
        place_m = error.place_m
        if place_m is None:
            return error
        gap = self.gaps.closed_near(place_m)
        if gap is None and len(goals) == 1:
            on_map = self.planner_server.on_map(self.pose(), goals[0])
            if on_map is not None:
                self.gaps.look_at(self._view(), on_map, place_m)
                gap = self.gaps.closed_near(place_m)
        if gap is None:
            return error
        begin, needs_m = error.message.split(": ", 1)[0], self.gaps.needs_m
        text = too_narrow(begin, gap.middle_m, gap.width_m, needs_m)
        told = NavigationError(error.code, text, gap.middle_m)
        told.for_good = True
        return told

    def collisions(self, path: PlannedPath, check: PathCheck) -> tuple[SE2, ...]:
        """See NavigationContext."""
        return self.planner_server.collisions(path, check)

    def cost_at(self, pose: SE2, use_footprint: bool) -> int:
        """See NavigationContext."""
        return self.planner_server.cost_at(pose, use_footprint)

    def follow(self, request: FollowRequest) -> None:
        """See NavigationContext."""
        if self.controller_server.follow(request, self.pose()):
            self.new_path = request.path

    def control(self, now_ns: int) -> TrackingFeedback:
        """See NavigationContext."""
        self.gaps.look(self._view(), self.controller_server.followed)
        around = self.around()
        made = self.controller_server.control(now_ns, self._view(), around)
        self.command, self.controlled = made.velocity, True
        return self.controller_server.tracking(made, around.map_from_base)

    def drive(self, velocity: Velocity) -> None:
        """See NavigationContext."""
        self.command = velocity

    def stop(self) -> None:
        """See NavigationContext."""
        self.controller_server.stop()
        self.planner_server.clear()
        self.command = STOP

    def time_to_collision(self, velocity: Velocity) -> float:
        """See NavigationContext. Without a pose, by the echoes alone."""
        view = self._view()
        if view.map_from_base is None:
            return first_contact_s(
                Surroundings(
                    view.odom_from_base, self.local_costmap.master, view.echoes_m, self.footprint
                ),
                velocity, _LOOK_AHEAD_S,
            )  # fmt: skip
        return first_contact_s(self.around(), velocity, _LOOK_AHEAD_S)

    def obstacle(self, velocity: Velocity, seconds: float) -> str:
        """See NavigationContext."""
        if self.zones is None or self._view().map_from_base is None:
            return "obstacle"
        entry = first_entry(self.around(), velocity, _LOOK_AHEAD_S)
        if entry is None or entry[0] > seconds:
            return "obstacle"
        return self.zones.keepout_in(entry[1]) or "obstacle"

    def clear_costmap(self, request: ClearRequest) -> None:
        """See NavigationContext. What the lidar does not show stays: it may be too near to be seen
        again.
        """
        costmap = self.local_costmap if request.costmap == "local" else self.costmap
        middle = self.middle_of(request)
        if middle is None:
            costmap.clear_scanned()
        elif request.area == "except_region":
            costmap.clear_except(middle, request.reset_distance_m)
        else:
            costmap.clear_around(middle, request.reset_distance_m)

    def middle_of(self, request: ClearRequest) -> SE2 | None:
        """The middle of the square that a request clears, in the costmap's frame; None: it clears
        all.

        Raises NavigationError where it is the robot in the map, which is lost.
        """
        if request.area == "entirely":
            return None
        if request.area == "around_pose" and request.pose is not None:
            return request.pose
        return self._view().odom_from_base if request.costmap == "local" else self.pose()

    def selected(self, topic_name: str) -> str | None:
        """See NavigationContext."""
        return self.told.names_heard.get(topic_name.lstrip("/"))

    def hear_goal_update(self, goal: SE2, stamp_ns: int) -> bool:
        """Take where the goal of the task has moved to, sent at a time, 0 where that is not known;
        False where it was sent for a task before.
        """
        if stamp_ns and stamp_ns < self._goal_ns - _SENT_WITH_NS:
            return False
        self._goal_update = goal
        return True

    def begin_goal(self) -> None:
        """See NavigationContext."""
        self._goal_ns, self._goal_update = self._view().now_ns, None

    def updated_goal(self) -> SE2 | None:
        """See NavigationContext."""
        return self._goal_update

    def battery(self) -> BatteryCharge | None:
        """See NavigationContext."""
        return self._view().battery

    def teleop(self) -> Velocity | None:
        """See NavigationContext."""
        return self._view().teleop

    def sightings(self, marker_id: str) -> tuple[MarkerPose, ...]:
        """See NavigationContext."""
        return self.markers.get(marker_id, ())

    def dock(self, dock_id: str) -> Dock:
        """See NavigationContext."""
        return self.docks.by_name(dock_id)

    def dock_at(self, map_from_dock: SE2) -> Dock:
        """See NavigationContext."""
        return self.docks.at(map_from_dock)

    def time_ns(self) -> int:
        """See NavigationContext."""
        return self._view().now_ns

    def is_localized(self) -> bool:
        """See NavigationContext."""
        return self._view().map_from_base is not None

    def reinitialize_global_localization(self) -> None:
        """See NavigationContext."""
        self.wants_global_localization = True

    def toggle_collision_monitor(self, enable: bool) -> None:
        """See NavigationContext."""
        self.told.monitor_enabled = enable

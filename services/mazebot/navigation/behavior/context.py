"""What behaviours and trees need of the rest of navigation: one interface, `NavigationContext`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.navigation.control.collision import Velocity
from mazebot.navigation.planning.path import PlannedPath

CostmapName = Literal["local", "global"]
COSTMAPS: tuple[CostmapName, ...] = ("local", "global")
ClearingArea = Literal["entirely", "except_region", "around_robot", "around_pose"]


@dataclass(frozen=True, slots=True)
class ClearRequest:
    """What to forget of a costmap's obstacles; names as in Nav2's clear services."""

    costmap: CostmapName
    area: ClearingArea = "entirely"
    reset_distance_m: float = 1.0
    """Side of the square around the robot or the pose."""
    pose: SE2 | None = None
    """Centre of `around_pose`."""


@dataclass(frozen=True, slots=True)
class FollowRequest:
    """A path to follow, and by which plugins; an empty name is the configured default."""

    path: PlannedPath
    controller_id: str = ""
    goal_checker_id: str = ""
    progress_checker_id: str = ""
    path_handler_id: str = ""


@dataclass(frozen=True, slots=True)
class TrackingFeedback:
    """How the robot follows its path."""

    reached: bool
    """The goal checker is satisfied and the robot stands."""
    distance_remaining_m: float
    position_tracking_error_m: float = 0.0
    """Distance from the path; positive: the robot is left of it."""
    heading_tracking_error_rad: float = 0.0
    """From the robot's heading to that of the path; positive: the robot is turned to the right."""
    current_path_index: int = 0
    """Of the point of the path nearest to the robot."""


@dataclass(frozen=True, slots=True)
class PathCheck:
    """Which poses of a path to test, and against what; names as in Nav2's IsPathValid."""

    max_cost: int = 254
    """A pose with this cost or more is in collision."""
    consider_unknown_as_obstacle: bool = False
    """Whether a pose in a cell that is not known is in collision."""
    max_lookahead_distance_m: float = -1.0
    """Test this far along the path; negative: all of it."""
    stop_at_first_collision: bool = True


@dataclass(frozen=True, slots=True)
class MarkerPose:
    """A marker as the camera saw it."""

    stamp_ns: int
    base_from_marker: SE2
    """Pose of the marker's foot in the robot's frame at that time; its x axis points out of the
    marker's face.
    """
    odom_from_base: SE2
    """Pose of the robot at that time."""

    @property
    def odom_from_marker(self) -> SE2:
        """Pose of the marker's foot by odometry."""
        return self.odom_from_base @ self.base_from_marker


@dataclass(frozen=True, slots=True)
class Dock:
    """A marker, and where the robot docks before it."""

    marker_id: str
    """As in detections."""
    map_from_marker: SE2
    """Pose of the marker's foot; its x axis points out of the marker's face."""
    marker_from_dock: SE2
    """Pose of the docked robot before the marker: it faces it."""
    whole_view_m: float = 0.0
    """Nearer to the marker than this, the camera does not see all of it."""
    side_m: float = 0.0
    """Of the marker's panel."""
    half_view_rad: float = math.inf
    """To each side of straight ahead the camera sees as far as this."""

    @property
    def map_from_dock(self) -> SE2:
        """Pose of the docked robot."""
        return self.map_from_marker @ self.marker_from_dock


def planar_marker(a_from_marker: Array) -> SE2:
    """Pose of an upright marker's foot; its x axis points out of the marker's face.

    Args:
        a_from_marker: rigid (4, 4), with OpenCV's axes of a marker: z points out of its face.

    Raises ValueError for a marker that lies flat.
    """
    x, y = float(a_from_marker[0, 2]), float(a_from_marker[1, 2])
    if math.hypot(x, y) < _UPRIGHT:
        raise ValueError("the marker lies flat: it must stand upright")
    return SE2(float(a_from_marker[0, 3]), float(a_from_marker[1, 3]), portable.atan2(y, x))


_UPRIGHT = 0.5
"""Least horizontal part of the axis out of the marker's face."""


@dataclass(frozen=True, slots=True)
class BatteryCharge:
    """What the battery said last."""

    share: float
    """0 to 1; NaN: it did not say."""
    voltage_v: float
    is_charging: bool


class NavigationContext(Protocol):
    """The robot as behaviours see it. Poses are in the map frame unless their name gives another.

    The caller ticks a tree once each control period. In each period the last call of `control`,
    `drive` or `stop` decides the command; where there was none, the robot is to be stopped.
    Failures are NavigationErrors with Nav2's codes, whose text names the cause and the place.
    """

    def pose(self) -> SE2:
        """Pose of the robot. Raises NavigationError (TF_ERROR of the task) while it is lost."""
        ...

    def pose_std(self) -> tuple[float, float]:
        """Standard deviations of the pose, of its position along each axis, m, and its heading,
        rad; infinite where they are not known.
        """
        ...

    def odom_from_base(self) -> SE2:
        """Pose of the robot by odometry; it drifts, and never jumps."""
        ...

    def velocity(self) -> Velocity:
        """Measured velocity of the robot."""
        ...

    def check_goals(self, goals: Sequence[SE2]) -> None:
        """Raise NavigationError (200s) for a goal that no plan can reach on the static map."""
        ...

    def compute_path(self, start: SE2 | None, goals: Sequence[SE2], planner_id: str) -> PlannedPath:
        """Path through all goals to the last one; start None: from the robot.

        It may be the path before, where that is as good. Raises NavigationError with a code of
        ComputePathToPose (200s).
        """
        ...

    def collisions(self, path: PlannedPath, check: PathCheck) -> tuple[SE2, ...]:
        """Poses of a path at which the robot collides, in order; empty: the path is valid."""
        ...

    def cost_at(self, pose: SE2, use_footprint: bool) -> int:
        """Cost of the global costmap under the robot's centre or its footprint at a pose."""
        ...

    def follow(self, request: FollowRequest) -> None:
        """Follow a path from now on. While one is followed: go over to the new one in motion.

        Raises NavigationError with a code of FollowPath (100s).
        """
        ...

    def control(self, now_ns: int) -> TrackingFeedback:
        """Command the next velocity along the path that `follow` was given.

        Raises NavigationError with a code of FollowPath (100s).
        """
        ...

    def drive(self, velocity: Velocity) -> None:
        """Command a velocity for this control period; its acceleration is limited already."""
        ...

    def stop(self) -> None:
        """Drop the path and stop the robot."""
        ...

    def time_to_collision(self, velocity: Velocity) -> float:
        """Seconds until the footprint touches something at a constant velocity; inf beyond the
        look-ahead, at least 2 s. A robot that touches already may move away.
        """
        ...

    def obstacle(self, velocity: Velocity, seconds: float) -> str:
        """What the robot meets after this time at a constant velocity: "obstacle", or the name of
        the keepout zone that it enters.
        """
        ...

    def clear_costmap(self, request: ClearRequest) -> None:
        """Forget obstacles of a costmap; what the newest scan shows stays."""
        ...

    def selected(self, topic_name: str) -> str | None:
        """Last plugin name received on a selector topic such as `planner_selector`; empty or None:
        none.
        """
        ...

    def begin_goal(self) -> None:
        """The task gets its goal now: updates that were sent before do not count any more."""
        ...

    def updated_goal(self) -> SE2 | None:
        """Goal last received on `goal_update` for the goal of the task; None: none."""
        ...

    def battery(self) -> BatteryCharge | None:
        """The robot's battery; None: nothing was heard of it."""
        ...

    def teleop(self) -> Velocity | None:
        """Newest velocity that a user asks for (`cmd_vel_teleop`); None: none lately."""
        ...

    def sightings(self, marker_id: str) -> tuple[MarkerPose, ...]:
        """What had a marker's id in the last picture with it: it may hang twice; empty: never."""
        ...

    def dock(self, dock_id: str) -> Dock:
        """A dock by its name, or its marker's id.

        Raises NavigationError with DOCK_NOT_IN_DB or DOCK_NOT_VALID.
        """
        ...

    def dock_at(self, map_from_dock: SE2) -> Dock:
        """The dock of the marker that a docked robot with this pose faces.

        Raises NavigationError with DOCK_NOT_VALID.
        """
        ...

    def time_ns(self) -> int:
        """Time of this step, by the clock of the sensors: that of a task stands still while it is
        held.
        """
        ...

    def is_localized(self) -> bool:
        """Whether the robot has a pose that can be trusted."""
        ...

    def reinitialize_global_localization(self) -> None:
        """Begin to search for the robot on the whole map."""
        ...

    def toggle_collision_monitor(self, enable: bool) -> None:
        """Switch the collision monitor on or off."""
        ...

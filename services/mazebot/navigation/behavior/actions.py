"""Goals, feedback and results of the actions; fields as in nav2_msgs/action."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.docking.docking import DockState
from mazebot.navigation.behavior.nodes.nodes_goals import Statuses
from mazebot.navigation.planning.path import PlannedPath


class TaskStatus(IntEnum):
    """Nav2's TaskResult."""

    UNKNOWN = 0
    SUCCEEDED = 1
    CANCELED = 2
    FAILED = 3


@dataclass(frozen=True, slots=True)
class NavigateToPose:
    """Drive to a pose in the map frame."""

    action: ClassVar[str] = "NavigateToPose"
    pose: SE2
    behavior_tree: str = ""
    """Name or file of the tree; empty: the default."""


@dataclass(frozen=True, slots=True)
class NavigateThroughPoses:
    """Drive through poses in their order to the last one."""

    action: ClassVar[str] = "NavigateThroughPoses"
    poses: tuple[SE2, ...]
    behavior_tree: str = ""


@dataclass(frozen=True, slots=True)
class WaypointWork:
    """What to do at one waypoint."""

    wait_s: float = 0.2
    photo: bool = False
    input_timeout_s: float | None = None
    """How long to wait for an input; None: no input."""


@dataclass(frozen=True, slots=True)
class FollowWaypoints:
    """Drive to each waypoint, and run the waypoint task there."""

    action: ClassVar[str] = "FollowWaypoints"
    poses: tuple[SE2, ...]
    number_of_loops: int = 0
    """Rounds after the first."""
    goal_index: int = 0
    """Where the first round begins."""
    works: tuple[WaypointWork, ...] = ()
    """One for each pose; empty: the waypoint task of navigation at each."""
    missed: Statuses = ()
    """Of a request that goes on: the waypoints missed so far."""


@dataclass(frozen=True, slots=True)
class FollowPath:
    """Follow a path that is given."""

    action: ClassVar[str] = "FollowPath"
    path: PlannedPath
    controller_id: str = ""
    goal_checker_id: str = ""
    progress_checker_id: str = ""
    path_handler_id: str = ""


@dataclass(frozen=True, slots=True)
class SingleAction:
    """An action that is one node of a tree: Spin, BackUp, DriveOnHeading, Wait, AssistedTeleop,
    DockRobot or UndockRobot.
    """

    action: str
    """Kind of the node."""
    ports: Mapping[str, object]
    """Values of its input ports; those left out have Nav2's defaults."""


Request = NavigateToPose | NavigateThroughPoses | FollowWaypoints | FollowPath | SingleAction


def spin(
    spin_dist: float = 1.57, time_allowance: float = 10.0, disable_collision_checks: bool = False
) -> SingleAction:
    """Turn on the spot by an angle in rad, positive to the left."""
    return SingleAction(
        "Spin",
        {
            "spin_dist": spin_dist,
            "time_allowance": time_allowance,
            "disable_collision_checks": disable_collision_checks,
        },
    )


def back_up(
    backup_dist: float = 0.15,
    backup_speed: float = 0.025,
    time_allowance: float = 10.0,
    disable_collision_checks: bool = False,
) -> SingleAction:
    """Drive straight back by a distance in m at a speed in m/s."""
    return SingleAction(
        "BackUp",
        {
            "backup_dist": backup_dist,
            "backup_speed": backup_speed,
            "time_allowance": time_allowance,
            "disable_collision_checks": disable_collision_checks,
        },
    )


def drive_on_heading(
    dist_to_travel: float = 0.15,
    speed: float = 0.025,
    time_allowance: float = 10.0,
    disable_collision_checks: bool = False,
) -> SingleAction:
    """Drive straight by a distance in m at a speed in m/s; both negative: back."""
    return SingleAction(
        "DriveOnHeading",
        {
            "dist_to_travel": dist_to_travel,
            "speed": speed,
            "time_allowance": time_allowance,
            "disable_collision_checks": disable_collision_checks,
        },
    )


def wait(wait_duration: float = 1.0) -> SingleAction:
    """Stand for a time in s."""
    return SingleAction("Wait", {"wait_duration": wait_duration})


def assisted_teleop(time_allowance: float = 30.0) -> SingleAction:
    """Drive as a user asks on `cmd_vel_teleop`, for a time in s."""
    return SingleAction("AssistedTeleop", {"time_allowance": time_allowance})


def dock_robot(
    dock_pose: SE2 | None = None,
    dock_id: str = "",
    navigate_to_staging_pose: bool = True,
    max_staging_time: float = 1000.0,
) -> SingleAction:
    """Dock at a pose of the docked robot in the map frame, or at a dock of the database."""
    return SingleAction(
        "DockRobot",
        {
            "use_dock_id": dock_pose is None,
            "dock_id": dock_id,
            "dock_pose": dock_pose,
            "max_staging_time": max_staging_time,
            "navigate_to_staging_pose": navigate_to_staging_pose,
        },
    )


def undock_robot(max_undocking_time: float = 30.0) -> SingleAction:
    """Drive back from the dock to its staging pose."""
    return SingleAction("UndockRobot", {"max_undocking_time": max_undocking_time})


@dataclass(frozen=True, slots=True)
class TaskFeedback:
    """Feedback of the running task; what its action does not have is left at its default."""

    action: str
    navigation_time_s: float
    """Time since the task began, without pauses."""
    current_pose: SE2 | None = None
    """None while the robot is lost."""
    distance_remaining_m: float | None = None
    """None before there is a path."""
    estimated_time_remaining_s: float | None = None
    number_of_recoveries: int = 0
    position_tracking_error_m: float = 0.0
    heading_tracking_error_rad: float = 0.0
    current_path_index: int = 0
    number_of_poses_remaining: int = 0
    waypoint_statuses: Statuses = ()
    current_waypoint: int = 0
    number_of_loops: int = 0
    """Rounds of FollowWaypoints after the current one."""
    motion: float = 0.0
    """Angle turned, distance driven, time left or time run, of a behaviour."""
    speed_m_s: float = 0.0
    docking_state: DockState = DockState.NONE
    num_retries: int = 0


@dataclass(frozen=True, slots=True)
class TaskResult:
    """How a task ended."""

    request: Request
    status: TaskStatus
    error_code: int
    """Of the action that failed within the task: see `code_name`."""
    error_msg: str
    """The cause and, where there is one, the place."""
    start_ns: int
    end_ns: int
    number_of_recoveries: int = 0
    waypoint_statuses: Statuses = ()
    """Of NavigateThroughPoses; of FollowWaypoints those that were missed."""
    num_retries: int = 0
    """Of DockRobot."""

"""The state of localization and navigation, results of goals, and their cancellation."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mazebot.common.messages.documents.document import Document, Finite
from mazebot.common.messages.documents.places import Planar


class LocalizationStatus(Document):
    """Whether the robot's pose in the map can be trusted."""

    state: Literal["uninitialized", "searching", "localized", "lost"] = Field(
        description="`uninitialized`: no scan or no initial pose yet; `searching`: global "
        "localisation; `lost`: the scans or the markers contradict the pose"
    )
    quality: Finite = Field(
        description="0 to 1: share of the lidar's returns that the map explains from this pose"
    )
    reason: str = Field("", description="why the pose is not trusted, in one line")
    wants_motion: bool = Field(False, description="the robot must move for the pose to be found")
    wheel_slip: bool = Field(
        False,
        description="the scans show that the wheels turn and the robot does not move as they say; "
        "the pose does not follow them meanwhile",
    )
    suspect: bool = Field(
        False,
        description="of `localized`: scans contradict the pose, and whether it is lost is not yet "
        "decided",
    )
    epoch: int | None = Field(None, description="the simulation's epoch; null before it is known")


class LocalizationCheckpoint(Document):
    """What a localization that is started again needs to go on where the one before was."""

    world_hash: str
    epoch: int | None = Field(description="the simulation's, in which the run began")
    state: Literal["uninitialized", "searching", "localized", "lost"]
    odom_from_base: Planar
    map_from_base: Planar
    covariance: tuple[Finite, Finite, Finite, Finite, Finite, Finite] = Field(
        description="of map_from_base: x x, x y, x yaw, y y, y yaw, yaw yaw"
    )


class StopCause(Document):
    """Why the robot does not drive as it could, and what ends that."""

    level: Literal["slowdown", "stop", "hold"]
    cause: str
    cleared_by: str = Field(description="what ends it: a message, or a person")


class NavigationStatus(Document):
    """The state of localisation and navigation."""

    localization_active: bool
    navigation_active: bool
    state: Literal["idle", "planning", "controlling", "recovering", "held"] = Field(
        "idle", description="`held`: the task is paused, or the robot in an emergency stop"
    )
    goal: Planar | None = None
    distance_remaining_m: Finite = 0.0
    number_of_recoveries: int = 0
    stop_level: Literal["none", "slowdown", "stop", "hold"] = Field(
        "none",
        description="what the robot may do, by what is still to be trusted: `slowdown` and `stop` "
        "end by themselves, `hold` only when a person clears it",
    )
    stop_causes: tuple[StopCause, ...] = Field((), description="the most severe first")

    @property
    def is_busy(self) -> bool:
        """Whether there is a goal, or another action runs."""
        return self.goal is not None or self.state != "idle"

    @property
    def is_held(self) -> bool:
        """Whether the robot may not move, although it knows where it is: the task is paused, or the
        robot in an emergency stop or blind.
        """
        stops = self.stop_level == "stop" and self.navigation_active
        return stops or self.state == "held" or self.stop_level == "hold"


class NavigationResult(Document):
    """The result of a goal, with Nav2's error codes (0 is success)."""

    goal: Planar
    goal_stamp_ns: int = Field(description="stamp of the goal's message: identifies the goal")
    error_code: int
    error_msg: str = ""
    start_time_s: Finite
    end_time_s: Finite
    number_of_recoveries: int = 0


class CancelGoal(Document):
    """Requests that navigation cancel the current goal: the robot stops."""

    goal_stamp_ns: int | None = Field(
        None, description="stamp of the goal's message: cancel only that goal; None: any"
    )
    goal_id: str | None = Field(None, description="id of an action's goal; None: any")
    action: str | None = Field(
        None, description="as in a goal: cancel it only where this is what it does; None: any"
    )
    accepted_until_ns: int | None = Field(
        None, description="simulation time: cancel only a goal accepted up to then; None: any"
    )


class CancelGoalReply(Document):
    """The result of a cancel request."""

    error: str = Field("", description="one line; empty: canceled")
    return_code: Literal[0, 2] = Field(
        0, description="as in action_msgs/srv/CancelGoal: 0 canceled, 2 no such goal"
    )
    goal: Planar | None = Field(None, description="the canceled goal")
    goal_stamp_ns: int = Field(0, description="stamp of that goal's message")
    goal_id: str = Field("", description="its id; empty: it came on /goal_pose")
    accepted_ns: int = Field(0, description="simulation time at which it was accepted")
    explores: bool = Field(
        False, description="whether it was the explorer's: the exploration is paused"
    )

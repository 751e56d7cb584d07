"""Whether the goal is reached: Nav2's SimpleGoalChecker, StoppedGoalChecker and PositionGoalChecker
in one.
"""

from __future__ import annotations

from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.navigation.control.collision import Velocity


class GoalCheckerParams(Params):
    """Names as in Nav2's SimpleGoalChecker and StoppedGoalChecker."""

    xy_goal_tolerance: float = Field(
        0.06, gt=0, description="m; a goal is reached within this distance; half of it is usual"
    )
    xy_goal_tolerance_buffer: float | None = Field(
        None,
        ge=0,
        description="m; a goal once reached is lost only beyond the tolerance and this; none: as "
        "large as the tolerance",
    )
    yaw_goal_tolerance: float = Field(
        0.06, gt=0, description="rad; a goal is reached within this angle"
    )
    path_length_tolerance: float = Field(
        1.0,
        gt=0,
        description="m; not reached while more of the path than this is left: a path may pass the "
        "goal before it ends there",
    )
    stateful: bool = Field(
        True, description="a position once reached stays reached while the robot turns"
    )
    symmetric_yaw_tolerance: bool = Field(
        False, description="the opposite heading counts as reached too"
    )
    position_only: bool = Field(
        False,
        description="any heading counts as reached, as in Nav2's PositionGoalChecker: the robot "
        "does not turn to the goal's",
    )
    trans_stopped_velocity: float = Field(
        0.01, gt=0, description="m/s; the goal is reached only when the robot is slower than this"
    )
    rot_stopped_velocity: float = Field(
        0.05, gt=0, description="rad/s; the goal is reached only when it turns slower than this"
    )


class GoalChecker:
    """Keeps whether the position was reached. Success needs position, heading and standstill;
    with `position_only` any heading will do.
    """

    def __init__(self, params: GoalCheckerParams) -> None:
        self._params = params
        buffer_m = params.xy_goal_tolerance_buffer
        self._buffer_m = params.xy_goal_tolerance if buffer_m is None else buffer_m
        self._xy_reached = False

    @property
    def xy_reached(self) -> bool:
        """Whether only the final turn is left."""
        return self._xy_reached

    def reset(self, xy_reached: bool = False) -> None:
        """Begin with another goal, or with one whose position was reached."""
        self._xy_reached = xy_reached

    def check_position(self, pose: SE2, goal: SE2, remaining_m: float) -> bool:
        """Update and return `xy_reached`; `remaining_m` is the length of the path that is left."""
        p = self._params
        to_goal_m = pose.distance_m(goal)
        if to_goal_m <= p.xy_goal_tolerance and remaining_m <= p.path_length_tolerance:
            self._xy_reached = True
        elif not p.stateful or to_goal_m > p.xy_goal_tolerance + self._buffer_m:
            # Localisation may find that the robot had not arrived.
            self._xy_reached = False
        return self._xy_reached

    def yaw_error_rad(self, pose: SE2, goal: SE2) -> float:
        """The turn that is left, in [-pi, pi), or the shorter one to the opposite heading; 0 where
        any heading will do.
        """
        if self._params.position_only:
            return 0.0
        error_rad = wrap_angle(goal.yaw_rad - pose.yaw_rad)
        if self._params.symmetric_yaw_tolerance:
            opposite_rad = wrap_angle(error_rad + 3.141592653589793)
            return min(error_rad, opposite_rad, key=abs)
        return error_rad

    def is_goal_reached(self, pose: SE2, goal: SE2, velocity: Velocity) -> bool:
        """Whether the robot stands at the goal: `velocity` is the measured one."""
        p = self._params
        return (
            self._xy_reached
            and abs(self.yaw_error_rad(pose, goal)) <= p.yaw_goal_tolerance
            and abs(velocity.linear_m_s) <= p.trans_stopped_velocity
            and abs(velocity.angular_rad_s) <= p.rot_stopped_velocity
        )

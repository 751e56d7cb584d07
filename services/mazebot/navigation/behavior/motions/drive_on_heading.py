"""DriveOnHeading: drives straight ahead or back by a distance, as Nav2's behaviour."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.motions.motion import (
    DONE,
    BehaviorServerParams,
    Moment,
    Motion,
    MotionStep,
    is_over,
    toward,
)
from mazebot.navigation.control.collision import Velocity
from mazebot.navigation.errors import NavigationError


@dataclass(frozen=True, slots=True)
class DriveGoal:
    """Fields of the actions DriveOnHeading and BackUp."""

    target_x_m: float = 0.15
    """Distance to drive along the robot's heading; negative: back."""
    speed_m_s: float = 0.025
    """Same sign as the target."""
    time_allowance_s: float = 10.0
    disable_collision_checks: bool = False
    target_y_m: float = 0.0
    target_z_m: float = 0.0


class DriveOnHeading(Motion):
    """One straight drive; it brakes so that it stands at its end."""

    name: ClassVar[str] = "DriveOnHeading"
    timeout: ClassVar[ErrorCode] = ErrorCode.DRIVE_ON_HEADING_TIMEOUT
    collision_ahead: ClassVar[ErrorCode] = ErrorCode.DRIVE_ON_HEADING_COLLISION_AHEAD
    invalid_input: ClassVar[ErrorCode] = ErrorCode.DRIVE_ON_HEADING_INVALID_INPUT

    def __init__(self, params: BehaviorServerParams, goal: DriveGoal) -> None:
        super().__init__()
        if goal.target_y_m or goal.target_z_m:
            raise NavigationError(
                self.invalid_input,
                f"{self.name}: target ({goal.target_x_m:g}, {goal.target_y_m:g}, "
                f"{goal.target_z_m:g}): must have y and z 0, the robot drives along x alone",
            )
        if goal.target_x_m * goal.speed_m_s <= 0.0:
            raise NavigationError(
                self.invalid_input,
                f"{self.name}: target {goal.target_x_m:g} m at {goal.speed_m_s:g} m/s: both must "
                "be above 0, or both below",
            )
        self._params = params
        self._goal = goal
        self._start: SE2 | None = None
        self._speed_m_s = 0.0

    def _advance(self, at: Moment) -> MotionStep:
        p, goal = self._params, self._goal
        sign = math.copysign(1.0, goal.target_x_m)
        left_m = abs(goal.target_x_m) - self._driven_m(at.odom_from_base) * sign
        braking_m_s = -p.deceleration_limit * at.elapsed_s
        if left_m <= 0.0 and self._speed_m_s <= braking_m_s and at.stands:
            return DONE
        if is_over(at.running_s, goal.time_allowance_s):
            raise NavigationError(
                self.timeout,
                f"{self.name}: exceeded the time allowance of {goal.time_allowance_s:.1f} s: drove "
                f"{abs(self.feedback):.2f} of {abs(goal.target_x_m):.2f} m",
            )
        fastest_m_s = abs(goal.speed_m_s)
        ahead_m = max(left_m - self._speed_m_s * at.elapsed_s, 0.0)
        wanted_m_s = min(
            max(math.sqrt(-2.0 * p.deceleration_limit * ahead_m), p.minimum_speed),
            fastest_m_s,
        )
        if left_m <= 0.0:
            wanted_m_s = 0.0
        elif not goal.disable_collision_checks:
            wanted = Velocity(goal.speed_m_s, 0.0)
            contact_s = at.time_to_collision(wanted)
            if contact_s <= min(p.simulate_ahead_time, left_m / fastest_m_s):
                raise NavigationError(
                    self.collision_ahead,
                    f"{self.name}: {at.obstacle(wanted, contact_s)} "
                    f"{contact_s * fastest_m_s:.2f} m "
                    f"{'ahead' if sign > 0.0 else 'behind'}",
                )
        faster = wanted_m_s > self._speed_m_s
        change_m_s = p.acceleration_limit * at.elapsed_s if faster else braking_m_s
        self._speed_m_s = toward(self._speed_m_s, wanted_m_s, change_m_s)
        return MotionStep(False, Velocity(self._speed_m_s * sign, 0.0))

    def _driven_m(self, odom_from_base: SE2) -> float:
        """Distance from the start along the heading there; negative: back."""
        if self._start is None:
            self._start = odom_from_base
        cos, sin = portable.cos_sin(self._start.yaw_rad)
        self.feedback = (odom_from_base.x_m - self._start.x_m) * cos + (
            odom_from_base.y_m - self._start.y_m
        ) * sin
        return self.feedback

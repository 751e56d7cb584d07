"""Spin: turns the robot on the spot by an angle, as Nav2's behaviour of this name."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mazebot.common.maths.frames import wrap_angle
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.motions.motion import (
    DONE,
    BehaviorServerParams,
    Moment,
    Motion,
    MotionStep,
    TimeToCollision,
    is_over,
    toward,
)
from mazebot.navigation.control.collision import Velocity
from mazebot.navigation.errors import NavigationError


@dataclass(frozen=True, slots=True)
class SpinGoal:
    """Fields of the action Spin."""

    target_yaw_rad: float = 1.57
    """Angle to turn by, positive to the left; it may exceed 2 pi."""
    time_allowance_s: float = 10.0
    disable_collision_checks: bool = False


class Spin(Motion):
    """One turn; it brakes so that it stands at its end."""

    def __init__(self, params: BehaviorServerParams, goal: SpinGoal) -> None:
        super().__init__()
        self._params = params
        self._goal = goal
        self._rate_rad_s = 0.0
        self._last_yaw_rad: float | None = None

    def _advance(self, at: Moment) -> MotionStep:
        p, goal = self._params, self._goal
        yaw_rad = at.odom_from_base.yaw_rad
        if self._last_yaw_rad is not None:
            self.feedback += wrap_angle(yaw_rad - self._last_yaw_rad)
        self._last_yaw_rad = yaw_rad
        sign = math.copysign(1.0, goal.target_yaw_rad)
        left_rad = (goal.target_yaw_rad - self.feedback) * sign
        change_rad_s = p.rotational_acc_lim * at.elapsed_s
        if left_rad <= 0.0 and abs(self._rate_rad_s) <= change_rad_s and at.stands:
            return DONE
        if is_over(at.running_s, goal.time_allowance_s):
            raise NavigationError(
                ErrorCode.SPIN_TIMEOUT,
                f"Spin: exceeded the time allowance of {goal.time_allowance_s:.1f} s: turned "
                f"{abs(self.feedback):.2f} of {abs(goal.target_yaw_rad):.2f} rad",
            )
        # The command acts for a whole period before the next one can brake.
        ahead_rad = max(left_rad - abs(self._rate_rad_s) * at.elapsed_s, 0.0)
        braking_rad_s = math.sqrt(2.0 * p.rotational_acc_lim * ahead_rad)
        wanted_rad_s = min(max(braking_rad_s, p.min_rotational_vel), p.max_rotational_vel)
        if left_rad <= 0.0:
            wanted_rad_s = 0.0
        self._rate_rad_s = toward(self._rate_rad_s, wanted_rad_s * sign, change_rad_s)
        velocity = Velocity(0.0, self._rate_rad_s)
        if not goal.disable_collision_checks and left_rad > 0.0:
            self._check_ahead(at.time_to_collision, sign, left_rad)
        return MotionStep(False, velocity)

    def _check_ahead(
        self, time_to_collision: TimeToCollision, sign: float, left_rad: float
    ) -> None:
        p = self._params
        # At the highest rate: that of the whole turn, not of its first moment.
        rate_rad_s = p.max_rotational_vel
        contact_s = time_to_collision(Velocity(0.0, rate_rad_s * sign))
        if contact_s <= min(p.simulate_ahead_time, left_rad / rate_rad_s):
            side = "left" if sign > 0.0 else "right"
            raise NavigationError(
                ErrorCode.SPIN_COLLISION_AHEAD,
                f"Spin: collision after turning {side} by {contact_s * rate_rad_s:.2f} rad",
            )


def freer_turn_rad(
    angle_rad: float, params: BehaviorServerParams, time_to_collision: TimeToCollision
) -> float:
    """The angle with the sign of the side to which the robot can turn further."""
    rate_rad_s = params.max_rotational_vel
    wanted = time_to_collision(Velocity(0.0, math.copysign(rate_rad_s, angle_rad)))
    other = time_to_collision(Velocity(0.0, math.copysign(rate_rad_s, -angle_rad)))
    return -angle_rad if other > wanted else angle_rad

"""The velocity smoother: commands under the robot's limits of speed and acceleration, by the rules
of nav2_velocity_smoother. It comes before the collision monitor.
"""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.robot import waffle
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.controller import RobotLimits

Feedback = Literal["OPEN_LOOP", "CLOSED_LOOP"]

_ROUNDING: Final = 1e-9
"""A command that keeps to the limits by its own arithmetic passes unchanged."""
_Most = Annotated[float, Field(ge=0.0)]
_Least = Annotated[float, Field(le=0.0)]
_Accel = Annotated[float, Field(gt=0.0)]
_Decel = Annotated[float, Field(lt=0.0)]


class VelocitySmootherParams(Params):
    """Names, and the three values for x, y and theta, as in Nav2; the robot has no y."""

    feedback: Feedback = Field(
        "OPEN_LOOP",
        description="OPEN_LOOP: continues from its last command; CLOSED_LOOP: from odometry",
    )
    scale_velocities: bool = Field(
        False, description="limit both axes by one factor, which keeps the curvature"
    )
    max_velocity: tuple[_Most, _Most, _Most] = Field(
        (waffle.MAX_LINEAR_M_S, 0.0, waffle.MAX_ANGULAR_RAD_S),
        description="m/s, m/s, rad/s; the robot's own limits are 0.46 and 1.9",
    )
    min_velocity: tuple[_Least, _Least, _Least] = Field(
        (-waffle.MAX_LINEAR_M_S, 0.0, -waffle.MAX_ANGULAR_RAD_S),
        description="m/s, m/s, rad/s; backwards and clockwise",
    )
    max_accel: tuple[_Accel, float, _Accel] | None = Field(
        None,
        description="m/s2, m/s2, rad/s2; none: max_linear_accel and max_angular_accel of the "
        "controller server",
    )
    max_decel: tuple[_Decel, float, _Decel] | None = Field(
        None, description="m/s2, m/s2, rad/s2, negative; none: as strong as the acceleration"
    )
    deadband_velocity: tuple[_Most, _Most, _Most] = Field(
        (0.0, 0.0, 0.0), description="m/s, m/s, rad/s; slower commands are sent as 0"
    )
    velocity_timeout: float = Field(
        1.0, ge=0, description="s; a command this old is followed by a ramp to a stop"
    )


def _planar(values: tuple[float, float, float]) -> Velocity:
    return Velocity(values[0], values[2])


class VelocitySmoother:
    """Follows the newest command within the limits."""

    def __init__(self, params: VelocitySmootherParams, limits: RobotLimits) -> None:
        """`limits`: the robot's, where the parameters give no accelerations."""
        self._params = params
        accel = params.max_accel or (limits.max_linear_accel, 0.0, limits.max_angular_accel)
        self._accel = _planar(accel)
        self._decel = _planar(params.max_decel or (-accel[0], 0.0, -accel[2]))
        self._most = _planar(params.max_velocity)
        self._least = _planar(params.min_velocity)
        self._dead = _planar(params.deadband_velocity)
        self._command: Velocity | None = None
        self._command_ns = 0
        self._last = STOP

    @property
    def last(self) -> Velocity:
        """The velocity last given, without the dead band."""
        return self._last

    def take(self, now_ns: int, command: Velocity) -> bool:
        """Take a new command; False if it is ignored, because it is not finite."""
        if not (math.isfinite(command.linear_m_s) and math.isfinite(command.angular_rad_s)):
            return False
        self._command, self._command_ns = command, now_ns
        return True

    def reset(self, velocity: Velocity = STOP) -> None:
        """Forget the command and go on from a velocity: after a stop that was not its own."""
        self._command, self._last = None, velocity

    def step(self, now_ns: int, elapsed_s: float, measured: Velocity = STOP) -> Velocity | None:
        """The velocity to send now; None: there is no command, and the robot is stopped.

        Args:
            now_ns: the time.
            elapsed_s: since the step before, in which the velocity may change.
            measured: by odometry, for CLOSED_LOOP.
        """
        params = self._params
        if self._command is None:
            return None
        target = self._clipped(self._command)
        if now_ns - self._command_ns > params.velocity_timeout * 1e9:
            if self._last == STOP:
                self._command = None
                return None
            target = STOP
        current = measured if params.feedback == "CLOSED_LOOP" else self._last
        self._last = self._towards(current, target, elapsed_s)
        v, w = self._last
        dead = self._dead
        return Velocity(
            v if abs(v) >= dead.linear_m_s else 0.0, w if abs(w) >= dead.angular_rad_s else 0.0
        )

    def _clipped(self, command: Velocity) -> Velocity:
        low, high = self._least, self._most
        if not self._params.scale_velocities:
            return Velocity(
                min(max(command.linear_m_s, low.linear_m_s), high.linear_m_s),
                min(max(command.angular_rad_s, low.angular_rad_s), high.angular_rad_s),
            )
        scale = 1.0
        for value, least, most in zip(command, low, high, strict=True):
            limit = most if value > 0.0 else least
            if abs(value) > abs(limit):
                scale = min(scale, limit / value)
        return Velocity(command.linear_m_s * scale, command.angular_rad_s * scale)

    def _towards(self, current: Velocity, target: Velocity, elapsed_s: float) -> Velocity:
        params = self._params
        changes, shares = [], []
        for now, wanted, accel, decel in zip(
            current, target, self._accel, self._decel, strict=True
        ):
            # Faster in the same direction is acceleration, everything else deceleration.
            faster = abs(wanted) >= abs(now) and now * wanted >= 0.0
            most = (accel if faster else -decel) * elapsed_s + _ROUNDING
            change = wanted - now
            changes.append(change)
            shares.append(min(1.0, most / abs(change)) if change != 0.0 else 1.0)
        if params.scale_velocities:
            shares = [min(shares)] * 2
        values = [
            wanted if share == 1.0 else now + change * share
            for now, wanted, change, share in zip(current, target, changes, shares, strict=True)
        ]
        return Velocity(*values)

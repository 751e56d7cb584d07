"""A differential drive: limits, ramps, and the watchdog that stops a robot nobody commands.

A stop by the watchdog brakes harder than a command may: from 0.46 m/s and from 1.9 rad/s the robot
has to be at rest 0.4 s after the last command, and 0.2 s of these have gone by when the watchdog
trips. 4 m/s2 and 14 rad/s2 need 0.115 s and 0.136 s, which leaves 0.06 s to the bus. Where the bus
tells that the one who commanded is gone, the watchdog does not wait. On both wheels at once that is
6 m/s2 at the tyre: within the grip of the weight on it, but where the robot turns and backs at full
speed, which slides by 5 mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class DriveLimits:
    """What the drive can do."""

    wheel_separation_m: float
    wheel_radius_m: float
    linear_speed_m_s: float
    linear_acceleration_m_s2: float
    angular_speed_rad_s: float
    angular_acceleration_rad_s2: float
    timeout_ns: int
    watchdog_linear_deceleration_m_s2: float
    watchdog_angular_deceleration_rad_s2: float


class Drive:
    """Turns velocity commands into wheel speeds."""

    def __init__(self, limits: DriveLimits) -> None:
        self._limits = limits
        self._target_linear = 0.0
        self._target_angular = 0.0
        self._linear = 0.0
        self._angular = 0.0
        self._commanded_ns: int | None = None
        self._braking = False
        self.watchdog_stops = 0
        """Times the watchdog stopped a robot that had been told to move."""

    @property
    def is_commanded(self) -> bool:
        """Whether the last command still holds: it has not gone stale."""
        return self._commanded_ns is not None

    @property
    def is_driven(self) -> bool:
        """Whether a command that still holds is to move."""
        moves = self._target_linear != 0.0 or self._target_angular != 0.0
        return self.is_commanded and moves

    @property
    def is_at_rest(self) -> bool:
        """Whether the wheels are told to stand, and nobody is about to tell them otherwise."""
        return not self.is_commanded and self._linear == self._angular == 0.0

    def command(self, linear_m_s: float, angular_rad_s: float, now_ns: int) -> None:
        """Take in a velocity of base_footprint; what is beyond the limits is clamped.

        One that is not finite is none: nothing changes.
        """
        if not (math.isfinite(linear_m_s) and math.isfinite(angular_rad_s)):
            return
        limits = self._limits
        self._target_linear = _clamp(linear_m_s, limits.linear_speed_m_s)
        self._target_angular = _clamp(angular_rad_s, limits.angular_speed_rad_s)
        self._commanded_ns = now_ns
        self._braking = False

    def expire(self) -> None:
        """The one who sent the last command is gone: none will come in time."""
        if self._commanded_ns is not None:
            self._commanded_ns -= self._limits.timeout_ns

    def restart_clock(self, now_ns: int) -> None:
        """Time goes on from 0 instead of `now_ns`; the last command keeps its age."""
        if self._commanded_ns is not None:
            self._commanded_ns -= now_ns

    def step(self, now_ns: int, step_s: float) -> tuple[float, float] | None:
        """Left and right wheel speed, rad/s, in the step that ends at `now_ns`; None: as before."""
        limits = self._limits
        commanded_ns = self._commanded_ns
        if commanded_ns is not None and now_ns - commanded_ns >= limits.timeout_ns:
            if self._target_linear != 0.0 or self._target_angular != 0.0:
                self.watchdog_stops += 1
            self._target_linear = self._target_angular = 0.0
            self._commanded_ns = None
            self._braking = True
        if self._linear == self._target_linear and self._angular == self._target_angular:
            return None
        linear_rate = limits.linear_acceleration_m_s2
        angular_rate = limits.angular_acceleration_rad_s2
        if self._braking:
            linear_rate = limits.watchdog_linear_deceleration_m_s2
            angular_rate = limits.watchdog_angular_deceleration_rad_s2
        self._linear += _clamp(self._target_linear - self._linear, linear_rate * step_s)
        self._angular += _clamp(self._target_angular - self._angular, angular_rate * step_s)
        half_turn = self._angular * limits.wheel_separation_m / 2.0
        return (
            (self._linear - half_turn) / limits.wheel_radius_m,
            (self._linear + half_turn) / limits.wheel_radius_m,
        )


def _clamp(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))

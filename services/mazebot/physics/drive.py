"""A differential drive: limits, acceleration ramps and the watchdog for velocity commands.

The watchdog brakes harder than a command may: from 0.46 m/s and from 1.9 rad/s the robot must be
at rest 0.4 s after the last command, and 0.2 s of these have passed when the watchdog trips.
4 m/s2 and 14 rad/s2 need 0.115 s and 0.136 s, which leaves 0.06 s for the bus. If the bus reports
that the source of the commands is gone, the watchdog does not wait. Both decelerations together
are 6 m/s2 at the tyre: within its grip, except that a robot which turns and reverses at full speed
slides by 5 mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class DriveLimits:
    """Geometry, limits and command timeout of the drive."""

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
        self._held = False
        self.watchdog_stops = 0
        """Times the watchdog stopped a robot whose command was not zero."""

    @property
    def is_commanded(self) -> bool:
        """Whether the last command has not timed out."""
        return self._commanded_ns is not None

    @property
    def is_driven(self) -> bool:
        """Whether a command is active and not zero."""
        moves = self._target_linear != 0.0 or self._target_angular != 0.0
        return self.is_commanded and moves

    @property
    def is_at_rest(self) -> bool:
        """Whether the set wheel speeds are 0 and no command is active."""
        return not self.is_commanded and self._linear == self._angular == 0.0

    def command(self, linear_m_s: float, angular_rad_s: float, now_ns: int) -> None:
        """Set the target velocity of base_footprint, clamped to the limits.

        A command that is not finite is ignored, and any command while the robot is held.
        """
        if self._held or not (math.isfinite(linear_m_s) and math.isfinite(angular_rad_s)):
            return
        limits = self._limits
        self._target_linear = _clamp(linear_m_s, limits.linear_speed_m_s)
        self._target_angular = _clamp(angular_rad_s, limits.angular_speed_rad_s)
        self._commanded_ns = now_ns
        self._braking = False

    def expire(self) -> None:
        """Time out the last command, because its source is gone."""
        if self._commanded_ns is not None:
            self._commanded_ns -= self._limits.timeout_ns

    def hold(self) -> None:
        """Brake as the watchdog does, and stay at rest until `release`."""
        self._target_linear = self._target_angular = 0.0
        self._commanded_ns = None
        self._braking = self._held = True

    def release(self) -> None:
        """Obey commands again."""
        self._held = False

    def restart_clock(self, now_ns: int) -> None:
        """Set the time from `now_ns` back to 0; the last command keeps its age."""
        if self._commanded_ns is not None:
            self._commanded_ns -= now_ns

    def step(self, now_ns: int, step_s: float) -> tuple[float, float] | None:
        """Left and right wheel speed, rad/s, in the step that ends at `now_ns`; None: unchanged."""
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

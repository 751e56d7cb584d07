"""States of the robot and the moving bodies after a step, and whether they are physical."""

from __future__ import annotations

import math
from typing import NamedTuple

from mazebot.common.messages.documents import Quaternion, Vector

_FAR_M = 10_000.0
_LOWEST_M, _HIGHEST_M = -0.05, 0.5
_MAX_SPEED_M_S = 20.0
_MAX_WHEEL_SPEED_RAD_S = 10_000.0
_DEEPEST_M = -1.0
_MAX_MOVER_SPEED_M_S = 200.0


class BodyState(NamedTuple):
    """The robot after a step, exactly as PyBullet has it, in the map frame."""

    position_m: Vector
    """Of the base's centre of mass."""
    orientation_xyzw: Quaternion
    velocity_m_s: Vector
    """Of the base's centre of mass."""
    angular_velocity_rad_s: Vector
    wheel_angles_rad: tuple[float, float]
    """Left, right; turning forwards is positive; not wrapped."""
    wheel_speeds_rad_s: tuple[float, float]

    def is_sane(self) -> bool:
        """Whether the state is physical: PyBullet accepts non-finite values silently."""
        x, y, z = self.position_m
        vx, vy, vz = self.velocity_m_s
        wx, wy, wz = self.angular_velocity_rad_s
        qx, qy, qz, qw = self.orientation_xyzw
        turn = wx + wy + wz + qx + qy + qz + qw
        left, right = self.wheel_angles_rad
        left_speed, right_speed = self.wheel_speeds_rad_s
        # A comparison with NaN is False.
        return (
            -_FAR_M < x < _FAR_M
            and -_FAR_M < y < _FAR_M
            and _LOWEST_M < z < _HIGHEST_M
            and -_MAX_SPEED_M_S < vx < _MAX_SPEED_M_S
            and -_MAX_SPEED_M_S < vy < _MAX_SPEED_M_S
            and -_MAX_SPEED_M_S < vz < _MAX_SPEED_M_S
            and -_FAR_M < turn < _FAR_M
            and -_MAX_WHEEL_SPEED_RAD_S < left_speed < _MAX_WHEEL_SPEED_RAD_S
            and -_MAX_WHEEL_SPEED_RAD_S < right_speed < _MAX_WHEEL_SPEED_RAD_S
            and math.isfinite(left + right)
        )


class MoverState(NamedTuple):
    """A moving body after a step, exactly as PyBullet has it, in the map frame."""

    position_m: Vector
    """Of its centre of mass."""
    orientation_xyzw: Quaternion
    """Of its principal axes."""
    velocity_m_s: Vector
    angular_velocity_rad_s: Vector

    def is_sane(self) -> bool:
        """Whether the state is physical."""
        x, y, z = self.position_m
        turn = math.fsum(self.angular_velocity_rad_s) + math.fsum(self.orientation_xyzw)
        return (
            -_FAR_M < x < _FAR_M
            and -_FAR_M < y < _FAR_M
            and _DEEPEST_M < z < _FAR_M
            and max(map(abs, self.velocity_m_s)) < _MAX_MOVER_SPEED_M_S
            and -_FAR_M < turn < _FAR_M
        )

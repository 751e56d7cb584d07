"""How far the robot is tilted, from its gyroscope and accelerometer.

The gyroscope tells how it tips over a sill; the accelerometer, which also feels the robot's own
acceleration, tells only that it is level again.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.common.messages import messages as msg

_Vector = tuple[float, float, float]

_KEPT = 240
"""Two seconds of readings: pictures come later than what is measured with them."""
_LONGEST_S = 0.1
"""Between a reading and what it stands for."""
_STEADY_RAD_S = 0.01
"""What tips slower does not tip."""
_STEADY_READINGS = 30
"""A quarter of a second: their mean has a twentieth of a degree of noise at most, and no robot
accelerates so long as a tilted one would have to, to look level.
"""
_LEARNS = 0.02
"""Of what a level robot feels in a quarter of a second, so much goes into what level is, and more
at first: in 12 s, starts and stops cancel out.
"""
_TRUSTED_READINGS = 4
"""So many quarters of a second the mounting that the sensor tells counts for."""
_MOST_OFF_RAD = 0.035
"""No sensor is mounted so badly: the robot accelerates, or is tilted."""
_STANDS = 40
"""Quarters of a second without tipping. A robot that is tilted less than a sensor may be, and stays
so, counts as level: else its camera would be lost for good.
"""


class Tilt:
    """The tilt at each of the last readings. The robot is level at first, and the sensor mounted as
    it says, or nearly: what it feels where the gyroscope knows of no tilt is what level is.
    """

    def __init__(self, tolerance_rad: float) -> None:
        """A robot tilted by less than the tolerance counts as level."""
        self._tolerance = tolerance_rad
        self._up: _Vector | None = None
        """Of the world, in the axes of the sensor"""
        self._level: _Vector | None = None
        """Of the robot, in the same axes"""
        self._learned = _TRUSTED_READINGS
        self._steady = 0
        """Quarters of a second since it was last seen to tip"""
        self._rate: _Vector = (0.0, 0.0, 0.0)
        self._felt: list[_Vector] = []
        """Specific forces of a part of a quarter of a second without tipping"""
        self._tilts: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    def forget(self) -> None:
        """Begin anew, with a level robot."""
        self._up = self._level = None
        self._learned = _TRUSTED_READINGS
        self._steady = 0
        self._felt.clear()
        self._tilts.clear()

    def take(self, imu: msg.Imu, base_from_imu: Array) -> None:
        """Take the next reading."""
        stamp_ns = msg.ns_from_time(imu.header.stamp)
        spin, force = imu.angular_velocity, imu.linear_acceleration
        rate = (spin.x, spin.y, spin.z)
        if self._up is None or self._level is None:
            self._up = self._level = _vector(base_from_imu[2, :3].tolist())
        if _length(_cross(rate, self._level)) > _STEADY_RAD_S:
            self._steady = 0
            self._felt.clear()
        else:
            # The rest may be the gyroscope's bias.
            yaw_rate = _dot(rate, self._level)
            rate = _vector([yaw_rate * axis for axis in self._level])
            self._felt.append((force.x, force.y, force.z))
        if self._tilts:
            elapsed_s = min((stamp_ns - self._tilts[-1][0]) * 1e-9, _LONGEST_S)
            turn = [(a + b) / 2.0 * elapsed_s for a, b in zip(rate, self._rate, strict=True)]
            moved = _cross(self._up, _vector(turn))
            self._up = _unit([a + b for a, b in zip(self._up, moved, strict=True)])
        self._rate = rate
        if len(self._felt) >= _STEADY_READINGS:
            self._take_steady(_unit([sum(axis) for axis in zip(*self._felt, strict=True)]))
            self._felt.clear()
        self._tilts.append((stamp_ns, _angle_rad(self._up, self._level)))

    def _take_steady(self, felt: _Vector) -> None:
        """Take the mean direction of the force while the robot did not tip."""
        assert self._up is not None
        assert self._level is not None
        self._steady += 1
        off_rad = _angle_rad(felt, self._level)
        stands = off_rad <= _MOST_OFF_RAD and self._steady >= _STANDS
        if stands or max(off_rad, _angle_rad(self._up, self._level)) <= _MOST_OFF_RAD:
            self._learned += 1
            share = max(_LEARNS, 1.0 / self._learned)
            moved = [share * (a - b) for a, b in zip(felt, self._level, strict=True)]
            self._level, self._up = (
                _unit([a + b for a, b in zip(one, moved, strict=True)])
                for one in (self._level, self._up)
            )
        if stands or off_rad <= self._tolerance:
            self._up = self._level

    def at(self, stamp_ns: int) -> float:
        """The tilt at a time, rad; 0 where no reading tells."""
        for taken_ns, tilt_rad in reversed(self._tilts):
            if taken_ns <= stamp_ns:
                return tilt_rad if stamp_ns - taken_ns <= _LONGEST_S * 1e9 else 0.0
        return 0.0


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: _Vector, b: _Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _length(v: _Vector) -> float:
    return math.sqrt(_dot(v, v))


def _vector(values: Sequence[float]) -> _Vector:
    return values[0], values[1], values[2]


def _unit(values: Sequence[float]) -> _Vector:
    x, y, z = values
    length = _length((x, y, z))
    return (x / length, y / length, z / length) if length > 0.0 else (x, y, z)


def _angle_rad(a: _Vector, b: _Vector) -> float:
    return portable.atan2(_length(_cross(a, b)), _dot(a, b))

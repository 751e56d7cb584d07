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


class Tilt:
    """The tilt at each of the last readings. The robot is level at first."""

    def __init__(self, tolerance_rad: float) -> None:
        """A robot tilted by less than the tolerance counts as level."""
        self._tolerance = tolerance_rad
        self._up: _Vector | None = None
        """Of the world, in the axes of the sensor"""
        self._rate: _Vector = (0.0, 0.0, 0.0)
        self._felt: list[_Vector] = []
        """Specific forces since it was last seen to tip or to be level"""
        self._tilts: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    def forget(self) -> None:
        """Begin anew, with a level robot."""
        self._up = None
        self._felt.clear()
        self._tilts.clear()

    def take(self, imu: msg.Imu, base_from_imu: Array) -> None:
        """Take the next reading."""
        stamp_ns = msg.ns_from_time(imu.header.stamp)
        spin, force = imu.angular_velocity, imu.linear_acceleration
        level = _vector(base_from_imu[2, :3].tolist())
        rate = (spin.x, spin.y, spin.z)
        if self._up is None:
            self._up = level
        else:
            # Readings may be lost, or be of a simulation that has ended since.
            elapsed_s = min(max((stamp_ns - self._tilts[-1][0]) * 1e-9, 0.0), _LONGEST_S)
            turn = [(a + b) / 2.0 * elapsed_s for a, b in zip(rate, self._rate, strict=True)]
            moved = _cross(self._up, _vector(turn))
            self._up = _unit([a + b for a, b in zip(self._up, moved, strict=True)])
        self._rate = rate
        if _length(_cross(rate, level)) > _STEADY_RAD_S:
            self._felt.clear()
        else:
            self._felt.append((force.x, force.y, force.z))
        if len(self._felt) >= _STEADY_READINGS:
            total = _unit([sum(axis) for axis in zip(*self._felt, strict=True)])
            if _angle_rad(total, level) <= self._tolerance:
                self._up = level
            self._felt.clear()
        self._tilts.append((stamp_ns, _angle_rad(self._up, level)))

    def at(self, stamp_ns: int) -> float:
        """The tilt at a time, rad; 0 where no reading tells."""
        for taken_ns, tilt_rad in reversed(self._tilts):
            if taken_ns <= stamp_ns:
                return tilt_rad if stamp_ns - taken_ns <= _LONGEST_S * 1e9 else 0.0
        return 0.0


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _length(v: _Vector) -> float:
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def _vector(values: Sequence[float]) -> _Vector:
    return values[0], values[1], values[2]


def _unit(values: Sequence[float]) -> _Vector:
    x, y, z = values
    length = _length((x, y, z))
    return (x / length, y / length, z / length) if length > 0.0 else (x, y, z)


def _angle_rad(a: _Vector, b: _Vector) -> float:
    return portable.atan2(_length(_cross(a, b)), a[0] * b[0] + a[1] * b[1] + a[2] * b[2])

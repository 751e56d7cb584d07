"""A turn of the lidar, as localization, mapping and navigation use it."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array, se2_from_matrix
from mazebot.common.messages.messages import LaserScan, ns_from_time

MOST_TURNS = 1.1
"""A lidar's beams may overlap a little; those of an increment in degrees go round 57 times."""


@dataclass(frozen=True, slots=True)
class Mount:
    """How a lidar is mounted: where, and which side up."""

    base_from_scan: SE2
    """Its pose, seen from above, in the frame that it is mounted in: base_footprint."""
    is_upside_down: bool = False
    """Then its beams follow each other clockwise where its angles grow."""

    @classmethod
    def of(cls, base_from_scan: Array) -> Mount:
        """Of the rigid (4, 4) transform of a lidar that is level."""
        return cls(se2_from_matrix(base_from_scan), bool(base_from_scan[2, 2] < 0.0))

    def angle_rad(self, angle_rad: float) -> float:
        """An angle of the lidar, seen from above."""
        return -angle_rad if self.is_upside_down else angle_rad


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """The ranges of a sensor_msgs/LaserScan, and where its lidar is on the robot."""

    ranges_m: NDArray[np.float32]
    """(n,) `ranges`, counter-clockwise, or clockwise where the increment is negative; `inf` is no
    echo, `-inf` and NaN are no measurement, as in REP 117."""
    angle_min_rad: float
    """`angle_min`: of the first beam, in base_scan; of a lidar upside down, negated."""
    angle_increment_rad: float
    """`angle_increment`: between two beams; likewise."""
    range_min_m: float
    """`range_min`: shorter ranges are no measurement."""
    range_max_m: float
    """`range_max`: a beam of this range or a longer one had no echo."""
    base_from_scan: SE2
    """Pose of the lidar in base_footprint, from /tf_static."""
    stamp_ns: int = 0
    """`header.stamp`: simulation time at which it was taken."""

    @classmethod
    def from_message(cls, message: LaserScan, mount: Mount) -> Scan:
        """The scan of a message."""
        return cls(
            message.ranges,
            mount.angle_rad(message.angle_min),
            mount.angle_rad(message.angle_increment),
            message.range_min,
            message.range_max,
            mount.base_from_scan,
            ns_from_time(message.header.stamp),
        )

    @property
    def has_limits(self) -> bool:
        """Whether a range can lie within its limits: `range_max` may be inf, neither may be NaN."""
        return math.isfinite(self.range_min_m) and self.range_min_m < self.range_max_m

    @property
    def has_angles(self) -> bool:
        """Whether its beams have directions: finite ones, over little more than a turn at most."""
        are_finite = math.isfinite(self.angle_min_rad) and math.isfinite(self.angle_increment_rad)
        return are_finite and turns_of(self.angle_increment_rad, len(self.ranges_m)) <= MOST_TURNS

    def directions(self) -> Array:
        """(n, 2) unit vectors of the beams in base_footprint."""
        first_rad = self.angle_min_rad + self.base_from_scan.yaw_rad
        return _directions(len(self.ranges_m), float(first_rad), float(self.angle_increment_rad))


def turns_of(increment_rad: float, beams: int) -> float:
    """How often so many beams go round, from the first to the last."""
    return abs(increment_rad) * max(0, beams - 1) / math.tau


# All scans of a lidar have the same beams.
@functools.lru_cache(maxsize=8)
def _directions(count: int, first_rad: float, increment_rad: float) -> Array:
    angles = first_rad + increment_rad * np.arange(count)
    return np.stack(portable_kernels.cos_sin_each(angles), axis=1)

"""The last seconds of odometry, for the pose at a measurement's own time."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque

from mazebot.common.maths.frames import SE2, wrap_angle

NO_ODOMETRY = "without odometry at their time"
"""Why scans are not used"""
_SAMPLES = 90
"""3 s"""
_EXTRAPOLATE_NS = 200_000_000


class OdometryHistory:
    """Stamped odom_from_base, the oldest first."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, SE2]] = deque(maxlen=_SAMPLES)

    def __bool__(self) -> bool:
        return bool(self._samples)

    @property
    def latest(self) -> tuple[int, SE2]:
        """Stamp and pose of the last sample."""
        return self._samples[-1]

    def add(self, stamp_ns: int, odom_from_base: SE2) -> bool:
        """Add a sample; False if it is not later than the last one, or not finite."""
        if self._samples and stamp_ns <= self._samples[-1][0]:
            return False
        if not all(math.isfinite(value) for value in odom_from_base):
            return False
        self._samples.append((stamp_ns, odom_from_base))
        return True

    def forget(self) -> None:
        """Keep only the last sample: what was measured before is from another pose."""
        self._samples = deque([self._samples[-1]], maxlen=_SAMPLES)

    def correct(self, odom_from_base: SE2) -> None:
        """Give the last sample another pose, and forget those before it, which were wrong."""
        self._samples[-1] = (self._samples[-1][0], odom_from_base)
        self.forget()

    def at(self, stamp_ns: int) -> SE2 | None:
        """The pose at a time, interpolated or shortly extrapolated; None outside."""
        samples = self._samples
        if not samples or stamp_ns < samples[0][0]:
            return None
        after = bisect_right(samples, stamp_ns, key=lambda entry: entry[0])
        if after == len(samples):
            if stamp_ns - samples[-1][0] > _EXTRAPOLATE_NS:
                return None
            if len(samples) == 1:
                return samples[-1][1]
            after -= 1
        (t0, pose0), (t1, pose1) = samples[after - 1], samples[after]
        ratio = (stamp_ns - t0) / (t1 - t0)
        return SE2(
            pose0.x_m + ratio * (pose1.x_m - pose0.x_m),
            pose0.y_m + ratio * (pose1.y_m - pose0.y_m),
            wrap_angle(pose0.yaw_rad + ratio * wrap_angle(pose1.yaw_rad - pose0.yaw_rad)),
        )

"""Where the robot truly was, and how far it had driven, at any time of a run."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right

import numpy as np

from services.common.frames import SE2, wrap_angle

JITTER_M = 2e-3
"""Displacements shorter than this are the trembling of a robot at rest, and no path."""

_RECENT = 1800
"""Poses kept as they came, a minute's; of older ones,"""
_OLD_PERIOD_NS = 500_000_000
"""one of this time, on a line between two of which a robot that can reach 0.5 m/s within a second
is off by less than 2 cm;"""
_OLD_AGE_NS = 3_600_000_000_000
"""and of those older than this, one of twice that time, and so on with each doubling of their age:
a run of days takes little more memory than one of hours, and beyond an hour from one pose to the
next is at most a 3600th of their age.
"""


class DrivenWay:
    """The true poses of a run in the order of their time, and the length of the path by them."""

    def __init__(self) -> None:
        self.total_m = 0.0
        self._counted_xy: tuple[float, float] | None = None
        self._stamps_ns = array("q")
        self._columns = tuple(array("d") for _ in range(4))
        """x and y (m), yaw (rad) without jumps, and length (m)."""
        self._thinned = 0
        """How many of them are few enough."""

    def add(self, stamp_ns: int, pose: SE2) -> None:
        """Take in a true pose, newer than all before."""
        if self._counted_xy is None:
            self._counted_xy = pose.x_m, pose.y_m
        step_m = math.dist(self._counted_xy, pose[:2])
        if step_m >= JITTER_M:
            self.total_m += step_m
            self._counted_xy = pose.x_m, pose.y_m
        yaws_rad = self._columns[2]
        yaw_rad = pose.yaw_rad
        if yaws_rad:
            yaw_rad = yaws_rad[-1] + wrap_angle(yaw_rad - yaws_rad[-1])
        self._stamps_ns.append(stamp_ns)
        for column, value in zip(
            self._columns, (pose.x_m, pose.y_m, yaw_rad, self.total_m), strict=True
        ):
            column.append(value)
        if len(self._stamps_ns) - self._thinned >= 2 * _RECENT:
            self._thin()

    def at(self, stamp_ns: int) -> tuple[SE2, float] | None:
        """Pose and length driven (m) at a time, between the poses around it; before the first and
        after the last, theirs. None where there is none.
        """
        after = bisect_right(self._stamps_ns, stamp_ns)
        if not self._stamps_ns:
            return None
        first, last = max(after - 1, 0), min(after, len(self._stamps_ns) - 1)
        start_ns, end_ns = self._stamps_ns[first], self._stamps_ns[last]
        share = (stamp_ns - start_ns) / (end_ns - start_ns) if end_ns > start_ns else 0.0
        x_m, y_m, yaw_rad, length_m = (
            column[first] + share * (column[last] - column[first]) for column in self._columns
        )
        return SE2(x_m, y_m, wrap_angle(yaw_rad)), length_m

    def _thin(self) -> None:
        """Leave out most of the poses that have become old."""
        end = len(self._stamps_ns) - _RECENT
        stamps_ns = np.array(self._stamps_ns[:end], np.int64)
        ages = np.maximum((stamps_ns[-1] - stamps_ns) / _OLD_AGE_NS, 1.0)
        periods_ns = _OLD_PERIOD_NS << np.ceil(np.log2(ages)).astype(np.int64)
        kept = np.flatnonzero(np.diff(stamps_ns // periods_ns, prepend=-1)).tolist()
        self._stamps_ns[:end] = array("q", [self._stamps_ns[i] for i in kept])
        for column in self._columns:
            column[:end] = array("d", [column[i] for i in kept])
        self._thinned = len(kept)

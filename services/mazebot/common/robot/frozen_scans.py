"""Notices a lidar that shows the same turn again and again, with new stamps, while the robot moves.

A driver that has lost its device may do so. No lidar measures the same twice to the last bit, from
two places still less: what it shows is where the robot was.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2

if TYPE_CHECKING:
    from mazebot.common.messages.scan import Scan

FROZEN: Final = "repeated while the robot moves"
"""Why such a scan is left out."""
_MOVED_M, _MOVED_RAD = 0.03, 0.05
"""By odometry, since the scan came first: less may be noise of a robot that stands."""


class FrozenScans:
    """The newest scan that is not like the one before, and where the robot was."""

    def __init__(self) -> None:
        self._first: tuple[NDArray[np.float32], SE2] | None = None
        self._has_measured = False
        """Whether two scans differed: what never measured has not frozen."""

    def is_frozen(self, scan: Scan, odom_from_base: SE2) -> bool:
        """Whether a scan repeats an earlier one that was taken elsewhere, of a lidar that measured
        before. One without any echo, as of open floor, tells nothing.
        """
        ranges_m = scan.ranges_m
        if self._first is None or not np.array_equal(self._first[0], ranges_m, equal_nan=True):
            self._has_measured = self._first is not None
            self._first = ranges_m, odom_from_base
            return False
        if not self._has_measured or odom_from_base.is_near(self._first[1], _MOVED_M, _MOVED_RAD):
            return False
        return bool(((ranges_m >= scan.range_min_m) & (ranges_m < scan.range_max_m)).any())

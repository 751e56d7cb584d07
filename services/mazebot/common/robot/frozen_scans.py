"""Notices a lidar that shows the same turn again and again, with new stamps, while the robot moves.

A driver that has lost its device may do so. Scans without noise are alike to the last bit along a
straight wall too: one is frozen only where the robot's motion must have changed what it shows.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2
from mazebot.common.maths.kernels import kernel

if TYPE_CHECKING:
    from mazebot.common.messages.scan import Scan

FROZEN: Final = "repeated while the robot moves"
"""Why such a scan is left out."""
_MOVED_M, _MOVED_RAD = 0.03, 0.05
"""By odometry, since the scan came first: less may be noise of a robot that stands."""
_MISFIT_M, _MISFIT_SHARE = 0.06, 0.5
"""An echo that is off by more than this, and than this share of the way, is not where it was: more
than what rounded ranges and the drift of odometry make of a wall along the way.
"""
_LEAST_BEAMS: Final = 5
"""So many echoes have to be off."""
_LEAST_RAD: Final = 1e-6
"""Beams that are less apart are none of a lidar."""


class FrozenScans:
    """The newest scan that is not like the one before, and where the robot was."""

    def __init__(self) -> None:
        self.frozen_ns: int | None = None
        """Stamp of the newest scan, if it is frozen."""
        self._first: tuple[NDArray[np.float32], SE2] | None = None
        self._has_measured = False
        """Whether two scans differed: what never measured has not frozen."""

    def is_frozen(self, scan: Scan, odom_from_base: SE2) -> bool:
        """Whether a scan repeats an earlier one, of a lidar that measured before, that the robot's
        motion since must have changed. What is frozen stays so until a scan differs.
        """
        ranges_m = scan.ranges_m
        if self._first is None or not np.array_equal(self._first[0], ranges_m, equal_nan=True):
            self._has_measured = self._first is not None
            self._first, self.frozen_ns = (ranges_m, odom_from_base), None
            return False
        if self.frozen_ns is None and not (
            self._has_measured and _must_differ(scan, self._first[1], odom_from_base)
        ):
            return False
        self.frozen_ns = scan.stamp_ns
        return True


def compile_kernels() -> None:
    """Compile what the first scan that repeats one calls."""
    _beams_off(np.ones(360, np.float32), 0.0, 0.0175, 0.1, 3.5, 0.1, 0.0, 0.0, 0.06)


def _must_differ(scan: Scan, odom_from_before: SE2, odom_from_base: SE2) -> bool:
    """Whether a scan cannot look the same from where the robot was before."""
    if odom_from_base.is_near(odom_from_before, _MOVED_M, _MOVED_RAD):
        return False
    if not (scan.has_limits and scan.has_angles and abs(scan.angle_increment_rad) >= _LEAST_RAD):
        # The beams are not told apart, and who uses the scan leaves it out.
        return False
    mount = scan.base_from_scan
    x_m, y_m, turn_rad = (odom_from_before @ mount).inverse() @ (odom_from_base @ mount)
    off_m = max(_MISFIT_M, _MISFIT_SHARE * math.sqrt(x_m * x_m + y_m * y_m))
    off = _beams_off(
        np.array(scan.ranges_m, np.float32), float(scan.angle_min_rad),
        float(scan.angle_increment_rad), float(scan.range_min_m), float(scan.range_max_m),
        float(x_m), float(y_m), float(turn_rad), off_m,
    )  # fmt: skip
    return off >= _LEAST_BEAMS


@kernel()
def _beams_off(
    ranges_m: NDArray[np.float32],
    first_rad: float,
    step_rad: float,
    range_min_m: float,
    range_max_m: float,
    x_m: float,
    y_m: float,
    turn_rad: float,
    off_m: float,
) -> int:
    """How many echoes of a scan, seen from where the lidar was before, are nearer or farther by
    `off_m` than both beams beside them, which show the same ranges there. `x_m`, `y_m` and
    `turn_rad`: the lidar's motion since.
    """
    count, turn, off = ranges_m.size, max(round(2.0 * math.pi / abs(step_rad)), 1), 0
    for i in range(count):
        reach = ranges_m[i]
        if not range_min_m <= reach < range_max_m:
            continue
        a, b = portable_kernels.cos_sin(first_rad + step_rad * i + turn_rad)
        x, y = x_m + reach * a, y_m + reach * b
        low = math.floor((portable_kernels.atan2(y, x) - first_rad) / step_rad) % turn
        high = (low + 1) % turn
        if low >= count or high >= count:
            continue
        one, other = ranges_m[low], ranges_m[high]
        away = math.sqrt(x * x + y * y)
        # Beyond its limits a lidar shows nothing; of a beam that has not measured nothing is known.
        if not range_min_m <= away < range_max_m - off_m:
            continue
        if not (one >= range_min_m and other >= range_min_m):
            continue
        if away < min(one, other) - off_m or away > max(one, other) + off_m:
            off += 1
    return off

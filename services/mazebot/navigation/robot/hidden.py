"""What stands around the robot and its lidar does not show: low things and table tops that the
depth camera sees, and what the robot has touched.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.messages.scan import Scan
from mazebot.navigation.control.safety.collision_monitor import moved_points
from mazebot.navigation.costmap.footprint import Footprint
from mazebot.navigation.costmap.layered_costmap import LocalCostmap

_ORIGIN: Final = SE2(0.0, 0.0, 0.0)
_NONE: Final[Array] = np.empty((0, 2))
_SAME_M: Final = 0.08
"""An echo at most this far behind something shows it: noise of both sensors, and the lidar's beams
between which an edge lies.
"""
_BESIDE: Final = 2
"""Beams to either side that may show it as well."""
_BEHIND_RANGE_M: Final = 2.0
"""Farther away the rows of an image are too far apart on the top of a low thing."""
_BEHIND_STEP_M: Final = 0.025
"""Half a cell of the costmaps."""
_APART_M: Final = 0.01
"""Points nearer to one another than this are one."""


class HiddenThings:
    """Points on what the lidar does not show, in odom: the camera does not see what is near, so
    that they are kept until the camera has seen that nothing is there.
    """

    def __init__(self) -> None:
        self.low_m = _NONE
        """(n, 2) seen by the camera, within the local costmap."""
        self.touched_m = _NONE
        """(n, 2) where the robot could not go on."""

    @property
    def points_m(self) -> Array:
        """(n, 2) all of them."""
        if not len(self.touched_m):
            return self.low_m
        return np.concatenate([self.low_m, self.touched_m])

    def see(self, points_m: Array, local: LocalCostmap) -> None:
        """Add (n, 2) points in odom that the camera sees, and forget those whose cells in the local
        costmap it has seen free.
        """
        points_m = np.concatenate([points_m, self.low_m])
        if not len(points_m):
            return
        points_m = points_m[local.shows_low(points_m)]
        places = np.floor(points_m / _APART_M).astype(np.int64)
        # The first ones are the newest.
        _, kept = np.unique(places[:, 0] * (1 << 32) + places[:, 1], return_index=True)
        self.low_m = np.ascontiguousarray(points_m[np.sort(kept)])

    def touch(self, points_m: Array) -> None:
        """Remember (n, 2) points in odom where something is."""
        self.touched_m = np.concatenate([self.touched_m, points_m])

    def cross(self, odom_from_base: SE2, footprint: Footprint) -> None:
        """Forget where the robot could not go on and stands now."""
        if len(self.touched_m):
            at_m = moved_points(self.touched_m, _ORIGIN, odom_from_base)
            outline_m = footprint.points_m
            inside = (at_m > outline_m.min(axis=0)) & (at_m < outline_m.max(axis=0))
            self.touched_m = self.touched_m[~inside.all(axis=1)]

    def forget_touched(self) -> None:
        """Forget where the robot could not go on."""
        self.touched_m = _NONE

    def from_base(self, odom_from_base: SE2) -> Array:
        """(n, 2) all of them in base_footprint."""
        points_m = self.points_m
        return moved_points(points_m, _ORIGIN, odom_from_base) if len(points_m) else points_m

    def move(self, odom_from_before: SE2) -> None:
        """Move all along with a correction of odometry."""
        self.low_m, self.touched_m = (
            moved_points(points_m, odom_from_before, _ORIGIN)
            for points_m in (self.low_m, self.touched_m)
        )

    def clear(self) -> None:
        """Forget all."""
        self.low_m = self.touched_m = _NONE


def depth_points(scan: Scan) -> tuple[Array, NDArray[np.bool_]]:
    """(n, 2) ends of all beams in base_footprint, and which of them are echoes."""
    ranges_m = np.asarray(scan.ranges_m, np.float64)
    echo = np.isfinite(ranges_m) & (ranges_m >= scan.range_min_m) & (ranges_m < scan.range_max_m)
    origin_m = np.array([scan.base_from_scan.x_m, scan.base_from_scan.y_m])
    return origin_m + np.where(echo, ranges_m, 0.0)[:, None] * scan.directions(), echo


def points_behind(scan: Scan, reaches_m: NDArray[np.float32], marks: NDArray[np.bool_]) -> Array:
    """(m, 2) points in base_footprint on what is seen behind the ends of beams.

    Args:
        scan: of a depth image.
        reaches_m: (n,) how far the thing at each beam's range reaches behind it; none: not known.
        marks: (n,) beams of which points are wanted.
    """
    if len(reaches_m) != len(marks):
        return _NONE
    chosen = marks & (reaches_m > 0.0) & (scan.ranges_m < _BEHIND_RANGE_M)
    from_m = np.asarray(scan.ranges_m[chosen], np.float64)
    reach_m = np.minimum(reaches_m[chosen], _BEHIND_RANGE_M - from_m)
    counts = np.ceil(reach_m / _BEHIND_STEP_M).astype(np.int64)
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    behind_m = np.minimum(number * _BEHIND_STEP_M, np.repeat(reach_m, counts))
    origin_m = np.array([scan.base_from_scan.x_m, scan.base_from_scan.y_m])
    directions = np.repeat(scan.directions()[chosen], counts, axis=0)
    points_m: Array = origin_m + (np.repeat(from_m, counts) + behind_m)[:, None] * directions
    return points_m


def hidden_from(
    points_m: Array, odom_from_base: SE2, scan: Scan | None, odom_from_scanning: SE2
) -> NDArray[np.bool_]:
    """(n,) which of some points, (n, 2) in base_footprint, a turn of the lidar looks past.

    Args:
        points_m: seen by another sensor.
        odom_from_base: the robot's pose then.
        scan: the lidar's; None: it has seen nothing.
        odom_from_scanning: the robot's pose at the scan.
    """
    if scan is None:
        return np.ones(len(points_m), np.bool_)
    odom_from_scan = odom_from_scanning @ scan.base_from_scan
    return _hidden(
        moved_points(points_m, odom_from_base, odom_from_scan),
        np.array(scan.ranges_m, np.float32), float(scan.angle_min_rad),
        float(scan.angle_increment_rad),
    )  # fmt: skip


@kernel()
def _hidden(
    points_m: Array, ranges_m: NDArray[np.float32], first_rad: float, increment_rad: float
) -> NDArray[np.bool_]:
    count, turn = ranges_m.size, round(2.0 * math.pi / abs(increment_rad))
    hidden = np.empty(len(points_m), np.bool_)
    for i in range(len(points_m)):
        x, y = points_m[i, 0], points_m[i, 1]
        middle = (portable_kernels.atan2(y, x) - first_rad) / increment_rad
        beam = math.floor(middle + 0.5)
        shown_m = math.sqrt(x * x + y * y) + _SAME_M
        hidden[i] = True
        for j in range(beam - _BESIDE, beam + _BESIDE + 1):
            if j % turn < count and 0.0 < ranges_m[j % turn] <= shown_m:
                hidden[i] = False
    return hidden

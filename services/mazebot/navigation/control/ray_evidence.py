"""What the rays of two scans tell of a thing between them: whether it has moved, or only another
part of it is seen.

The visible part of a thing that stands shrinks and grows behind a corner as the robot drives, and
its middle with it. What moves is where a ray went on before, or leaves a place where a ray now
goes on; a hidden place, which no ray reaches, proves neither.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.messages.scan import Scan

_MARGIN_M: Final = 0.06
"""A ray has to go on beside a place and behind it by this much: the error of the pose between two
scans, and of an echo."""
_SHARE: Final = 0.25
"""Of the echoes of a thing, so many have to say that it has moved, and at least"""
_LEAST: Final = 2
_GAP_M: Final = 0.1
"""A neighbouring echo that is farther than the thing by this much leaves its edge in sight."""
_NEIGHBOURS_RAD: Final = 0.06
"""Echoes farther apart than this are no neighbours: nothing was between them."""


class Rays(NamedTuple):
    """A scan, and where it was taken."""

    stamp_s: float
    map_from_scan: SE2
    scan: Scan


class RayMemory:
    """The scans of the last seconds."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._rays: deque[Rays] = deque()

    def clear(self) -> None:
        """Forget all of them."""
        self._rays.clear()

    def take(self, rays: Rays) -> None:
        """Keep a scan."""
        self._rays.append(rays)
        while self._rays[0].stamp_s < rays.stamp_s - self._seconds:
            self._rays.popleft()

    def has_moved(self, before_s: float, before_m: Array, now_m: Array) -> bool:
        """Whether a thing has moved between an earlier scan and the newest one.

        Args:
            before_s: time of the earlier scan.
            before_m: (n, 2) the thing's echoes in it, in the map.
            now_m: (m, 2) its echoes in the newest scan.
        """
        before = next((one for one in self._rays if one.stamp_s == before_s), None)
        if before is None:
            return False
        return _most_passed(before, now_m) or _most_passed(self._rays[-1], before_m)


def _most_passed(rays: Rays, points_m: Array) -> bool:
    """Whether the rays of a scan passed through enough of some places."""
    x_m, y_m, yaw_rad = rays.map_from_scan
    scan = rays.scan
    passed = _passed(
        np.array(scan.ranges_m, np.float32), float(scan.angle_min_rad + yaw_rad),
        float(scan.angle_increment_rad), float(scan.range_min_m), float(x_m), float(y_m),
        np.ascontiguousarray(points_m, np.float64), _MARGIN_M,
    )  # fmt: skip
    return passed >= max(_LEAST, _SHARE * len(points_m))


@kernel(error_model="numpy")
def _passed(
    ranges_m: NDArray[np.float32],
    first_angle_rad: float,
    increment_rad: float,
    range_min_m: float,
    x_m: float,
    y_m: float,
    points_m: Array,
    margin_m: float,
) -> int:
    """How many of the points all rays within a margin beside them went on behind."""
    count, found = ranges_m.size, 0
    turn = round(math.tau / abs(increment_rad))
    for i in range(len(points_m)):
        dx, dy = points_m[i, 0] - x_m, points_m[i, 1] - y_m
        away_m = math.sqrt(dx * dx + dy * dy)
        if away_m <= margin_m:
            continue
        at = (portable_kernels.atan2(dy, dx) - first_angle_rad) / increment_rad
        reach = max(margin_m / away_m / abs(increment_rad), 1.0)
        passes = True
        for k in range(math.ceil(at - reach), math.floor(at + reach) + 1):
            ray = k % turn
            # No measurement is no ray, one without an echo goes on for ever.
            if ray >= count or not ranges_m[ray] >= max(range_min_m, away_m + margin_m):
                passes = False
                break
        found += passes
    return found


@kernel()
def edges_in_sight(
    points_m: Array, labels: NDArray[np.int64], label: int, x_m: float, y_m: float
) -> bool:
    """Whether nothing hides an edge of a cluster, or touches it, seen from a place.

    Args:
        points_m: (n, 2) all echoes, in the order of a turn.
        labels: (n,) the cluster of each.
        label: the cluster.
        x_m: of the lidar.
        y_m: of the lidar.
    """
    count = len(points_m)
    for i in range(count):
        if labels[i] != label:
            continue
        dx, dy = points_m[i, 0] - x_m, points_m[i, 1] - y_m
        away_m = math.sqrt(dx * dx + dy * dy)
        for step in (-1, 1):
            j = (i + step) % count
            if labels[j] == label:
                continue
            ex, ey = points_m[j, 0] - x_m, points_m[j, 1] - y_m
            other_m = math.sqrt(ex * ex + ey * ey)
            if other_m > away_m + _GAP_M:
                continue
            # The sine of the angle between the two, of which the cosine is positive.
            across = abs(dx * ey - dy * ex)
            if dx * ex + dy * ey > 0.0 and across < _NEIGHBOURS_RAD * away_m * other_m:
                return False
    return True

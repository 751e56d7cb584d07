"""What moves, seen without a map and without a pose in it: echoes where a moment ago a beam went
through.
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
from mazebot.navigation.control.safety.collision_monitor import moved_points
from mazebot.navigation.control.track import Track
from mazebot.navigation.control.tracking import ObstacleTracker, TrackerParams
from mazebot.navigation.costmap.costmap import GridFrame
from mazebot.navigation.costmap.layered_costmap import scan_points

_AGO_S = 0.55
"""What was free this long ago is compared with what is there now."""
_BINS: Final = 360
_FREE_M: Final = 0.08
"""A beam passed if it went farther than the place by this."""
_REACH_M: Final = 2.5
_NOWHERE = SE2(0.0, 0.0, 0.0)
_FRAME = GridFrame(1e4, -5e3, -5e3, 1, 1)
_NO_WALLS = np.full((1, 1), 10.0, np.float32)


class _Seen(NamedTuple):
    stamp_ns: int
    odom_from_scan: SE2
    free_m: Array
    """(_BINS,) how far the beams of each direction went"""


class Newcomers:
    """Tracks what comes into places that were free, in the frame of the odometry."""

    def __init__(self, params: TrackerParams) -> None:
        self._tracker = ObstacleTracker(params)
        self._seen: deque[_Seen] = deque()

    def clear(self) -> None:
        """Forget all."""
        self._tracker.clear()
        self._seen.clear()

    def take_scan(self, scan: Scan, odom_from_base: SE2) -> None:
        """Take a scan, with the odometry at its time."""
        odom_from_scan = odom_from_base @ scan.base_from_scan
        points_m = moved_points(
            np.asarray(scan_points(scan), np.float64).reshape(-1, 2), odom_from_base, _NOWHERE
        )
        before = None
        while self._seen and scan.stamp_ns - self._seen[0].stamp_ns >= _AGO_S * 1e9:
            before = self._seen.popleft()
        if before is not None:
            then_m = moved_points(points_m, _NOWHERE, before.odom_from_scan)
            new = _was_free(then_m, before.free_m)
            self._tracker.update(scan.stamp_ns * 1e-9, points_m[new], _NO_WALLS, _FRAME)
        here_m = moved_points(points_m, _NOWHERE, odom_from_scan)
        self._seen.append(_Seen(scan.stamp_ns, odom_from_scan, _free_m(here_m)))

    def moving(self, now_s: float) -> tuple[Track, ...]:
        """What moves at a time, in the frame of the odometry."""
        return self._tracker.moving(now_s)


@kernel()
def _free_m(points_m: Array) -> Array:
    free_m = np.full(_BINS, _REACH_M)
    for i in range(len(points_m)):
        x, y = points_m[i, 0], points_m[i, 1]
        angle = portable_kernels.atan2(y, x)
        index = math.floor(angle / (2.0 * math.pi) * _BINS) % _BINS
        free_m[index] = min(free_m[index], math.sqrt(x * x + y * y))
    return free_m


@kernel()
def _was_free(points_m: Array, free_m: Array) -> NDArray[np.bool_]:
    """(n,) whether all beams near the direction of each of (n, 2) points went past it."""
    new = np.zeros(len(points_m), np.bool_)
    for i in range(len(points_m)):
        x, y = points_m[i, 0], points_m[i, 1]
        needed_m = math.sqrt(x * x + y * y) + _FREE_M
        angle = portable_kernels.atan2(y, x)
        index = math.floor(angle / (2.0 * math.pi) * _BINS)
        passed = True
        for beside in range(-3, 4):
            if free_m[(index + beside) % _BINS] < needed_m:
                passed = False
        new[i] = passed
    return new

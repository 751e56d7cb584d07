"""The space around the robot by one scan: where beams hit, and how far the others saw."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.messages.scan import Scan

_FAR_M = 1e3
"""No lidar has a longer range, whatever its message states."""
_LEAST_OPEN_RAD = 0.08
"""Beams without a return count as open space only beside others like them: a single one was lost
on glass or on something black, and would clear what is behind a wall.
"""

_REACH_SHARE = 0.9
_MOST_JOINED, _JOINED_SPACING_M = 400, 0.03


@dataclass(frozen=True)
class ScanPoints:
    """A scan in the base's frame, whole millimetres: what a saved graph keeps is all there was."""

    points_m: Array
    """(n, 2) where beams ended at an obstacle, counter-clockwise."""
    misses_m: Array
    """(m, 2) how far beams without a return saw free space."""
    sensor: SE2
    """base_from_scan"""

    @cached_property
    def reach_m(self) -> float:
        """How far the lidar saw obstacles here, the farthest tenth left out; 0 where it saw none.

        A robot this far away still sees part of what is seen from here.
        """
        if not len(self.points_m):
            return 0.0
        away_m = portable.hypot_each(
            self.points_m[:, 0] - self.sensor.x_m, self.points_m[:, 1] - self.sensor.y_m
        )
        return float(np.sort(away_m)[int(_REACH_SHARE * (len(away_m) - 1))])


def scan_points(scan: Scan, max_range_m: float) -> ScanPoints:
    """The points of a scan.

    Ranges in [range_min, range_max) are returns, up to `max_range_m`; farther ones show only
    that it is free up to there. The same holds for ranges of `range_max` and more, infinite ones
    included, but at least `_LEAST_OPEN_RAD` of them in a row. Others, below `range_min`, 0
    and NaN, are ignored, as in REP 117; drivers write 0 for no return, and a `range_min` of 0.
    """
    base_from_scan = scan.base_from_scan
    distances_m = np.asarray(scan.ranges_m, np.float64).reshape(-1)
    limit_m = min(scan.range_max_m, _FAR_M)
    reach_m = min(limit_m, max_range_m)
    in_range = (distances_m >= scan.range_min_m) & (distances_m > 0.0) & (distances_m < limit_m)
    returned = in_range & (distances_m < reach_m)
    misses = distances_m >= limit_m
    if misses.any():
        least = max(1, round(_LEAST_OPEN_RAD / max(abs(scan.angle_increment_rad), 1e-6)))
        closed = abs(len(distances_m) * scan.angle_increment_rad) > 6.2
        misses = _in_rows(misses, least, closed)
    open_beams = misses | (in_range & ~returned)
    directions = scan.directions()
    origin_m = np.array([base_from_scan.x_m, base_from_scan.y_m])
    points_m = origin_m + distances_m[returned, None] * directions[returned]
    misses_m = origin_m + reach_m * directions[open_beams]
    return ScanPoints(_millimetres(points_m), _millimetres(misses_m), base_from_scan)


def _millimetres(points_m: Array) -> Array:
    return np.ascontiguousarray(np.rint(points_m * 1e3) / 1e3)


def _in_rows(flags: NDArray[np.bool_], least: int, closed: bool) -> NDArray[np.bool_]:
    """Those flags that are set in rows of at least this many; `closed`: the last one is beside the
    first.
    """
    count = len(flags)
    if flags.all():
        return flags
    start = int(np.argmin(flags)) if closed else 0
    turned = np.roll(flags, -start)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], turned.astype(np.int8), [0]])))
    kept = np.zeros(count, np.bool_)
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if end - first >= least:
            kept[first:end] = True
    return np.roll(kept, start)


def thinned(points_m: Array, spacing_m: float, most: int) -> Array:
    """Points, (n, 2) or clouds with x and y first, in their order, each at least `spacing_m` from
    the last one kept, evenly thinned to `most`: a near wall, on which many beams end, must not
    outweigh the others.
    """
    kept = points_m[_spaced(np.ascontiguousarray(points_m), spacing_m)]
    if len(kept) > most:
        kept = kept[np.arange(most) * len(kept) // most]
    return np.ascontiguousarray(kept)


def moved(points_m: Array, pose: SE2) -> Array:
    """(n, 2) points of a frame whose pose is given, in the frame of that pose."""
    c, s = portable.cos_sin(pose.yaw_rad)
    x, y = points_m[:, 0], points_m[:, 1]
    return np.ascontiguousarray(
        np.stack([c * x - s * y + pose.x_m, s * x + c * y + pose.y_m], axis=1)
    )


@kernel("boolean[::1](float64[:, ::1], float64)")
def _spaced(points: Array, spacing: float) -> NDArray[np.bool_]:
    kept = np.zeros(points.shape[0], np.bool_)
    last = -1
    for i in range(points.shape[0]):
        if last >= 0:
            dx, dy = points[i, 0] - points[last, 0], points[i, 1] - points[last, 1]
            if dx * dx + dy * dy < spacing * spacing:
                continue
        kept[i] = True
        last = i
    return kept


def surface_cloud(returns: Array, sensor: SE2) -> Array:
    """(n, 6) of returns (n, 2) in the order of their beams, in the frame of `sensor`'s pose: x, y,
    the unit normal of the surface towards the lidar and 1, or where the beams beside show no
    surface, the direction to the lidar and 0; and 1, the number of returns.
    """
    cloud = np.ones((len(returns), 6))
    _find_surfaces(np.ascontiguousarray(returns), sensor.x_m, sensor.y_m, cloud)
    return cloud


def moved_cloud(cloud: Array, pose: SE2) -> Array:
    """A cloud of a frame whose pose is given, in the frame of that pose."""
    c, s = portable.cos_sin(pose.yaw_rad)
    turned = cloud.copy()
    turned[:, :2] = moved(cloud[:, :2], pose)
    turned[:, 2] = c * cloud[:, 2] - s * cloud[:, 3]
    turned[:, 3] = s * cloud[:, 2] + c * cloud[:, 3]
    return turned


def joined_cloud(poses: Sequence[SE2], clouds: Sequence[Array], here: SE2) -> Array:
    """(n, 6) clouds seen from poses, in the frame of the pose `here`, thinned."""
    from_frame = here.inverse()
    parts = [
        thinned(moved_cloud(cloud, from_frame @ pose), _JOINED_SPACING_M, _MOST_JOINED)
        for pose, cloud in zip(poses, clouds, strict=True)
    ]
    joined = np.concatenate(parts)
    if len(joined) > _MOST_JOINED:
        joined = joined[np.arange(_MOST_JOINED) * len(joined) // _MOST_JOINED]
    return np.ascontiguousarray(joined)


_BESIDE = 3
"""Beams to each side that show the surface."""
_GAP_M, _GAP_SHARE = 0.1, 0.06
"""Neighbours farther apart than this and this share of the range are on different surfaces."""
_REACH_M = 0.1
"""No more beams are needed beyond this."""
_ROUGH_SHARE = 0.05
_ROUGH_M2 = 0.0009


@kernel("void(float64[:, ::1], float64, float64, float64[:, ::1])")
def _find_surfaces(points: Array, sensor_x: float, sensor_y: float, cloud: Array) -> None:
    n = points.shape[0]
    for i in range(n):
        x, y = points[i, 0], points[i, 1]
        vx, vy = sensor_x - x, sensor_y - y
        away = math.sqrt(vx * vx + vy * vy) + 1e-9
        gap = _GAP_M + _GAP_SHARE * away
        count = 1.0
        mx = my = xx = xy = yy = 0.0
        for side in (-1, 1):
            last_x, last_y = x, y
            for k in range(1, 4 * _BESIDE + 1):
                j = i + side * k
                if j < 0 or j >= n:
                    break
                gx, gy = points[j, 0] - last_x, points[j, 1] - last_y
                dx, dy = points[j, 0] - x, points[j, 1] - y
                reached = dx * dx + dy * dy > _REACH_M * _REACH_M
                if gx * gx + gy * gy > gap * gap or (k > _BESIDE and reached):
                    break
                last_x, last_y = points[j, 0], points[j, 1]
                count += 1.0
                mx += dx
                my += dy
                xx += dx * dx
                xy += dx * dy
                yy += dy * dy
        cloud[i, 0], cloud[i, 1] = x, y
        cloud[i, 2], cloud[i, 3] = vx / away, vy / away
        cloud[i, 4] = 0.0
        if count < 3.0:
            continue
        mx, my = mx / count, my / count
        xx, xy, yy = xx / count - mx * mx, xy / count - mx * my, yy / count - my * my
        half, differ = 0.5 * (xx + yy), 0.5 * (xx - yy)
        root = math.sqrt(differ * differ + xy * xy)
        small, large = half - root, half + root
        if small > _ROUGH_SHARE * large or small > _ROUGH_M2:
            continue
        tx, ty = xy, root - differ
        if differ >= 0.0:
            tx, ty = root + differ, xy
        length = math.sqrt(tx * tx + ty * ty)
        if length < 1e-9:
            continue
        nx, ny = -ty / length, tx / length
        if nx * vx + ny * vy < 0.0:
            nx, ny = -nx, -ny
        cloud[i, 2], cloud[i, 3], cloud[i, 4] = nx, ny, 1.0

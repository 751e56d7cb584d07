"""Gaps ahead on the path that the lidar measures as too narrow for the robot.

The cells of a costmap are coarser than what decides whether the robot fits, and echoes beside a
wall of the map mark nothing. A gap is measured between the echoes on both sides of the path
instead, before the robot is in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.costmap.footprint import Footprint, distance_at
from mazebot.navigation.costmap.layered_costmap import LayeredCostmap
from mazebot.navigation.planning.path import PlannedPath
from mazebot.navigation.robot.view import View

_PERIOD_NS: Final = 95_000_000
_NEAREST_M: Final = 0.25
_FARTHEST_M: Final = 1.0
"""Gaps this far ahead are measured; nearer, the robot is in it already."""
_SPACING_M: Final = 0.05
_UNMARKED_M: Final = 0.15
"""So much nearer than the costmap says something may be: see `static_margin`."""
_SLAB_M: Final = 0.12
"""Echoes this far along the path are of one gap."""
_SAME_M: Final = 0.2
"""Measurements this near to each other are of one gap."""
_READINGS: Final = 5
_LEAST_M: Final = 0.12
"""What is narrower is shut: echoes of one surface are farther apart than 5 cm where it is seen at
an angle."""
_LOOKED_AT_M: Final = 3.0
_AROUND_M: Final = 0.3
_ASIDE_M: Final = 0.6
_RAY_RAD: Final = math.tau / 360
_SEEN_M: Final = 0.08
_GONE_M: Final = 0.2
"""Where a side of a gap was, an echo is this near, or has gone this far."""
_MOVES_NEAR_M: Final = 0.8
"""A gap this near to something that moves is not measured."""


@dataclass
class Gap:
    """A gap between two echoes."""

    a_m: tuple[float, float]
    b_m: tuple[float, float]
    widths_m: list[float] = field(default_factory=list)
    """The last measurements."""
    closed: bool = False
    width_m: float = math.inf
    """As it was measured when it was closed."""

    @property
    def middle_m(self) -> tuple[float, float]:
        """Its middle, in the map."""
        return (self.a_m[0] + self.b_m[0]) / 2.0, (self.a_m[1] + self.b_m[1]) / 2.0

    @property
    def median_m(self) -> float:
        """The median of the last measurements."""
        return sorted(self.widths_m)[len(self.widths_m) // 2]


class NarrowGaps:
    """Measures gaps, and closes those in the costmap that are too narrow."""

    def __init__(self, costmap: LayeredCostmap, footprint: Footprint) -> None:
        self._costmap = costmap
        self.needs_m = 2.0 * footprint.half_width_m
        """Width that the robot needs."""
        self._gaps: list[Gap] = []
        self._looked_ns = 0

    def forget(self) -> None:
        """Open all gaps again."""
        for gap in self._gaps:
            if gap.closed:
                self._costmap.open_gap(gap.a_m, gap.b_m)
        self._gaps = []

    def look(self, view: View, path: PlannedPath | None) -> None:
        """Measure what is ahead on a path, and close it where it is too narrow."""
        pose = view.map_from_base
        if pose is None or 0 <= view.now_ns - self._looked_ns < _PERIOD_NS:
            return
        self._looked_ns = view.now_ns
        for gap in [one for one in self._gaps if one.closed]:
            self._look_again(gap, pose, view.echoes_m)
        if path is not None:
            along_m = float(path.along_m[path.nearest(pose.x_m, pose.y_m, 0, math.inf)])
            stretch = along_m + _NEAREST_M, along_m + _FARTHEST_M
            self._measure(view, pose, path, stretch, self.needs_m / 2.0 + _UNMARKED_M)

    def look_at(self, view: View, path: PlannedPath, place_m: tuple[float, float]) -> None:
        """Measure a place on a path, at which there seems to be no way."""
        pose = view.map_from_base
        if pose is None or math.dist(place_m, pose[:2]) > _LOOKED_AT_M:
            return
        along_m = float(path.along_m[path.nearest(*place_m, 0, math.inf)])
        self._measure(view, pose, path, (along_m - _AROUND_M, along_m + _AROUND_M), math.inf)

    def _measure(
        self, view: View, pose: SE2, path: PlannedPath, stretch_m: tuple[float, float],
        reach_m: float,
    ) -> None:  # fmt: skip
        costmap = self._costmap.master
        found = _narrowest(
            costmap.distance_m, costmap.frame.resolution_m, costmap.frame.origin_x_m,
            costmap.frame.origin_y_m, path.points_m, path.along_m, *stretch_m, reach_m,
            np.ascontiguousarray(view.echoes_m), float(pose.x_m), float(pose.y_m),
            *portable.cos_sin(pose.yaw_rad),
        ).tolist()  # fmt: skip
        gap = Gap((found[1], found[2]), (found[3], found[4]))
        # Of each side, the edge is as far behind the last echo as half the way to the next ray.
        width_m = found[0] - math.dist(gap.middle_m, pose[:2]) * _RAY_RAD
        if not _LEAST_M <= width_m < math.inf:
            return
        near = (*view.tracks, *view.turning)
        if any(math.dist((one.x_m, one.y_m), gap.middle_m) < _MOVES_NEAR_M for one in near):
            return
        known = (one for one in self._gaps if math.dist(one.middle_m, gap.middle_m) < _SAME_M)
        same = next(known, None)
        if same is None:
            self._gaps = [*(one for one in self._gaps if one.closed), gap]
            same = gap
        if same.closed:
            return
        same.a_m, same.b_m = gap.a_m, gap.b_m
        same.widths_m = [*same.widths_m[1 - _READINGS :], width_m]
        if len(same.widths_m) < _READINGS or same.median_m >= self.needs_m:
            return
        same.closed, same.width_m = True, same.median_m
        same.widths_m = []
        self._costmap.close_gap(same.a_m, same.b_m)

    def _look_again(self, gap: Gap, pose: SE2, echoes_m: Array) -> None:
        """Open a gap of which one side is seen to have gone."""
        if math.dist(gap.middle_m, pose[:2]) > 1.5 * _FARTHEST_M or not len(echoes_m):
            return
        base_from_map = pose.inverse()
        sides = [base_from_map @ SE2(*end, 0.0) for end in (gap.a_m, gap.b_m)]
        apart = [float(np.abs(echoes_m - np.array(side[:2])).max(axis=1).min()) for side in sides]
        gone = min(apart) < _SEEN_M and max(apart) > _GONE_M
        gap.widths_m = [*gap.widths_m[1 - _READINGS :], math.inf if gone else 0.0]
        if gap.median_m > self.needs_m:
            self._costmap.open_gap(gap.a_m, gap.b_m)
            self._gaps.remove(gap)

    def closed_near(self, place_m: tuple[float, float]) -> Gap | None:
        """The closed gap nearest to a place, within 0.6 m."""
        gaps = [one for one in self._gaps if one.closed]
        best = min(gaps, key=lambda one: math.dist(one.middle_m, place_m), default=None)
        return best if best is not None and math.dist(best.middle_m, place_m) < 0.6 else None


@kernel()
def _narrowest(
    distance_m: Clearance,
    resolution_m: float,
    origin_x_m: float,
    origin_y_m: float,
    points_m: Array,
    along_m: Array,
    begin_m: float,
    end_m: float,
    reach_m: float,
    echoes_m: Array,
    x_m: float,
    y_m: float,
    cos_yaw: float,
    sin_yaw: float,
) -> Array:
    """Width of the narrowest gap ahead on a path, and the x and y of its two sides in the map;
    infinite where there is none.

    Args:
        distance_m: of the costmap.
        resolution_m: of the costmap.
        origin_x_m: of the costmap.
        origin_y_m: of the costmap.
        points_m: (n, 2) of the path.
        along_m: (n,) of the path.
        begin_m: of the path, from here on.
        end_m: of the path, up to here.
        reach_m: only where the costmap has something nearer than this.
        echoes_m: (k, 2) in the base frame.
        x_m: the robot's pose.
        y_m: the robot's pose.
        cos_yaw: the robot's pose.
        sin_yaw: the robot's pose.
    """
    found = np.full(5, np.inf)
    left, right = np.empty(len(echoes_m), np.int64), np.empty(len(echoes_m), np.int64)
    after_m = begin_m
    for i in range(len(points_m) - 1):
        if along_m[i] > end_m:
            break
        if along_m[i] < after_m:
            continue
        after_m = along_m[i] + _SPACING_M
        column = (points_m[i, 0] - origin_x_m) / resolution_m
        row = (points_m[i, 1] - origin_y_m) / resolution_m
        if distance_at(distance_m, column, row) > reach_m:
            continue
        ux, uy = points_m[i + 1, 0] - points_m[i, 0], points_m[i + 1, 1] - points_m[i, 1]
        step = math.sqrt(ux * ux + uy * uy)
        if step < 1e-6:
            continue
        ux, uy = ux / step, uy / step
        lefts, rights = 0, 0
        for k in range(len(echoes_m)):
            dx = x_m + cos_yaw * echoes_m[k, 0] - sin_yaw * echoes_m[k, 1] - points_m[i, 0]
            dy = y_m + sin_yaw * echoes_m[k, 0] + cos_yaw * echoes_m[k, 1] - points_m[i, 1]
            ahead, aside = dx * ux + dy * uy, dy * ux - dx * uy
            if abs(ahead) > _SLAB_M or abs(aside) > _ASIDE_M:
                continue
            if aside > 0.0:
                left[lefts] = k
                lefts += 1
            else:
                right[rights] = k
                rights += 1
        for a in range(lefts):
            for b in range(rights):
                p, q = echoes_m[left[a]], echoes_m[right[b]]
                ex, ey = p[0] - q[0], p[1] - q[1]
                wide = math.sqrt(ex * ex + ey * ey)
                if wide < found[0]:
                    found[0] = wide
                    found[1] = x_m + cos_yaw * p[0] - sin_yaw * p[1]
                    found[2] = y_m + sin_yaw * p[0] + cos_yaw * p[1]
                    found[3] = x_m + cos_yaw * q[0] - sin_yaw * q[1]
                    found[4] = y_m + sin_yaw * q[0] + cos_yaw * q[1]
    return found

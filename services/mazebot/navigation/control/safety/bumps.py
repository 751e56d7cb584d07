"""Whether the lidar sees what has stopped the robot: it bumped into something, or something into
it. Then nothing hidden is there.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mazebot.common.maths.frames import Array
from mazebot.navigation.costmap.footprint import Footprint

_COMES_M: Final = 0.3
"""What moves this near to the outline may bump into the robot."""
_AT_M: Final = 0.1
"""A thing that bumped into the robot is seen this near to the outline, before it is gone again."""
_AGO_NS: Final = 2_000_000_000
"""A bump stops the robot, and is noticed, so long after it at most."""
_TOUCHES_M: Final = 0.06
"""What stands no farther than this from the side that touches something is what it touches."""
_FEWEST: Final = 3
"""Fewer echoes are noise."""


class Bumps:
    """What the lidar sees at the robot's outline, and has seen lately."""

    def __init__(self, footprint: Footprint) -> None:
        self._footprint = footprint
        self._echoes_m: Array = np.empty((0, 2))
        self._at_ns: int | None = None
        self._came_ns: int | None = None

    def take(self, now_ns: int, echoes_m: Array, moving: Array) -> None:
        """Take the lidar's newest echoes, (n, 2), and discs that move, (m, 3 or more) x, y and
        radius; all in base_footprint.
        """
        self._echoes_m = echoes_m
        if (self._distances_m(echoes_m) <= _AT_M).sum() >= _FEWEST:
            self._at_ns = now_ns
        if len(moving) and (self._distances_m(moving[:, :2]) - moving[:, 2] <= _COMES_M).any():
            self._came_ns = now_ns

    def explain(self, since_ns: int, sign: float) -> bool:
        """Whether what has stopped the robot at a time is seen.

        Args:
            since_ns: when it was noticed.
            sign: 1 where the robot drove ahead, -1 where it drove back.
        """
        came, at = self._came_ns, self._at_ns
        oldest_ns = since_ns - _AGO_NS
        if came is not None and at is not None and min(came, at) >= oldest_ns:
            return True
        side_m = float((sign * self._footprint.points_m[:, 0]).max())
        ahead_m, aside_m = sign * self._echoes_m[:, 0] - side_m, np.abs(self._echoes_m[:, 1])
        touched = (np.abs(ahead_m) <= _TOUCHES_M) & (aside_m <= self._footprint.half_width_m)
        return int(touched.sum()) >= _FEWEST

    def _distances_m(self, places_m: Array) -> Array:
        """(n,) distances of places from the box around the outline."""
        polygon_m = self._footprint.points_m
        off_m = np.maximum(polygon_m.min(axis=0) - places_m, places_m - polygon_m.max(axis=0))
        outside_m = off_m.clip(min=0.0)
        return np.asarray(np.sqrt((outside_m * outside_m).sum(axis=1)))

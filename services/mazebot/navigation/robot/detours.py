"""Ways that were found blocked on the way to a goal: what stood there is not forgotten unseen, and
a robot that turns back to the same place again and again is told to stop that.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.navigation.costmap.layered_costmap import LayeredCostmap
from mazebot.navigation.planning.path import PlannedPath

_LOG = logging.getLogger("navigation")

_APART_M: Final = 0.6
"""A path that stays this far from where the last one is blocked is another way."""
_HELD_M: Final = 0.9
"""So far around it, what is marked is held."""
_DETOUR_M: Final = 0.5
"""A way round that is longer by less is none."""
_MOST_RETURNS: Final = 2
"""A place that was found blocked more often than this is left alone until the goal is reached."""


@dataclass
class _Blocked:
    """A place of a way that was given up for another one."""

    x_m: float
    y_m: float
    times: int = 1


class Detours:
    """The places at which ways to the present goal were blocked."""

    def __init__(self, costmap: LayeredCostmap) -> None:
        self._costmap = costmap
        self._goal: SE2 | None = None
        self._blocked: list[_Blocked] = []

    @property
    def count(self) -> int:
        """How often a way was given up for another one."""
        return sum(one.times for one in self._blocked)

    def begin(self, goal: SE2) -> None:
        """Plan to a goal: another one than before forgets all places."""
        if goal != self._goal:
            self.forget()
            self._goal = goal

    def forget(self) -> bool:
        """Hold nothing any more; whether anything was held."""
        held = bool(self._blocked)
        if held:
            self._blocked = []
            self._costmap.release()
        return held

    def note(self, left_m: float, hit: SE2, path: PlannedPath) -> None:
        """Note that a path is blocked, and another one followed instead.

        Args:
            left_m: length that was left of the path that is blocked.
            hit: where the robot would collide on it.
            path: the new one.
        """
        if path.length_m < left_m + _DETOUR_M or _nearest_m(path.points_m, hit) < _APART_M:
            return
        known = (one for one in self._blocked
                 if math.dist((one.x_m, one.y_m), hit[:2]) < _HELD_M)  # fmt: skip
        place = next(known, None)
        if place is None:
            place = _Blocked(hit.x_m, hit.y_m)
            self._blocked.append(place)
        else:
            place.times += 1
        pinned = place.times > _MOST_RETURNS
        self._costmap.hold(place.x_m, place.y_m, _HELD_M, pinned)
        if pinned:
            _LOG.warning(
                "The way at (%.2f, %.2f) was found blocked %d times: going another way until the "
                "goal is reached", place.x_m, place.y_m, place.times,
            )  # fmt: skip
        else:
            _LOG.info(
                "The way is blocked at (%.2f, %.2f): going another way, %.1f m longer",
                place.x_m, place.y_m, path.length_m - left_m,
            )  # fmt: skip


def _nearest_m(points_m: Array, place: SE2) -> float:
    return float(portable.hypot_each(*(points_m - np.array(place[:2])).T).min())

"""What the robot does where it could not go on: it stops, and drives back. Once it can do that,
something is where it was; a robot that does not come back either obeys nobody.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths.frames import SE2, Array
from mazebot.navigation.control.collision import STOP, Velocity, stands
from mazebot.navigation.costmap.footprint import Footprint

_OBEYS_M: Final = 0.03
"""Whoever drives back so far obeys."""
_STOPS_S: Final = 1.0
"""After so long it counts as standing."""
_BEFORE_M: Final = 0.03
"""The thing is marked this far from the outline: a cell that the robot covers is cleared."""
_SPACING_M: Final = 0.02
_LEAST_M_S: Final = 0.02
"""A slower command is no drive in a direction."""
_FREE_S: Final = 0.5
"""Time to a collision on the way back from which on it goes on."""


class BackOffParams(Params):
    """What happens where the robot cannot go on. Nav2 has nothing like it."""

    distance: float = Field(
        0.25, gt=0, le=2, description="m; the robot drives back by this where something stopped it"
    )
    speed: float = Field(0.12, gt=0, le=1, description="m/s; of that drive")
    assumed_width: float = Field(
        1.0,
        ge=0,
        le=5,
        description="m; how wide something is taken for that stopped the robot and no sensor "
        "shows, at most up to what is seen beside it",
    )


class BackOff:
    """One drive back after another."""

    def __init__(self, params: BackOffParams, footprint: Footprint) -> None:
        self._params = params
        self._footprint = footprint
        self.is_active = False
        """Whether its command is to be obeyed."""
        self._sign = 1.0
        """1 where something ahead stopped the robot, -1 behind."""
        self._since_ns = 0
        self._from: SE2 | None = None
        """Where the drive back began, in odom; None: it does not stand yet."""
        self._slips = False
        """Whether its wheels turned meanwhile."""
        self._proven = False
        """Whether it is clear that something stopped the robot."""

    def end(self) -> None:
        """Leave off."""
        self.is_active = False

    @property
    def sign(self) -> float:
        """1 where it could not go on ahead, -1 where it could not go back."""
        return self._sign

    def begin(self, now_ns: int, wanted: Velocity, slips: bool = False) -> bool:
        """Begin where a command could not be obeyed; False for one that only turns. `slips`: the
        wheels turned, and the robot did not move as they say.
        """
        if abs(wanted.linear_m_s) < _LEAST_M_S:
            return False
        self._sign, self._since_ns, self._from = math.copysign(1.0, wanted.linear_m_s), now_ns, None
        self.is_active, self._slips, self._proven = True, slips, False
        return True

    def step(
        self,
        now_ns: int,
        odom_from_base: SE2,
        measured: Velocity,
        time_to_collision: Callable[[Velocity], float],
    ) -> tuple[Velocity, SE2 | None]:
        """The command of this period, and once, as soon as it is clear that something stopped the
        robot, where it was then (odom_from_base).
        """
        if self._from is None:
            if not stands(measured) and now_ns - self._since_ns < _STOPS_S * 1e9:
                return STOP, None
            # From now on odometry holds again.
            self._from, self._since_ns = odom_from_base, now_ns
            return STOP, None
        back = Velocity(-self._sign * self._params.speed, 0.0)
        late = now_ns - self._since_ns > 2e9 * self._params.distance / self._params.speed
        driven_m = odom_from_base.distance_m(self._from)
        # Where it may not drive back, it cannot be tried. Wheels that slipped may do so because of
        # what is behind.
        barred = time_to_collision(back) <= _FREE_S
        proves = barred and not self._slips
        touched_at = None
        if not self._proven and (proves or driven_m >= min(_OBEYS_M, self._params.distance)):
            self._proven, touched_at = True, self._from
        if barred or late or driven_m >= self._params.distance:
            self.end()
            return STOP, touched_at
        return back, touched_at

    def touched_m(self, is_seen: Callable[[Array], bool]) -> Array:
        """(n, 2) places in base_footprint along the side that touches something, as wide as that is
        taken for.

        Args:
            is_seen: whether something is seen at a place, (2,) in base_footprint.
        """
        points_m = self._footprint.points_m
        x_m = float((self._sign * points_m[:, 0]).max()) + _BEFORE_M
        half_m, most_m = self._footprint.half_width_m, self._params.assumed_width / 2.0
        places = [(self._sign * x_m, 0.0)]
        for side in (1.0, -1.0):
            for number in range(1, math.ceil(max(half_m, most_m) / _SPACING_M) + 1):
                place = np.array([self._sign * x_m, side * number * _SPACING_M])
                if number * _SPACING_M > half_m and is_seen(place):
                    break
                places.append((float(place[0]), float(place[1])))
        return np.array(places)

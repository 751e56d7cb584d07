"""How the robot moves while it does not know where it is: by the lidar and odometry alone.

It looks around once where a camera may see markers, and then drives into open space where it has
not been yet: one short-ranged scan fits many places of a map, scans along a drive fit few.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.maths.kernels import kernel
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.costmap.footprint import WAFFLE

_HEADINGS = 48
_CORRIDOR_HALF_WIDTH_M = 0.2
_AHEAD_M = 0.2
"""Free length that is kept before the robot's centre."""
_FAR_M, _NEW_M = 2.0, 2.0
"""Free length and distance from known places beyond which more is not better."""
_CRUMB_M = 0.3
_LEG_M = 1.2
_ESCAPE_M_S, _ESCAPE_RAD_S = 0.1, 0.5
"""Away from something that a turn would touch."""
_ESCAPE_RATES_RAD_S = (0.0, 0.1, -0.1, 0.2, -0.2, 0.35, -0.35, _ESCAPE_RAD_S, -_ESCAPE_RAD_S)
_TURN_SPARE_M = 0.01
"""A turn on the spot is begun where so much is free around it."""


@dataclass(frozen=True, slots=True)
class SearchMotionParams:
    """Speeds of the search."""

    linear_vel_m_s: float = 0.3
    angular_vel_rad_s: float = 1.2
    linear_accel_m_s2: float = 0.8
    angular_accel_rad_s2: float = 1.8
    min_time_to_collision_s: float = 1.0
    control_period_s: float = 0.05
    circumscribed_radius_m: float = WAFFLE.circumscribed_radius_m


class SearchMotion:
    """One search, from its first step until the robot is localised."""

    def __init__(self, params: SearchMotionParams, look_around: bool) -> None:
        """`look_around`: turn once on the spot before driving."""
        self._params = params
        self._left_rad = math.tau if look_around else 0.0
        self._last_yaw_rad: float | None = None
        self._heading_rad: float | None = None
        self._leg_from = SE2(0.0, 0.0, 0.0)
        self._crumbs_m: list[tuple[float, float]] = []
        self._velocity = STOP
        self._escape = 0.0
        """1 on the way on, -1 on the way back from what it would touch; 0: on neither."""

    def step(
        self, odom_from_base: SE2, echoes_m: Array, time_to_collision: Callable[[Velocity], float]
    ) -> Velocity:
        """Velocity for the next control period.

        Args:
            odom_from_base: the robot's pose by odometry.
            echoes_m: (n, 2) float64, the newest scan's echoes in the robot's base frame.
            time_to_collision: seconds until the footprint touches something at a velocity.
        """
        self._remember(odom_from_base)
        wanted = self._turn_around(odom_from_base.yaw_rad)
        if wanted is None:
            wanted = self._drive_on(odom_from_base, echoes_m)
        velocity = self._limited(wanted)
        is_narrow = wanted.linear_m_s == 0.0 and not self._can_turn(echoes_m)
        if is_narrow or time_to_collision(velocity) <= self._params.min_time_to_collision_s:
            # What is wanted is not possible: another direction, and a turn to it, if that is free.
            self._left_rad, self._heading_rad = 0.0, None
            velocity = self._away(wanted, time_to_collision)
        else:
            self._escape = 0.0
        self._velocity = velocity
        return velocity

    def _away(self, wanted: Velocity, time_to_collision: Callable[[Velocity], float]) -> Velocity:
        """A velocity away from what a motion would touch: on or back, along the arc that stays free
        for longest, as a corridor is left that is too narrow for a turn; else a turn.
        """
        least_s = self._params.min_time_to_collision_s
        if self._escape == 0.0:
            self._escape = 1.0 if self._velocity.linear_m_s > 0.0 else -1.0
        turn_rad_s = wanted.angular_rad_s or _ESCAPE_RAD_S
        for ahead in (self._escape, -self._escape):
            found, longest_s = STOP, least_s
            for rate_rad_s in _ESCAPE_RATES_RAD_S:
                arc = Velocity(ahead * _ESCAPE_M_S, rate_rad_s)
                free_s = time_to_collision(arc)
                limited = self._limited(self._along(arc))
                if free_s > longest_s and limited != STOP and time_to_collision(limited) > least_s:
                    found, longest_s = limited, free_s
            if found != STOP:
                self._escape = ahead
                return found
        for rate_rad_s in (-turn_rad_s, turn_rad_s):
            limited = self._limited(self._along(Velocity(0.0, rate_rad_s)))
            if limited != STOP and time_to_collision(limited) > least_s:
                return limited
        return STOP

    def _remember(self, odom_from_base: SE2) -> None:
        here = (odom_from_base.x_m, odom_from_base.y_m)
        if not self._crumbs_m or math.dist(here, self._crumbs_m[-1]) >= _CRUMB_M:
            self._crumbs_m.append(here)

    def _turn_around(self, yaw_rad: float) -> Velocity | None:
        if self._left_rad <= 0.0:
            return None
        if self._last_yaw_rad is not None:
            self._left_rad -= wrap_angle(yaw_rad - self._last_yaw_rad)
        self._last_yaw_rad = yaw_rad
        return Velocity(0.0, self._params.angular_vel_rad_s)

    def _drive_on(self, odom_from_base: SE2, echoes_m: Array) -> Velocity:
        free_m = _free_lengths(echoes_m, _HEADINGS, _CORRIDOR_HALF_WIDTH_M)
        if self._heading_rad is not None:
            bearing_rad = wrap_angle(self._heading_rad - odom_from_base.yaw_rad)
            ahead_m = free_m[round(bearing_rad / math.tau * _HEADINGS) % _HEADINGS] - _AHEAD_M
            if ahead_m < 0.15 or odom_from_base.distance_m(self._leg_from) > _LEG_M:
                self._heading_rad = None
        if self._heading_rad is None:
            self._heading_rad = self._best_heading_rad(odom_from_base, free_m)
            self._leg_from = odom_from_base
        bearing_rad = wrap_angle(self._heading_rad - odom_from_base.yaw_rad)
        rate_rad_s = min(max(2.0 * bearing_rad, -1.0), 1.0) * self._params.angular_vel_rad_s
        if abs(bearing_rad) > 0.4:
            return Velocity(0.0, rate_rad_s)
        ahead_m = float(free_m[0]) - _AHEAD_M
        speed_m_s = min(self._params.linear_vel_m_s, max(0.0, ahead_m))
        return Velocity(speed_m_s, rate_rad_s)

    def _best_heading_rad(self, odom_from_base: SE2, free_m: Array) -> float:
        """The direction, in odom, that leads farthest into the open and away from known places."""
        crumbs_m = np.array(self._crumbs_m)
        best_rad, best = odom_from_base.yaw_rad, -math.inf
        for number in range(_HEADINGS):
            bearing_rad = wrap_angle(math.tau * number / _HEADINGS)
            way_m = min(float(free_m[number]) - _AHEAD_M, _FAR_M)
            if way_m < 0.2:
                continue
            heading_rad = odom_from_base.yaw_rad + bearing_rad
            c, s = portable_kernels.cos_sin(heading_rad)
            east_m = crumbs_m[:, 0] - odom_from_base.x_m - c * way_m
            north_m = crumbs_m[:, 1] - odom_from_base.y_m - s * way_m
            new_m = math.sqrt(float((east_m * east_m + north_m * north_m).min()))
            score = way_m + 1.5 * min(new_m, _NEW_M) - 0.3 * abs(bearing_rad)
            if score > best:
                best_rad, best = heading_rad, score
        return wrap_angle(best_rad)

    def _can_turn(self, echoes_m: Array) -> bool:
        """Whether nothing is within reach of a turn on the spot."""
        least_m = self._params.circumscribed_radius_m + _TURN_SPARE_M
        return not (echoes_m * echoes_m).sum(axis=1).min(initial=math.inf) < least_m * least_m

    def _along(self, wanted: Velocity) -> Velocity:
        """As fast as the accelerations permit on the same arc."""
        share = 1.0
        for goal, last, step in zip(wanted, self._velocity, self._steps, strict=True):
            if goal != 0.0:
                share = min(share, max(0.0, math.copysign(1.0, goal) * last + step) / abs(goal))
        return Velocity(share * wanted.linear_m_s, share * wanted.angular_rad_s)

    @property
    def _steps(self) -> tuple[float, float]:
        """By how much the velocity may change in a period."""
        p = self._params
        return (
            p.linear_accel_m_s2 * p.control_period_s,
            p.angular_accel_rad_s2 * p.control_period_s,
        )

    def _limited(self, wanted: Velocity) -> Velocity:
        last, (dv, dw) = self._velocity, self._steps
        return Velocity(
            min(max(wanted.linear_m_s, last.linear_m_s - dv), last.linear_m_s + dv),
            min(max(wanted.angular_rad_s, last.angular_rad_s - dw), last.angular_rad_s + dw),
        )


@kernel()
def _free_lengths(echoes_m: Array, headings: int, half_width_m: float) -> Array:
    """(headings,) metres from the robot's centre to the first echo in a corridor to each side;
    heading i is i / headings of a turn to the left.
    """
    free_m = np.full(headings, 10.0)
    for i in range(headings):
        c, s = portable_kernels.cos_sin(2.0 * math.pi * i / headings)
        for k in range(len(echoes_m)):
            along = c * echoes_m[k, 0] + s * echoes_m[k, 1]
            aside = c * echoes_m[k, 1] - s * echoes_m[k, 0]
            if along > 0.0 and abs(aside) < half_width_m and along < free_m[i]:
                free_m[i] = along
    return free_m

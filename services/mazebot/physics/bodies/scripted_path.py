"""The pose of a body that follows a scripted path: a pure function of the distance travelled.

It drives along each leg facing forward, and turns on the spot at each corner. A turn counts as
distance too, TURN_RADIUS_M for each radian, so that at constant speed the pose never jumps.
"""

from __future__ import annotations

import bisect
import math
from itertools import pairwise
from typing import NamedTuple

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array, wrap_angle
from mazebot.common.messages.documents import Point2, ScriptedPath

TURN_RADIUS_M = 0.3
_SAME_PLACE_M = 1e-6


class PathPose(NamedTuple):
    """On the floor, in the map frame."""

    x_m: float
    y_m: float
    heading_rad: float
    """Not wrapped: it never jumps within a cycle."""


class Floorplan(NamedTuple):
    """The bounding box of a body that faces along x."""

    low_x_m: float
    low_y_m: float
    low_z_m: float
    high_x_m: float
    high_y_m: float
    high_z_m: float

    @classmethod
    def of(cls, low_m: Array, high_m: Array) -> Floorplan:
        """From its lowest and highest coordinates, (3,) each."""
        return cls(*low_m.tolist(), *high_m.tolist())

    @property
    def reach_m(self) -> float:
        """Distance of its farthest corner from its origin, in x and y."""
        x = max(abs(self.low_x_m), abs(self.high_x_m))
        return math.hypot(x, max(abs(self.low_y_m), abs(self.high_y_m)))

    def corners(self, pose: PathPose) -> list[Point2]:
        """Its corners in the map, in turn."""
        c, s = portable_kernels.cos_sin(pose.heading_rad)
        return [
            (pose.x_m + c * x - s * y, pose.y_m + s * x + c * y)
            for x, y in (
                (self.low_x_m, self.low_y_m),
                (self.high_x_m, self.low_y_m),
                (self.high_x_m, self.high_y_m),
                (self.low_x_m, self.high_y_m),
            )
        ]


def meets(a: PathPose, plan_a: Floorplan, b: PathPose, plan_b: Floorplan) -> bool:
    """Whether two boxes overlap on the floor: no line along a side of either separates them."""
    corners_a, corners_b = plan_a.corners(a), plan_b.corners(b)
    for heading in (a.heading_rad, b.heading_rad):
        c, s = portable_kernels.cos_sin(heading)
        for x, y in ((c, s), (-s, c)):
            along_a = [x * px + y * py for px, py in corners_a]
            along_b = [x * px + y * py for px, py in corners_b]
            if max(along_a) <= min(along_b) or max(along_b) <= min(along_a):
                return False
    return True


class _Leg(NamedTuple):
    start: PathPose
    end: PathPose
    length_m: float


class Route:
    """One cycle of a path, repeated: legs and the turns between them."""

    def __init__(self, start_m: Point2, path: ScriptedPath) -> None:
        """Raises ValueError, in a phrase, if all waypoints are at the start."""
        corners = [start_m]
        for place in path.waypoints_m:
            if math.dist(place, corners[-1]) > _SAME_PLACE_M:
                corners.append(place)
        if len(corners) < 2:
            raise ValueError("waypoints_m: must contain a waypoint away from the start")
        if path.loop and math.dist(corners[0], corners[-1]) <= _SAME_PLACE_M:
            corners.pop()
        # With two corners only, a loop is the path there and back.
        back = corners[1:] if path.loop else [*corners[1:], *corners[-2:0:-1]]
        self._legs = _legs([corners[0], *back, corners[0]])
        self._starts_m = [0.0]
        for leg in self._legs:
            self._starts_m.append(self._starts_m[-1] + leg.length_m)
        self.length_m = self._starts_m.pop()
        """Length of a cycle, turns included."""

    def at(self, travelled_m: float) -> PathPose:
        """The pose after a distance, which is wrapped to one cycle."""
        way_m = travelled_m % self.length_m
        number = bisect.bisect_right(self._starts_m, way_m) - 1
        start, end, length_m = self._legs[number]
        share = (way_m - self._starts_m[number]) / length_m
        return PathPose(*(a + share * (b - a) for a, b in zip(start, end, strict=True)))

    def velocity(self, travelled_m: float, speed_m_s: float) -> tuple[float, float, float]:
        """Along x and y of the map, m/s, and about z, rad/s, in the current leg or turn."""
        number = bisect.bisect_right(self._starts_m, travelled_m % self.length_m) - 1
        start, end, length_m = self._legs[number]
        x, y, turn = ((b - a) / length_m * speed_m_s for a, b in zip(start, end, strict=True))
        return x, y, turn


def _legs(corners: list[Point2]) -> list[_Leg]:
    """Legs through all corners, a turn before each but the first, and one to the start heading."""
    headings = [portable_kernels.atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(corners)]
    legs: list[_Leg] = []
    heading = headings[0]
    for number, (a, b) in enumerate(pairwise(corners)):
        turn = wrap_angle(headings[number] - heading)
        if turn:
            legs.append(_turn(a, heading, turn))
        heading += turn
        legs.append(_Leg(PathPose(*a, heading), PathPose(*b, heading), math.dist(a, b)))
    turn = wrap_angle(headings[0] - heading)
    if turn:
        legs.append(_turn(corners[-1], heading, turn))
    return legs


def _turn(place: Point2, heading_rad: float, turn_rad: float) -> _Leg:
    return _Leg(
        PathPose(*place, heading_rad),
        PathPose(*place, heading_rad + turn_rad),
        abs(turn_rad) * TURN_RADIUS_M,
    )

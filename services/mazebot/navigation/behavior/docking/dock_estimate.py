"""Where a dock's marker is, by all sightings of it: a Kalman filter of its pose in the odometry
frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.navigation.behavior.context import MarkerPose


@dataclass(frozen=True, slots=True)
class SightingParams:
    """Standard deviations of one sighting, and of odometry's drift."""

    position_std_m: float = 0.002
    position_std_per_m: float = 0.01
    """Added for each metre of range."""
    yaw_std_rad: float = 0.02
    yaw_std_per_m: float = 0.06
    """Added for each metre of range: a far marker's corners hardly show how it is turned."""
    drift_std_per_m: float = 0.01
    """Of the position by odometry, after a metre."""
    drift_std_rad_per_rad: float = 0.02
    """Of the heading by odometry, after a radian."""
    gate: float = 4.0
    """A sighting further off than this many standard deviations is left out."""
    most_left_out: int = 8
    """After so many in a row the filter is reset to the next."""
    place_sigmas: float = 3.0
    place_slack_m: float = 0.1
    """A marker further than both together from where it should be is another one."""


@dataclass(frozen=True, slots=True)
class Expected:
    """Where a marker should be, by the map and the robot's pose in it."""

    odom_from_marker: SE2
    position_std_m: float
    """Of the robot's pose, along each axis."""
    yaw_std_rad: float

    def reach_m(self, params: SightingParams, range_m: float) -> float:
        """How far from there the marker may be seen at a range."""
        seen_std_m = params.position_std_m + params.position_std_per_m * range_m
        std_m = math.hypot(self.position_std_m, self.yaw_std_rad * range_m, seen_std_m)
        return params.place_slack_m + params.place_sigmas * std_m


class DockEstimate:
    """The filter; x, y and yaw are independent."""

    def __init__(self, params: SightingParams) -> None:
        self._params = params
        self.count = 0
        """Sightings taken in since the filter began."""
        self.new = 0
        """Those of them since `count_anew`."""
        self.last_stamp_ns = -1
        """Time of the newest sighting, taken in or not."""
        self._pose = SE2(0.0, 0.0, 0.0)
        self._position_var = self._yaw_var = 0.0
        self._left_out = 0
        self._at: SE2 | None = None

    @property
    def odom_from_marker(self) -> SE2:
        """The marker's pose; of no meaning before the first sighting."""
        return self._pose

    def position_std_m(self, odom_from_base: SE2) -> float:
        """Standard deviation of the marker's position along each axis, seen from here."""
        return math.sqrt(self._position_var + self._drifts(odom_from_base)[0])

    def count_anew(self) -> None:
        """Begin to count new sightings."""
        self.new = 0

    def add(self, seen: MarkerPose) -> None:
        """Take in a sighting, if it is newer than the last one."""
        if seen.stamp_ns <= self.last_stamp_ns:
            return
        self.last_stamp_ns = seen.stamp_ns
        self._drift(seen.odom_from_base)
        p, base_from_marker = self._params, seen.base_from_marker
        range_m = math.hypot(base_from_marker.x_m, base_from_marker.y_m)
        position_std = p.position_std_m + p.position_std_per_m * range_m
        yaw_std = p.yaw_std_rad + p.yaw_std_per_m * range_m
        measured = seen.odom_from_marker
        if self.count == 0 or self._left_out >= p.most_left_out:
            self._pose, self._left_out, self.count, self.new = measured, 0, 1, 1
            self._position_var, self._yaw_var = position_std * position_std, yaw_std * yaw_std
            return
        off = SE2(
            measured.x_m - self._pose.x_m,
            measured.y_m - self._pose.y_m,
            wrap_angle(measured.yaw_rad - self._pose.yaw_rad),
        )
        position_sum = self._position_var + position_std * position_std
        yaw_sum = self._yaw_var + yaw_std * yaw_std
        if math.hypot(off.x_m, off.y_m) > p.gate * math.sqrt(position_sum) or abs(
            off.yaw_rad
        ) > p.gate * math.sqrt(yaw_sum):
            self._left_out += 1
            return
        self._left_out = 0
        gain, yaw_gain = self._position_var / position_sum, self._yaw_var / yaw_sum
        self._pose = SE2(
            self._pose.x_m + gain * off.x_m,
            self._pose.y_m + gain * off.y_m,
            wrap_angle(self._pose.yaw_rad + yaw_gain * off.yaw_rad),
        )
        self._position_var *= 1.0 - gain
        self._yaw_var *= 1.0 - yaw_gain
        self.count += 1
        self.new += 1

    def _drift(self, odom_from_base: SE2) -> None:
        """Grow the variances by what odometry may be wrong since the last sighting."""
        position_var, yaw_var = self._drifts(odom_from_base)
        self._at = odom_from_base
        self._position_var += position_var
        self._yaw_var += yaw_var

    def _drifts(self, odom_from_base: SE2) -> tuple[float, float]:
        """Variances of odometry's position and heading since the last sighting."""
        p, last = self._params, self._at
        if last is None:
            return 0.0, 0.0
        driven_m = last.distance_m(odom_from_base)
        turned_rad = abs(wrap_angle(odom_from_base.yaw_rad - last.yaw_rad))
        position_std = p.drift_std_per_m
        yaw_std = p.drift_std_rad_per_rad
        return (
            position_std * position_std * (driven_m + 0.1 * turned_rad),
            yaw_std * yaw_std * (driven_m + turned_rad),
        )

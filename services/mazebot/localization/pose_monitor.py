"""Whether the pose can be believed: what contradicts it, against the long mean, and markers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.localization import particle_filter as pf
from mazebot.localization.candidates import CERTAIN_QUALITY, GATE
from mazebot.localization.markers.marker_model import Sighting
from mazebot.localization.params import LocalizationParams

_HOPELESS = 0.4
"""Below this consistency for `_HOPELESS_S` the pose is lost, though no other one is found."""
_HOPELESS_S = 3.0
_SEARCH_AGAIN_S = 2.0
_CARRIED = 9.0
"""Negative logarithm of the probability that a robot was carried away: so much less likely than
another pose has what contradicts a pose to make it, before the robot is called lost.
"""
_MOVED_M, _MOVED_RAD = 0.2, 0.35
"""Scans nearer to one another than this say the same."""
_STRIKE_S = 2.0
_AGREE_M, _AGREE_RAD = 0.3, 0.3


@dataclass(frozen=True)
class _Strike:
    stamp_ns: int
    poses_in_odom: list[SE2]
    """map_from_odom, if the sighting's candidates are right."""


class PoseMonitor:
    """Running means of the quality and of the consistency, and the time since that is suspect."""

    def __init__(self, params: LocalizationParams) -> None:
        self._params = params
        self.begin()

    def begin(self, quality: float = 0.0) -> None:
        """Reset, as at a pose that was just set or found, with its quality so far."""
        self.quality = quality
        self._consistency = 1.0
        self._slow = 1.0
        self._suspect_ns: int | None = None
        self._poor_ns: int | None = None
        self._hopeless_ns: int | None = None
        self._searched_ns: int | None = None
        self._strike: _Strike | None = None
        self._advantage = 0.0
        self._weighed_at: SE2 | None = None

    @property
    def is_suspect(self) -> bool:
        """Whether far more contradicts the pose than in the long mean."""
        return self._suspect_ns is not None

    @property
    def is_poor(self) -> bool:
        """Whether the pose leaves much unexplained, be it by things that are not on the map."""
        return self._poor_ns is not None

    def add(self, stamp_ns: int, quality: float, consistency: float) -> None:
        """Add a scan's quality and consistency at the pose, of which the latter is judged as in
        augmented MCL (Probabilistic Robotics, 8.3).
        """
        p = self._params
        self.quality += p.recovery_alpha_fast * (quality - self.quality)
        self._consistency += p.recovery_alpha_fast * (consistency - self._consistency)
        if self.quality >= CERTAIN_QUALITY:
            self._poor_ns = None
        elif self._poor_ns is None:
            self._poor_ns = stamp_ns
        suspect = self._consistency < p.suspect_quality * self._slow
        if not suspect:
            self._slow += p.recovery_alpha_slow * (consistency - self._slow)
            self._suspect_ns = self._weighed_at = None
            self._advantage = 0.0
        elif self._suspect_ns is None:
            self._suspect_ns = stamp_ns
        if self._consistency >= _HOPELESS:
            self._hopeless_ns = None
        elif self._hopeless_ns is None:
            self._hopeless_ns = stamp_ns

    def is_hopeless(self, stamp_ns: int) -> bool:
        """Whether nearly everything contradicts the pose, for long."""
        return self._hopeless_ns is not None and stamp_ns - self._hopeless_ns >= _HOPELESS_S * 1e9

    def wants_search(self, stamp_ns: int, is_wide: bool) -> bool:
        """Whether another pose should be sought now, for a suspect, a poor or a wide estimate; True
        but once in two seconds.
        """
        since_ns, lost_after_ns = (self._suspect_ns, self._poor_ns), self._params.lost_after_s * 1e9
        is_due = any(one is not None and stamp_ns - one >= lost_after_ns for one in since_ns)
        if not (is_due or is_wide):
            return False
        if self._searched_ns is not None and stamp_ns - self._searched_ns < _SEARCH_AGAIN_S * 1e9:
            return False
        self._searched_ns = stamp_ns
        return True

    def outweighs(self, odom_from_base: SE2, advantage: float) -> bool:
        """Whether the advantage in log-likelihood that another pose has by a scan at this odometry,
        with those of scans from elsewhere since the pose is suspect, makes the pose lost.
        """
        last = self._weighed_at
        if last is not None and last.is_near(odom_from_base, _MOVED_M, _MOVED_RAD):
            self._advantage = max(self._advantage, advantage)
        else:
            self._advantage += advantage
            self._weighed_at = odom_from_base
        return self._advantage >= _CARRIED

    def agree(self) -> None:
        """Take note that a marker's sighting agrees with the pose."""
        self._strike = None

    def contradict(self, stamp_ns: int, seen: Sequence[Sighting], odom_from_base: SE2) -> bool:
        """Whether a marker's sighting that is far from the pose has one before it that was, too,
        and both agree on another pose.
        """
        base_from_odom = odom_from_base.inverse()
        strike = _Strike(stamp_ns, [s.map_from_base @ base_from_odom for s in seen])
        last, self._strike = self._strike, strike
        if last is None or not 0 < stamp_ns - last.stamp_ns <= _STRIKE_S * 1e9:
            return False
        # Compared where the robot is: far from odom's origin a small turn is a long way.
        return any(
            (one @ odom_from_base).is_near(other @ odom_from_base, _AGREE_M, _AGREE_RAD)
            for one in last.poses_in_odom
            for other in strike.poses_in_odom
        )


def is_far(seen: Sequence[Sighting], map_from_base: SE2, covariance: Array) -> bool:
    """Whether no candidate of a sighting may be seen from a pose, by its (3, 3) covariance."""
    return all(_squared_distance(s, map_from_base, covariance) > GATE for s in seen)


def _squared_distance(sighting: Sighting, map_from_base: SE2, covariance: Array) -> float:
    """Mahalanobis distance of the pose that a sighting gives, from the estimate."""
    c, s = portable.cos_sin(sighting.map_from_base.yaw_rad)
    place = portable.inverse(sighting.information)
    turn_2 = portable.square(min(sighting.heading_std_rad, math.pi))
    # The marker's own heading turns the robot's place about the marker.
    arm_x, arm_y = -sighting.y_m, sighting.x_m
    xx = float(place[0, 0]) + turn_2 * arm_x * arm_x
    xy = float(place[0, 1]) + turn_2 * arm_x * arm_y
    yy = float(place[1, 1]) + turn_2 * arm_y * arm_y
    total = covariance.copy()
    total[0, 0] += c * c * xx - 2.0 * c * s * xy + s * s * yy
    total[1, 1] += s * s * xx + 2.0 * c * s * xy + c * c * yy
    across = c * s * (xx - yy) + (c * c - s * s) * xy
    total[0, 1] += across
    total[1, 0] += across
    east, north = turn_2 * (s * arm_y - c * arm_x), -turn_2 * (s * arm_x + c * arm_y)
    total[0, 2] += east
    total[2, 0] += east
    total[1, 2] += north
    total[2, 1] += north
    total[2, 2] += turn_2
    return pf.squared_mahalanobis(sighting.map_from_base, map_from_base, total)

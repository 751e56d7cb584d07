"""Notices that the wheels turn and the robot does not move as they say, and measures how it moves
instead: by scans a short drive apart.

A scan is compared with one before that the wheels say was taken elsewhere. While odometry explains
both, that is all. Where it does not, the motion is sought that does, among shares of odometry's
way, ways aside, as along a thing that the robot pushes against, and turns: it is a slip if far less
than odometry's way explains the scans far better.
Scans that do not tell, as of open floor or along a corridor, change nothing. A robot that is pushed
once does not slip: wheels that slip still do after the scan that told it first. A scan measures
turns better than a gyroscope's readings do, and costs less than these at their rate.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.maths.kernels import kernel
from mazebot.common.maths.odometry_history import OdometryHistory
from mazebot.common.messages.scan import Scan

_WAY_M, _TURN_RAD = 0.06, 0.15
"""Scans are compared that odometry puts this far apart."""
_WITHIN_NS: Final = 1_500_000_000
_SLOW_WITHIN_NS: Final = 6_000_000_000
"""A robot that is too slow to come so far within the first of these has until the second."""
_STILL_M, _STILL_RAD = 0.01, 0.02
"""Wheels that turn by less between two scans stand."""
_SHARES: Final = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
_ASIDES: Final = np.array([0.25, -0.25, 0.5, -0.5, 0.75, -0.75])
"""Ways to the left, as shares of odometry's way."""
_SLIP_SHARE: Final = 0.5
"""Of odometry's way: what is more is a wrong scale, which the filter learns."""
_TURNS_RAD: Final = np.linspace(-0.3, 0.3, 31)
_NEAR_RAD: Final = np.linspace(-0.04, 0.04, 5)
"""About the turn that fits best without a way aside."""
_MOST_M: Final = 0.15
"""A beam's misfit counts as no more: it met another thing."""
_USUAL_M: Final = 0.012
"""Mean misfit where odometry is right, until it is measured."""
_MISFIT_RATIO, _MISFIT_M = 2.0, 0.01
"""A scan with more than this multiple of the usual misfit, and so much more, is not explained.
Another motion explains it better by so much at least: scans without noise fit to the last bit.
"""
_GAIN: Final = 0.02
_BETTER: Final = 0.5
"""Of odometry's misfit another motion may have at most half."""
_STOOD: Final = 0.3
"""And less of a robot that seems to have stood for long: a person who walks ahead of it along a
corridor looks the same, but is seen by fewer beams.
"""
_AGAIN_M, _AGAIN_RAD = 0.025, 0.06
"""After the scan that told of a slip first, a shorter way is enough,"""
_AGAIN_BETTER: Final = 0.75
"""of which scans with noise tell less."""
_LEAST_BEAMS: Final = 25
_HOLD_NS: Final = 5_000_000_000
"""So long after a slip, another one is one of its own."""
_BEAM_STEP: Final = 4


@dataclass(frozen=True, slots=True)
class _Seen:
    stamp_ns: int
    odom_from_base: SE2
    steady_from_base: SE2
    scan: Scan


class WheelSlip:
    """Odometry without the way that slipping wheels add. Frames: `odom` is what the wheels say,
    `steady` where the robot would be by them without the slips noticed.

    The same calls give the same bits; without a slip, so does odometry.
    """

    def __init__(self) -> None:
        self.slips = False
        """Whether the wheels slip now."""
        self.steady_from_odom: SE2 | None = None
        """The correction of odometry at its latest time; None: no slip was noticed yet."""
        self._history = OdometryHistory()
        self._seen: deque[_Seen] = deque()
        self._steady_from_base: SE2 | None = None
        """Of the latest odometry, where it was corrected."""
        self._usual_m = _USUAL_M
        self._told: _Seen | None = None
        """The scan that first told that a slip begins or ends, where it has the robot."""

    def odometry(self, stamp_ns: int, odom_from_base: SE2) -> SE2:
        """Add odometry; the same, corrected."""
        if self._history.add(stamp_ns, odom_from_base):
            if self.slips and self._steady_from_base is not None:
                self.steady_from_odom = self._steady_from_base @ odom_from_base.inverse()
            elif self.steady_from_odom is not None:
                self._steady_from_base = self.steady_from_odom @ odom_from_base
        if self.steady_from_odom is None:
            return odom_from_base
        return self.steady_from_odom @ odom_from_base

    def scan(self, scan: Scan) -> bool:
        """Compare a scan with those before; whether the correction of odometry has changed by it:
        the latest pose is `corrected` now.
        """
        odom_from_base = self._history.at(scan.stamp_ns)
        if odom_from_base is None:
            return False
        if self._seen and scan.stamp_ns <= self._seen[-1].stamp_ns:
            self._seen.clear()
            self._told = None
        seen = _Seen(scan.stamp_ns, odom_from_base, self._steady(odom_from_base), scan)
        while self._seen and self._is_too_old(self._seen[0], seen):
            self._seen.popleft()
        steady: SE2 | None = None
        if self._seen:
            if self.slips and not _moves(self._seen[-1], seen, _STILL_M, _STILL_RAD):
                # Wheels that stand do not slip.
                self.slips, self._told = False, None
            before = next(
                (one for one in reversed(self._seen) if _moves(one, seen, _WAY_M, _TURN_RAD)), None
            )
            if before is not None:
                oldest = self._seen[0]
                steady = self._compare(oldest if self._has_stood(oldest, seen) else before, seen)
        if steady is not None:
            # What was corrected until now was not right.
            self._seen.clear()
            seen = replace(seen, steady_from_base=steady)
        self._seen.append(seen)
        return steady is not None

    @property
    def corrected(self) -> SE2:
        """The corrected pose of the latest odometry."""
        return self._steady(self._history.latest[1])

    def with_odom(self, map_from_steady: SE2) -> SE2:
        """map_from_odom by a correction of corrected odometry."""
        steady = self.steady_from_odom
        return map_from_steady if steady is None else map_from_steady @ steady

    def _steady(self, odom_from_base: SE2) -> SE2:
        steady = self.steady_from_odom
        return odom_from_base if steady is None else steady @ odom_from_base

    @property
    def _limit_m(self) -> float:
        """A scan with more misfit is not explained."""
        return _MISFIT_RATIO * self._usual_m + _MISFIT_M

    def _is_too_old(self, oldest: _Seen, seen: _Seen) -> bool:
        """Whether the oldest scan is not to be compared with one any more."""
        age_ns = seen.stamp_ns - oldest.stamp_ns
        if not _WITHIN_NS < age_ns <= _SLOW_WITHIN_NS:
            return age_ns > _WITHIN_NS
        # A slow robot needs it until the next one is as far away.
        return len(self._seen) > 1 and _moves(self._seen[1], seen, _WAY_M, _TURN_RAD)

    def _has_stood(self, before: _Seen, seen: _Seen) -> bool:
        """Whether no motion at all explains two scans, and odometry far worse."""
        before_m, now_m, lidar = _ranges_of(before), _ranges_of(seen), _lidar_of(seen.scan)
        at_rest_m = _misfit_m(before_m, now_m, lidar, 0.0, 0.0, 0.0)
        if not 0.0 <= at_rest_m <= self._limit_m:
            return False
        x, y, turn = before.odom_from_base.inverse() @ seen.odom_from_base
        return _is_better(at_rest_m, _misfit_m(before_m, now_m, lidar, x, y, turn), _STOOD)

    def _compare(self, before: _Seen, seen: _Seen) -> SE2 | None:
        """The corrected pose at a scan, by one before; None: it stays."""
        moved = before.odom_from_base.inverse() @ seen.odom_from_base
        x, y, turn = moved
        before_m, now_m, lidar = _ranges_of(before), _ranges_of(seen), _lidar_of(seen.scan)
        by_odometry_m = _misfit_m(before_m, now_m, lidar, x, y, turn)
        if by_odometry_m < 0.0:
            return None
        limit_m = self._limit_m
        at_rest_m = _misfit_m(before_m, now_m, lidar, 0.0, 0.0, 0.0)
        stands = at_rest_m >= 0.0 and _is_better(at_rest_m, by_odometry_m, _BETTER)
        if by_odometry_m <= limit_m and not stands:
            if not self.slips:
                self._usual_m += _GAIN * (by_odometry_m - self._usual_m)
                return self._judge(before, seen, 1.0, moved)
            if at_rest_m <= by_odometry_m / _BETTER:
                # As along a corridor: it may stand as well.
                self._told = None
                return None
            return self._judge(before, seen, 1.0, moved)
        share, x, y, turn, best_m = _best_motion(
            before_m, now_m, lidar, x, y, turn, _SHARES, _ASIDES, _TURNS_RAD, _NEAR_RAD
        )
        if best_m > limit_m or not _is_better(best_m, by_odometry_m, _BETTER):
            self._told = None
            return None
        return self._judge(before, seen, float(share), SE2(float(x), float(y), float(turn)))

    def _judge(self, before: _Seen, seen: _Seen, share: float, moved: SE2) -> SE2 | None:
        """Take in a comparison's result: how the robot has moved, and the share of odometry's way
        that it has gone ahead. The corrected pose at the scan, or None.
        """
        slips = share <= _SLIP_SHARE
        if slips == self.slips:
            self._told = None
            if not slips:
                return None
        elif self._told is None:
            self._told = replace(seen, steady_from_base=before.steady_from_base @ moved)
            return None
        elif slips:
            again = self._again(self._told, seen)
            if again is None:
                return None
            before, moved = self._told, again
        self.slips, self._told = slips, None
        steady = before.steady_from_base @ moved
        latest = self._history.latest[1]
        now = steady if slips else steady @ (seen.odom_from_base.inverse() @ latest)
        self._steady_from_base, self.steady_from_odom = now, now @ latest.inverse()
        return steady

    def _again(self, told: _Seen, seen: _Seen) -> SE2 | None:
        """How the robot has moved since a scan that told of a slip, if less than the wheels say
        since then as well.
        """
        if not _moves(told, seen, _AGAIN_M, _AGAIN_RAD):
            return None
        before_m, now_m, lidar = _ranges_of(told), _ranges_of(seen), _lidar_of(seen.scan)
        x, y, turn = told.odom_from_base.inverse() @ seen.odom_from_base
        by_odometry_m = _misfit_m(before_m, now_m, lidar, x, y, turn)
        share, x, y, turn, best_m = _best_motion(
            before_m, now_m, lidar, x, y, turn, _SHARES, _ASIDES, _TURNS_RAD, _NEAR_RAD
        )
        if share > _SLIP_SHARE or best_m > min(self._limit_m, _AGAIN_BETTER * by_odometry_m):
            return None
        return SE2(float(x), float(y), float(turn))


def compile_kernels() -> None:
    """Compile what a comparison calls, which a run comes to late."""
    ranges_m, lidar = np.ones(360, np.float32), np.array([0.0, 0.0175, 0.1, 3.5, 0.0, 0.0, 0.0])
    _misfit_m(ranges_m, ranges_m, lidar, 0.1, 0.0, 0.0)
    _best_motion(
        ranges_m, ranges_m, lidar, 0.1, 0.0, 0.0, _SHARES, _ASIDES, _TURNS_RAD[:1], _NEAR_RAD
    )


class SlipLog:
    """Tells where a slip begins, and where the wheels have held again for a while: of a robot that
    is wedged, they slip again with each attempt.
    """

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._slipped_ns: int | None = None

    def update(self, now_ns: int, slips: bool) -> None:
        """Take whether the wheels slip now."""
        if self._slipped_ns is not None and now_ns < self._slipped_ns:
            self._slipped_ns = None
        if slips:
            if self._slipped_ns is None:
                self._logger.warning("the wheels slip: the pose does not follow them")
            self._slipped_ns = now_ns
        elif self._slipped_ns is not None and now_ns - self._slipped_ns > _HOLD_NS:
            self._logger.info("the wheels hold again")
            self._slipped_ns = None


def _is_better(misfit_m: float, by_odometry_m: float, share: float) -> bool:
    """Whether a motion explains a scan far better than odometry's does."""
    return misfit_m <= min(share * by_odometry_m, by_odometry_m - _MISFIT_M)


def _moves(before: _Seen, now: _Seen, way_m: float, turn_rad: float) -> bool:
    a, b = before.odom_from_base, now.odom_from_base
    return a.distance_m(b) >= way_m or abs(wrap_angle(b.yaw_rad - a.yaw_rad)) >= turn_rad


def _ranges_of(seen: _Seen) -> NDArray[np.float32]:
    return np.array(seen.scan.ranges_m, np.float32)


def _lidar_of(scan: Scan) -> Array:
    """(7,) first angle, step, shortest and longest range, and the lidar's pose on the robot."""
    beams = scan.angle_min_rad, scan.angle_increment_rad, scan.range_min_m, scan.range_max_m
    return np.array([*beams, *scan.base_from_scan], np.float64)


@kernel()
def _misfit_m(
    before_m: NDArray[np.float32],
    now_m: NDArray[np.float32],
    lidar: Array,
    x_m: float,
    y_m: float,
    turn_rad: float,
) -> float:
    """Mean misfit of a scan's echoes on the surfaces of one before, if the robot has moved by a
    pose since; below 0 where too few can be compared. `lidar`: as `_lidar_of` gives it.
    """
    count, turn = before_m.size, round(2.0 * math.pi / abs(lidar[1]))
    first_rad, step_rad, range_min_m, range_max_m = lidar[0], lidar[1], lidar[2], lidar[3]
    sensor_x, sensor_y, sensor_rad = lidar[4], lidar[5], lidar[6]
    c, s = portable_kernels.cos_sin(turn_rad)
    cos, sin = portable_kernels.cos_sin(sensor_rad)
    # From base to the sensor's frame at the scan before.
    shift_x, shift_y = c * sensor_x - s * sensor_y + x_m, s * sensor_x + c * sensor_y + y_m
    shift_x, shift_y = shift_x - sensor_x, shift_y - sensor_y
    from_x, from_y = cos * shift_x + sin * shift_y, cos * shift_y - sin * shift_x
    total, used = 0.0, 0
    for i in range(0, now_m.size, _BEAM_STEP):
        reach = now_m[i]
        if not range_min_m <= reach < range_max_m:
            continue
        a, b = portable_kernels.cos_sin(first_rad + step_rad * i + turn_rad)
        x, y = from_x + reach * a, from_y + reach * b
        beam = (portable_kernels.atan2(y, x) - first_rad) / step_rad
        low = math.floor(beam) % turn
        high = (low + 1) % turn
        if low >= count or high >= count:
            continue
        one, other = before_m[low], before_m[high]
        if not (range_min_m <= one < range_max_m and range_min_m <= other < range_max_m):
            continue
        part = beam - math.floor(beam)
        expected = one + part * (other - one)
        total += min(abs(math.sqrt(x * x + y * y) - expected), _MOST_M)
        used += 1
    return total / used if used >= _LEAST_BEAMS else -1.0


@kernel()
def _best_motion(
    before_m: NDArray[np.float32],
    now_m: NDArray[np.float32],
    lidar: Array,
    x_m: float,
    y_m: float,
    turn_rad: float,
    shares: Array,
    asides: Array,
    turns_rad: Array,
    near_rad: Array,
) -> tuple[float, float, float, float, float]:
    """The motion that fits best: the share of odometry's way that it goes ahead, its x, y and turn,
    and its misfit.

    Turns about none and about that of odometry are tried: `turns_rad` are added to both. Of ways
    aside, those with turns near the best one without are: `near_rad` are added to it.
    """
    best_share, best_x, best_y, best_turn, best_m = 1.0, x_m, y_m, turn_rad, np.inf
    for share in shares:
        to_x, to_y = share * x_m, share * y_m
        for about in (0.0, turn_rad):
            for add in turns_rad:
                misfit_m = _misfit_m(before_m, now_m, lidar, to_x, to_y, about + add)
                if 0.0 <= misfit_m < best_m:
                    best_share, best_x, best_y = share, to_x, to_y
                    best_turn, best_m = about + add, misfit_m
    about = best_turn
    for share in shares:
        for aside in asides:
            to_x, to_y = share * x_m - aside * y_m, share * y_m + aside * x_m
            for add in near_rad:
                misfit_m = _misfit_m(before_m, now_m, lidar, to_x, to_y, about + add)
                if 0.0 <= misfit_m < best_m:
                    best_share, best_x, best_y = share, to_x, to_y
                    best_turn, best_m = about + add, misfit_m
    return best_share, best_x, best_y, best_turn, best_m

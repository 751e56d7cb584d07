"""Whether the scans of a log fit each other by odometry where the lidar is turned otherwise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mazebot.cli.logs.log import Log, LoggedScan, interpolated
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.robot.waffle import BASE_FROM_SCAN

_QUARTER_RAD = math.pi / 2.0
_LEAST_WAY_M, _MOST_WAY_M = 0.5, 1.0
"""Between two scans that are compared: far enough to tell directions apart, near enough for
odometry to be right.
"""
_MOST_TURN_RAD, _MOST_TIME_S = 0.6, 10.0
_MOST_PAIRS, _LEAST_PAIRS = 100, 5
_MOST_RANGE_M = 15.0
"""Beyond it, points of neighbouring beams lie too far apart."""
_LEAST_POINTS = 20
_NEAR_M = 0.1
"""Points of two scans that are as near to each other are of the same wall."""
_BETTER = 0.25
"""Of the points of a scan, that the right turn explains more, on the average."""
_WORSE, _SELDOM = 0.1, 0.1
"""It explains so much less only in so few of the pairs."""


class Turn(NamedTuple):
    """How the scans of a lidar fit better."""

    quarters: int
    """Turns of 90 degrees to the left, of the lidar on the robot."""
    is_mirrored: bool
    """Whether its beams go round the other way."""
    share: float
    """Of the points of a scan that lie where another saw a wall, so turned."""
    given_share: float
    """As given."""


_QUARTERS = ("", "90 degrees to the left", "180 degrees", "90 degrees to the right")
_TURNS = [(quarters, is_mirrored) for is_mirrored in (False, True) for quarters in range(4)]


def check_turn(log_file: object, log: Log, base_from_scan: SE2 | None) -> None:
    """Raises ConfigError with one line where the scans of a lidar do not fit each other by
    odometry, and would if it were turned otherwise on the robot, or its beams were mirrored.

    `base_from_scan` is where the caller says that the lidar is; None: where the log says.
    """
    frames = sorted(log.scans_by_lidar())
    for frame in frames:
        turn = better_turn(log, frame, base_from_scan)
        if turn is None:
            continue
        whose = f" of {frame!r:.60}" if len(frames) > 1 else ""
        how = " and ".join(
            ["mirrored beams"] * turn.is_mirrored
            + [f"the lidar turned by {_QUARTERS[turn.quarters]}"] * bool(turn.quarters)
        )
        raise ConfigError(
            f"--log: {log_file}: the scans{whose} do not fit odometry: "
            f"{100.0 * turn.given_share:.0f} % of a scan's returns lie where another saw walls; "
            f"with {how} it would be {100.0 * turn.share:.0f} %: "
            f"{_remedy(log, frame, base_from_scan, turn, is_alone=len(frames) == 1)}"
        )


def better_turn(log: Log, frame: str, base_from_scan: SE2 | None) -> Turn | None:
    """How the lidar with this frame would have to be turned for its scans to fit each other by
    odometry far better; None: as it is, or the log does not tell.
    """
    shares = np.array(
        [
            [_share(pair, quarters, is_mirrored) for quarters, is_mirrored in _TURNS]
            for pair in _pairs(log, frame, base_from_scan)
        ]
    )
    if len(shares) < _LEAST_PAIRS:
        return None
    means = shares.mean(axis=0)
    best = int(np.argmax(means))
    gains = shares[:, best] - shares[:, 0]
    if gains.mean() < _BETTER or (gains < -_WORSE).mean() > _SELDOM:
        return None
    return Turn(*_TURNS[best], float(means[best]), float(means[0]))


class _Pair(NamedTuple):
    """Two scans of a lidar from places apart."""

    a_m: Array
    b_m: Array
    """(n, 2) their points in the lidar's frame."""
    base_from_a: SE2
    base_from_b: SE2
    """Where the lidar was on the base."""
    a_from_b: SE2
    """How the base has moved, by odometry."""


def _pairs(log: Log, frame: str, base_from_scan: SE2 | None) -> list[_Pair]:
    scans = log.scans_by_lidar()[frame]
    odometry = log.odometry()
    if not len(odometry):
        return []
    times_s = np.array([time_s for time_s, _ in scans])
    at = interpolated(odometry, times_s)
    found = list(_apart(times_s, at))
    found = [found[i] for i in _spread(len(found))]
    pairs = []
    for i, j in found:
        first, second = scans[i][1], scans[j][1]
        mounts = [
            base_from_scan or scan.base_from_scan or BASE_FROM_SCAN for scan in (first, second)
        ]
        a_m, b_m = _points(first), _points(second)
        if min(len(a_m), len(b_m)) >= _LEAST_POINTS:
            pairs.append(_Pair(a_m, b_m, mounts[0], mounts[1], SE2(*at[i]).inverse() @ SE2(*at[j])))
    return pairs


def _apart(times_s: Array, poses: Array) -> Iterator[tuple[int, int]]:
    """Indices of poses (n, 3), each with the next that is far enough away, where it is near."""
    first = 0
    for second in range(1, len(poses)):
        x_m, y_m, turned_rad = poses[second] - poses[first]
        way_m = math.hypot(x_m, y_m)
        if way_m < _LEAST_WAY_M:
            continue
        is_soon = times_s[second] - times_s[first] < _MOST_TIME_S
        if way_m < _MOST_WAY_M and abs(turned_rad) < _MOST_TURN_RAD and is_soon:
            yield first, second
        first = second


def _spread(count: int) -> Sequence[int]:
    if count <= _MOST_PAIRS:
        return range(count)
    return [int(i) for i in np.linspace(0, count - 1, _MOST_PAIRS)]


def _points(scan: LoggedScan) -> Array:
    """(n, 2) returns of a scan in the lidar's frame."""
    ranges_m = np.asarray(scan.ranges_m, np.float64)
    with np.errstate(invalid="ignore"):
        are_returns = (ranges_m >= scan.range_min_m) & (ranges_m < scan.range_max_m)
        are_returns &= (ranges_m > 0.0) & (ranges_m < _MOST_RANGE_M)
    angles_rad = scan.angle_min_rad + scan.angle_increment_rad * np.flatnonzero(are_returns)
    ranges_m = ranges_m[are_returns]
    return np.column_stack([ranges_m * np.cos(angles_rad), ranges_m * np.sin(angles_rad)])


def _share(pair: _Pair, quarters: int, is_mirrored: bool) -> float:
    """Of the second scan's points, those at which the first has some too."""
    from scipy.spatial import KDTree  # noqa: PLC0415 - loaded for logs alone

    base_from_a, base_from_b = (
        mount._replace(yaw_rad=mount.yaw_rad + quarters * _QUARTER_RAD)
        for mount in (pair.base_from_a, pair.base_from_b)
    )
    mirror = np.array([1.0, -1.0 if is_mirrored else 1.0])
    a_m = _moved(base_from_a, pair.a_m * mirror)
    b_m = _moved(pair.a_from_b @ base_from_b, pair.b_m * mirror)
    away_m, _ = KDTree(a_m).query(b_m, distance_upper_bound=_NEAR_M)
    return float(np.isfinite(away_m).mean())


def _moved(pose: SE2, points_m: Array) -> Array:
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    return np.asarray(points_m @ np.array([[c, s], [-s, c]]) + np.array([pose.x_m, pose.y_m]))


def _remedy(log: Log, frame: str, base_from_scan: SE2 | None, turn: Turn, is_alone: bool) -> str:
    """What to give, where there is an option for it."""
    _, scan = log.scans_by_lidar()[frame][0]
    turned_rad = turn.quarters * _QUARTER_RAD
    if turn.is_mirrored and not frame:
        angle_min_rad = wrap_angle(turned_rad - scan.angle_min_rad)
        return (
            f"--angle-min {angle_min_rad:.4f} --angle-increment "
            f"{-scan.angle_increment_rad:.6g} say so"
        )
    if turn.is_mirrored or not is_alone:
        return "the bag's transforms should say how it is mounted"
    mount = base_from_scan or scan.base_from_scan or BASE_FROM_SCAN
    yaw_rad = wrap_angle(mount.yaw_rad + turned_rad)
    return f"--lidar {mount.x_m:g} {mount.y_m:g} {yaw_rad:.4f} says so"

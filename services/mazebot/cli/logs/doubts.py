"""What is doubtful of a log's odometry, before any scan is matched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mazebot.cli.logs.log import Log
from mazebot.common.maths.frames import Array

_CLOCKS_APART_S = 0.2
"""More than a message is longer on its way than another."""
_SAME = 1e-3
"""m or rad; of odometry that moves, some poses are farther apart."""
_ASIDE_M = 0.3
"""A way that leaves a line by as much turns."""
_OTHER_M, _OTHER_SHARE, _MOST_BEAMS = 0.2, 0.1, 0.5
"""So much a beam changes that sees something else; people change fewer of them."""


def doubts_of_odometry(log: Log) -> list[str]:
    """Stamps of another clock than the scans', and poses that never move or turn while the robot
    must have, each in one line.
    """
    found = []
    if abs(log.scans_later_s) > _CLOCKS_APART_S:
        how = "later" if log.scans_later_s > 0.0 else "earlier"
        found.append(
            f"scans are stamped {_duration(abs(log.scans_later_s))} {how} than odometry by when "
            "they were logged: are these the clocks of two machines?"
        )
    source = f" on {log.odometry_source}" if log.odometry_source else ""
    poses = log.odometry()[:, 1:]
    if len(poses) < 2 or np.ptp(poses[:, 2]) > _SAME:
        return found
    if _aside_m(poses[:, :2]) > _ASIDE_M:
        found.append(f"odometry{source} never turns, but its way does{_others(log)}")
    elif (np.ptp(poses, axis=0) <= _SAME).all() and _scans_differ(log):
        found.append(f"odometry{source} never moves, but the scans show a way{_others(log)}")
    return found


def _others(log: Log) -> str:
    topics = ", ".join(log.odometry_topics)
    return f": --odom-topic may be another, one of {topics}" if topics else ""


def _aside_m(places_m: Array) -> float:
    """How far places (n, 2) are from the line through the first and the one farthest from it."""
    # Numbers may be as large as there are.
    with np.errstate(over="ignore", invalid="ignore"):
        way_m = places_m - places_m[0]
        away_m = np.hypot(way_m[:, 0], way_m[:, 1])
        x, y = way_m[away_m.argmax()] / max(float(away_m.max()), _SAME)
        return float(np.abs(x * way_m[:, 1] - y * way_m[:, 0]).max())


def _scans_differ(log: Log) -> bool:
    """Whether most beams of a scan are not as they were in the lidar's first."""
    return any(
        _differ(scans[0][1].ranges_m, scan.ranges_m)
        for scans in log.scans_by_lidar().values()
        for _, scan in scans[1:]
    )


def _differ(before_m: NDArray[np.float32], ranges_m: NDArray[np.float32]) -> bool:
    if len(before_m) != len(ranges_m) or not len(before_m):
        return False
    with np.errstate(over="ignore", invalid="ignore"):
        away_m = np.abs(ranges_m - before_m)
        return bool((away_m > _OTHER_M + _OTHER_SHARE * before_m).mean() > _MOST_BEAMS)


def _duration(s: float) -> str:
    for unit_s, unit in ((86_400.0, "days"), (3_600.0, "h")):
        if s >= 2.0 * unit_s:
            return f"{s / unit_s:.1f} {unit}"
    return f"{s:.2f} s"

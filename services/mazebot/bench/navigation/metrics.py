"""The metrics of a drive, computed from true poses, contacts and claimed poses alone."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mazebot.common.maths.frames import Array, wrap_angle
from mazebot.recorder.judging.poses.consistency import inside_95_percent

BARN_SPEED_M_S = 2.0
"""Speed of BARN's Jackal, by which the published score takes its optimal time."""
JITTER_M = 2e-3
"""Shorter displacements are jitter of a robot at rest, and not driven distance."""
CONTROL_HZ = 20.0
EPISODE_S = 1.0
"""Contacts nearer in time than this are one."""
MOVES_M_S = 0.02
"""A contact is the robot's if it moved toward the thing faster than this."""


class ErrorFigures(NamedTuple):
    """Localisation errors of one drive."""

    metres: Array
    radians: Array
    inside: Array
    """bool: the true pose is inside the claimed 95 % ellipse"""


def spl(success: bool, driven_m: float, shortest_m: float | None) -> float | None:
    """Success weighted by path length, https://arxiv.org/abs/1807.06757: success x shortest /
    max(driven, shortest); None where there is no shortest path.
    """
    if shortest_m is None:
        return None
    longest_m = max(driven_m, shortest_m)
    return float(success) * (shortest_m / longest_m if longest_m > 0.0 else 1.0)


def driven_m(places_m: Array) -> float:
    """Length of the path through (n, 2) true places, without jitter."""
    total, last = 0.0, None
    for place in places_m.tolist():
        if last is None:
            last = place
        elif (step := math.dist(last, place)) >= JITTER_M:
            total += step
            last = place
    return total


def jerk(times_s: Array, speeds: Array) -> float | None:
    """Mean |second difference of the speed / dt^2| at 20 Hz after a mean of five; None of a
    drive that is too short.
    """
    grid = np.arange(times_s[0], times_s[-1], 1.0 / CONTROL_HZ) if len(times_s) else times_s
    if len(grid) < 8:
        return None
    smooth = np.convolve(np.interp(grid, times_s, speeds), np.full(5, 0.2), "valid")
    return float(np.abs(np.diff(smooth, 2)).mean() * CONTROL_HZ**2)


def irregularity(yaws_rad: Array, length_m: float) -> float | None:
    """Sum of |change of heading| over the driven length, rad/m; None for a robot that stood."""
    if length_m < 0.05 or len(yaws_rad) < 2:
        return None
    return float(np.abs(np.diff(np.unwrap(yaws_rad))).sum() / length_m)


def barn_score(success: bool, time_s: float, shortest_m: float | None, speed_m_s: float) -> float:
    """BARN's score as published since 2023: success x OT / clip(AT, 2 OT, 8 OT), where the optimal
    time OT is the shortest path at a speed, and AT the time taken: at most 0.5.
    """
    if not success or not shortest_m:
        return 0.0
    optimal_s = shortest_m / speed_m_s
    return optimal_s / min(max(time_s, 2.0 * optimal_s), 8.0 * optimal_s)


def episodes(times_s: list[float]) -> int:
    """Number of contacts, those within a second of the last joined."""
    count, last_s = 0, -math.inf
    for time_s in sorted(times_s):
        count += time_s - last_s > EPISODE_S
        last_s = time_s
    return count


def localisation_errors(claims: Array, truth: Array) -> ErrorFigures:
    """Errors of claimed poses against true ones.

    Args:
        claims: (n, 13) time, x, y, yaw, and the (3, 3) covariance of these, row by row.
        truth: (m, 4 or more) time, x, y, yaw ..., in order of time.
    """
    if not len(claims) or not len(truth):
        return ErrorFigures(np.empty(0), np.empty(0), np.empty(0, bool))
    times_s = claims[:, 0]
    known = (times_s >= truth[0, 0] - 0.05) & (times_s <= truth[-1, 0] + 0.05)
    claims, times_s = claims[known], times_s[known]
    yaw = np.interp(times_s, truth[:, 0], np.unwrap(truth[:, 3]))
    x, y = (np.interp(times_s, truth[:, 0], truth[:, column]) for column in (1, 2))
    turn = np.array([wrap_angle(one) for one in (claims[:, 3] - yaw).tolist()])
    error = np.stack([claims[:, 1] - x, claims[:, 2] - y, turn], axis=1)
    inside = [
        inside_95_percent(*one) for one in zip(error, claims[:, 4:].reshape(-1, 3, 3), strict=True)
    ]
    return ErrorFigures(np.hypot(error[:, 0], error[:, 1]), np.abs(turn), np.array(inside, bool))


def percentile(values: Array, share: float) -> float | None:
    """A percentile; None of nothing."""
    return float(np.percentile(values, share)) if len(values) else None


def mean(values: Array) -> float | None:
    """The mean; None of nothing."""
    return float(values.mean()) if len(values) else None

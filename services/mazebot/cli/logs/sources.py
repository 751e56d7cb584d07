"""Whether odometry's own topic or `/tf` says how the robot moved, where a bag has both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mazebot.cli.logs.stamps import Told
from mazebot.common.maths.frames import Array

_STILL, _MOVED = 1e-3, 0.1
"""m or rad: poses that differ by less are the same, those that do by more are not."""
_LEAST_COVERED = 0.5
"""Of the time of the scans."""


def is_doubtful(odometry: Sequence[Told], scans: Sequence[Told]) -> bool:
    """Whether another source of poses may be better: these do not move, or not turn, or are missing
    for most of the scans. What they say has `odom_from_frame`, (4, 4).
    """
    return bool((_extents(odometry) <= _STILL).any()) or _covered(odometry, scans) < _LEAST_COVERED


def why_unused(odometry: Sequence[Told], others: Sequence[Told], scans: Sequence[Told]) -> str:
    """What odometry lacks, which other poses have; empty: nothing."""
    if not odometry or not others:
        return ""
    covered = _covered(odometry, scans)
    if covered < min(_LEAST_COVERED, _covered(others, scans)):
        return f"is there for {100.0 * covered:.0f} % of the scans' time"
    moves_m, turns_rad = (_extents(odometry) <= _STILL) & (_extents(others) > _MOVED)
    if moves_m:
        return "does not move"
    if turns_rad:
        return "does not turn"
    return ""


def _extents(poses: Sequence[Told]) -> Array:
    """(2,) how far they are from each other, m, and how much they turn, rad."""
    if not poses:
        return np.zeros(2)
    matrices: Array = np.array([told.says.odom_from_frame for told in poses])
    yaws_rad = np.unwrap(np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0]))
    return np.array([np.ptp(matrices[:, :2, 3], axis=0).max(), np.ptp(yaws_rad)])


def _covered(poses: Sequence[Told], scans: Sequence[Told]) -> float:
    """The share of the scans' time in which there are poses, by when they were logged."""
    if not poses or not scans or scans[-1].log_ns <= scans[0].log_ns:
        return float(bool(poses))
    begin_ns = max(poses[0].log_ns, scans[0].log_ns)
    end_ns = min(poses[-1].log_ns, scans[-1].log_ns)
    return max(0.0, (end_ns - begin_ns) / (scans[-1].log_ns - scans[0].log_ns))

"""The error of a trajectory by the relations of its poses, as the public logs are judged by.

Kuemmerle et al., "On measuring the accuracy of SLAM algorithms", Autonomous Robots 27, 2009: what
is known is not where the robot was, but how poses close to each other lay. The errors are those of
Cartographer's compute_relations_metrics, so that they can be held against its figures.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mazebot.common.config import ConfigError
from mazebot.common.files.limits import MAX_DOCUMENT_BYTES
from mazebot.common.files.reading import NotReadableError, read_limited, reason
from mazebot.common.maths.frames import Array, wrap_angles

_COLUMNS = 8
_OUTSIDE_S = 0.5
"""A relation this far beyond the trajectory's ends is held against the pose at the end."""

_AT_SCAN_S = 0.05
"""A time this near to a scan's is the scan's."""


@dataclass(frozen=True)
class Relations:
    """Known poses of the robot at `to_s` in its frame at `from_s`."""

    from_s: Array
    to_s: Array
    relative: Array
    """(n, 3) x, y, yaw"""


@dataclass(frozen=True)
class RelationErrors:
    """Means and standard deviations of the errors of `used` relations."""

    used: int
    left_out: int
    """Relations at times that the trajectory does not have."""
    between: int
    """Of the used, those at times between scans: the pose there is odometry's from scan to scan."""
    translation_m: tuple[float, float]
    translation_squared_m2: tuple[float, float]
    rotation_deg: tuple[float, float]
    rotation_squared_deg2: tuple[float, float]

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "used": self.used,
            "left_out": self.left_out,
            "between_scans": self.between,
            **{
                name: {"mean": mean, "std": std}
                for name, (mean, std) in (
                    ("translation_m", self.translation_m),
                    ("translation_squared_m2", self.translation_squared_m2),
                    ("rotation_deg", self.rotation_deg),
                    ("rotation_squared_deg2", self.rotation_squared_deg2),
                )
            },
        }


def read_relations(path: Path) -> Relations:
    """Read a file of relations: `timestamp1 timestamp2 x y z roll pitch yaw` on each line.

    Raises ConfigError with one line that names file, line and what is wrong.
    """
    rows = []
    try:
        data = read_limited(path, MAX_DOCUMENT_BYTES)
    except (OSError, NotReadableError) as error:
        raise ConfigError(f"--relations: {path}: {reason(error)}") from error
    for number, line in enumerate(io.TextIOWrapper(io.BytesIO(data), "utf-8", "replace"), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        if len(values) != _COLUMNS or not all(map(math.isfinite, values)):
            raise ConfigError(
                f"--relations: {path}:{number}: {line.strip()!r:.60}: must be 8 numbers: "
                "timestamp1 timestamp2 x y z roll pitch yaw"
            )
        rows.append(values)
    if not rows:
        raise ConfigError(f"--relations: {path}: has no relations")
    table = np.array(rows)
    return Relations(table[:, 0], table[:, 1], table[:, [2, 3, 7]])


def relation_errors(
    times_s: Array, poses: Array, relations: Relations, odometry: Array | None = None
) -> RelationErrors:
    """The errors of a trajectory: (n,) growing times and (n, 3) poses x, y, yaw.

    `odometry`: (k, 4) growing times and poses of odometry. A pose between two of the trajectory
    moves as odometry does, or evenly without it. Raises ConfigError where fewer than two relations
    lie within the trajectory's times.
    """
    begin, end = times_s[0] - _OUTSIDE_S, times_s[-1] + _OUTSIDE_S
    both = np.stack([relations.from_s, relations.to_s])
    within = ((both >= begin) & (both <= end)).all(axis=0)
    used = int(within.sum())
    if used < 2:
        raise ConfigError(
            f"--relations: {used} of {len(within)} are within the time of the log, "
            f"{times_s[0]:.3f} to "
            f"{times_s[-1]:.3f} s: must be at least 2"
        )
    a, b = (
        _at(times_s, poses, one[within], odometry) for one in (relations.from_s, relations.to_s)
    )
    away_s = np.max([_from_scan_s(times_s, one[within]) for one in both], axis=0)
    error = _joined(_joined(_inverse(a), b), _inverse(relations.relative[within]))
    translation = np.hypot(error[:, 0], error[:, 1])
    rotation = np.degrees(np.abs(wrap_angles(error[:, 2])))
    return RelationErrors(
        used,
        len(within) - used,
        int((away_s > _AT_SCAN_S).sum()),
        _mean_and_std(translation),
        _mean_and_std(translation**2),
        _mean_and_std(rotation),
        _mean_and_std(rotation**2),
    )


def _from_scan_s(times_s: Array, wanted_s: Array) -> Array:
    """(m,) how far each time is from the nearest of the trajectory's."""
    after = np.searchsorted(times_s, wanted_s).clip(1, max(len(times_s) - 1, 1))
    nearest = times_s[np.stack([after - 1, after.clip(0, len(times_s) - 1)])]
    return np.asarray(np.abs(nearest - wanted_s).min(axis=0))


def _at(times_s: Array, poses: Array, wanted_s: Array, odometry: Array | None) -> Array:
    """(m, 3) poses at times."""
    if odometry is None or len(times_s) < 2:
        return _evenly(times_s, poses, wanted_s)
    wanted_s = wanted_s.clip(times_s[0], times_s[-1])
    after = np.searchsorted(times_s, wanted_s).clip(1, len(times_s) - 1)
    before = after - 1
    odom = [
        _evenly(odometry[:, 0], odometry[:, 1:], one)
        for one in (times_s[before], wanted_s, times_s[after])
    ]
    # What odometry says from the scan before and from the one after, the nearer counts more.
    ahead = _joined(poses[before], _joined(_inverse(odom[0]), odom[1]))
    back = _joined(poses[after], _joined(_inverse(odom[2]), odom[1]))
    share = ((wanted_s - times_s[before]) / (times_s[after] - times_s[before]))[:, None]
    off = back - ahead
    off[:, 2] = wrap_angles(off[:, 2])
    return np.asarray(ahead + share * off)


def _evenly(times_s: Array, poses: Array, wanted_s: Array) -> Array:
    yaws = np.unwrap(poses[:, 2])
    columns = (poses[:, 0], poses[:, 1], yaws)
    return np.stack([np.interp(wanted_s, times_s, column) for column in columns], axis=1)


def _joined(a: Array, b: Array) -> Array:
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    x = a[:, 0] + c * b[:, 0] - s * b[:, 1]
    y = a[:, 1] + s * b[:, 0] + c * b[:, 1]
    return np.stack([x, y, a[:, 2] + b[:, 2]], axis=1)


def _inverse(a: Array) -> Array:
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    x = -c * a[:, 0] - s * a[:, 1]
    y = s * a[:, 0] - c * a[:, 1]
    return np.stack([x, y, -a[:, 2]], axis=1)


def _mean_and_std(values: Array) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1))

"""Odometry that moves farther between two neighbouring poses than any robot does."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mazebot.cli.logs.log import Entry, Log, OdometryJump
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, Array, wrap_angle, wrap_angles

_JUMP_M, _JUMP_M_S = 0.3, 5.0
_JUMP_RAD, _JUMP_RAD_S = 0.5, 10.0
"""No robot makes a larger step that is so fast, or so much faster than the one before or after."""
_FASTER, _MOST_OTHERS = 1.5, 0.8
"""It is also so fast compared with most around: logs may be in millimetres, or of a car."""
_LEAST_POSES = 3
_AROUND = 5
"""Poses before and after of which the time between two is the mean: single stamps are rounded."""
_HELD_S = 0.5
"""A pose that comes again within this time may be told late: the next step makes up for it."""
_MOST_STEP_S = 0.5
"""Of odometry that comes more rarely, mapping judges the steps by the scans."""
_RECENT_S, _MOST_ENDS = 2.0, 4
"""Of the ways that a pose may go on from, other than from the pose before it."""
_NEARER = 0.5
_MIXED, _LEAST_RETURNS = 0.05, 5
"""So many poses that go on from an earlier one are of a second source of odometry."""


def without_jumps(path: Path, log: Log) -> Log:
    """The log with odometry that goes on over its jumps as it moved before them.

    Raises ConfigError with one line where odometry jumps there and back all the time: it is that of
    two sources.
    """
    timed = [
        (entry.stamp_ns, entry.odom_from_base)
        for entry in log.entries
        if entry.odom_from_base is not None
    ]
    if len(timed) < _LEAST_POSES:
        return log
    times_s = np.array([stamp_ns - timed[0][0] for stamp_ns, _ in timed]) * 1e-9
    poses = [pose for _, pose in timed]
    kept = _moved(times_s, poses)
    if len(kept) < _LEAST_POSES:
        return log
    steps = _Steps(times_s[kept], [poses[i] for i in kept])
    returns = steps.returns()
    if returns >= max(_LEAST_RETURNS, _MIXED * len(kept)):
        raise ConfigError(f"--log: {path}: {_mixed(log, returns, len(kept))}")
    jumps = steps.jumps()
    if not jumps:
        return log
    after = [kept[step + 1] for step in jumps]
    ongoing = iter(_ongoing(times_s, poses, frozenset(after)))
    return replace(
        log,
        entries=[
            entry if entry.odom_from_base is None
            else Entry(entry.stamp_ns, next(ongoing), entry.scan)
            for entry in log.entries
        ],
        odometry_jumps=tuple(
            OdometryJump(timed[i][0], float(steps.ways_m[step]), float(steps.turns_rad[step]))
            for i, step in zip(after, jumps, strict=True)
        ),
    )  # fmt: skip


def _moved(times_s: Array, poses: Sequence[SE2]) -> list[int]:
    """Indices of the poses other than those that are the same as one shortly before."""
    kept = [0]
    for i in range(1, len(poses)):
        if poses[i] != poses[kept[-1]] or times_s[i] - times_s[kept[-1]] >= _HELD_S:
            kept.append(i)
    return kept


class _Steps:
    """The n - 1 steps between n poses."""

    def __init__(self, times_s: Array, poses: Sequence[SE2]) -> None:
        self._times_s, self._poses = times_s, poses
        count = len(poses) - 1
        begin = np.maximum(np.arange(count) - _AROUND, 0)
        end = np.minimum(np.arange(count) + 1 + _AROUND, count)
        self._usual_s = (times_s[end] - times_s[begin]) / (end - begin)
        between_s = np.maximum(np.diff(times_s), self._usual_s)
        # Without times there are no speeds.
        self._between_s = np.where(between_s > 0.0, between_s, np.inf)
        # What is not finite is no jump.
        with np.errstate(over="ignore", invalid="ignore"):
            self._steps = np.diff(np.array(poses), axis=0)
            self._steps[:, 2] = wrap_angles(self._steps[:, 2])
            self.ways_m = np.hypot(self._steps[:, 0], self._steps[:, 1])
        self.turns_rad = self._steps[:, 2]

    def jumps(self) -> list[int]:
        """Indices of the steps that are not as those around, where odometry comes often."""
        with np.errstate(over="ignore", invalid="ignore"):
            velocities = self._steps / self._between_s[:, None]
            found = self._odd(velocities[:, :2], _JUMP_M, _JUMP_M_S)
            found |= self._odd(velocities[:, 2:], _JUMP_RAD, _JUMP_RAD_S)
        return sorted(found)

    def _odd(self, velocities: Array, least: float, least_per_s: float) -> set[int]:
        changes = np.linalg.norm(np.diff(velocities, axis=0), axis=1)
        inf = np.full(1, np.inf)
        odd = np.minimum(np.concatenate([inf, changes]), np.concatenate([changes, inf]))
        is_odd = (odd > least_per_s) & (odd * self._between_s > least)
        speeds = np.linalg.norm(velocities, axis=1)
        found = set()
        for step in np.flatnonzero(is_odd & (self._usual_s <= _MOST_STEP_S)).tolist():
            around = [*speeds[max(step - _AROUND, 0) : step], *speeds[step + 1 :][:_AROUND]]
            if odd[step] > _FASTER * float(np.quantile(around, _MOST_OTHERS)):
                found.add(step)
        return found

    def returns(self) -> int:
        """How often a pose after an impossible step goes on from the last one before another."""
        most_m, most_rad = _JUMP_M_S * self._between_s, _JUMP_RAD_S * self._between_s
        are_fast = self.ways_m > np.maximum(_JUMP_M, most_m)
        are_fast |= np.abs(self.turns_rad) > np.maximum(_JUMP_RAD, most_rad)
        ends: deque[int] = deque(maxlen=_MOST_ENDS)
        count = 0
        for before in np.flatnonzero(are_fast).tolist():
            end = next((end for end in ends if self._goes_on(end, before)), None)
            if end is not None:
                ends.remove(end)
                count += 1
            ends.append(before)
        return count

    def _goes_on(self, end: int, before: int) -> bool:
        """Whether the pose after this one goes on from that at `end`, by far more than from it."""
        after = self._poses[before + 1]
        after_s = float(self._times_s[before + 1] - self._times_s[end])
        within_m, within_rad = _JUMP_M_S * after_s, _JUMP_RAD_S * after_s
        return (
            after_s < _RECENT_S
            and self._poses[end].is_near(after, max(_JUMP_M, within_m), max(_JUMP_RAD, within_rad))
            and _away(self._poses[end], after) < _NEARER * _away(self._poses[before], after)
        )


def _away(pose: SE2, other: SE2) -> float:
    """Ways and turns together: a radian counts as much as a metre."""
    return pose.distance_m(other) + abs(wrap_angle(other.yaw_rad - pose.yaw_rad))


def _ongoing(times_s: Array, poses: Sequence[SE2], jumps: frozenset[int]) -> list[SE2]:
    """The poses with the same steps, but those to these indices, which are as those before."""
    ongoing, moved = [poses[0]], None
    for i in range(1, len(poses)):
        if i in jumps:
            moved = ongoing[-1] @ _step_of_before(times_s[: i + 1], ongoing) @ poses[i].inverse()
        ongoing.append(poses[i] if moved is None else moved @ poses[i])
    return ongoing


def _step_of_before(times_s: Array, poses: Sequence[SE2]) -> SE2:
    """The step from the last of n poses to the last of n + 1 times, at the speed of just before."""
    step_s = float(times_s[-1] - times_s[-2])
    last = len(poses) - 1
    first = int(np.searchsorted(times_s[:-1], times_s[-2] - step_s, side="right")) - 1
    if first < 0 or first == last:
        return SE2(0.0, 0.0, 0.0)
    share = step_s / float(times_s[last] - times_s[first])
    x_m, y_m, yaw_rad = poses[first].inverse() @ poses[last]
    return SE2(x_m * share, y_m * share, wrap_angle(yaw_rad) * share)


def _mixed(log: Log, returns: int, poses: int) -> str:
    where = f" on {log.odometry_source}" if log.odometry_source else ""
    remedy = "must be of one source"
    if log.odometry_topics:
        remedy = f"--odom-topic must be another, one of {', '.join(log.odometry_topics)}"
    elif log.odometry_source:
        remedy = "one node alone must publish it, and the bag has no other"
    return (
        f"two odometries are mixed{where}: {returns} of {poses} poses go on from an earlier one, "
        f"and are too far from the one before: {remedy}"
    )

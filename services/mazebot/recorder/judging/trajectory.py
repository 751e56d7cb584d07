"""Errors of an estimated path against the true one, as in Sturm et al. (IROS 2012)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.documents import TrajectoryError

RELATIVE_M = 1.0
"""Driven length over which the relative error is measured."""
_MOST = 8192
"""Poses kept. When they are full, every second one is dropped, and from then on not taken."""


class RelativeError(NamedTuple):
    """Of a path's pieces, each about RELATIVE_M long."""

    apart_m: Array
    """(n,)"""
    turned_rad: Array
    """(n,)"""


class Trajectory:
    """Estimated poses with the true ones at the same times, evenly thinned where there are many."""

    def __init__(self) -> None:
        self._rows = np.empty((_MOST, 6))
        """Estimated x, y (m), yaw (rad), and the true ones"""
        self._count = 0
        self._every = 1
        self._skipped = 0

    def add(self, estimate: SE2, truth: SE2) -> None:
        """Add a pose, map from base_footprint, newer than all before."""
        self._skipped += 1
        if self._skipped < self._every:
            return
        if self._count == len(self._rows):
            # The newest row stays, and this pose comes half of the new interval after it.
            self._count = len(self._rows) // 2
            self._rows[: self._count] = self._rows[1::2].copy()
            self._every *= 2
            return
        self._skipped = 0
        self._rows[self._count] = (*estimate, *truth)
        self._count += 1

    @property
    def estimates(self) -> Array:
        """(n, 3) x, y (m), yaw (rad)."""
        return self._rows[: self._count, :3]

    @property
    def truths(self) -> Array:
        """(n, 3) likewise."""
        return self._rows[: self._count, 3:]

    def state(self) -> dict[str, NDArray[Any]]:
        """The path so far, for `restore()`."""
        thinning = np.array([self._every, self._skipped])
        return {"rows": self._rows[: self._count], "thinning": thinning}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a saved path. Raises ValueError, KeyError, TypeError if it is invalid."""
        rows = state["rows"].reshape(-1, 6)
        self._rows[: len(rows)] = rows
        self._count = len(rows)
        self._every, self._skipped = (int(value) for value in state["thinning"])


def summed_up(errors: Array) -> TrajectoryError:
    """Of errors (n,) that are not negative."""
    if not len(errors):
        return TrajectoryError()
    return TrajectoryError(
        rmse=float(np.sqrt(np.mean(errors**2))),
        p95=float(np.percentile(errors, 95)),
        max=float(errors.max()),
    )


def absolute_error_m(estimates: Array, truths: Array) -> Array:
    """(n,) distances between estimated and true poses (n, 2 or more)."""
    return np.asarray(np.linalg.norm(estimates[:, :2] - truths[:, :2], axis=1))


def aligned(estimates: Array, truths: Array) -> Array:
    """(n, 2): estimated positions after the rotation and shift by which they fit the true ones with
    the least sum of squares (Umeyama, PAMI 1991, in the plane and without a scale).
    """
    if not len(estimates):
        return np.zeros((0, 2))
    here, there = estimates[:, :2].mean(axis=0), truths[:, :2].mean(axis=0)
    a, b = estimates[:, :2] - here, truths[:, :2] - there
    turn = np.arctan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    c, s = np.cos(turn), np.sin(turn)
    return np.asarray(a @ np.array([[c, s], [-s, c]]) + there)


def relative_error(estimates: Array, truths: Array, over_m: float = RELATIVE_M) -> RelativeError:
    """Errors of the motion from each pose (n, 3) to the first that is at least `over_m` further
    along the true path.
    """
    steps_m = np.linalg.norm(np.diff(truths[:, :2], axis=0), axis=1)
    driven_m = np.concatenate([[0.0], np.cumsum(steps_m)])[: len(truths)]
    end = np.searchsorted(driven_m, driven_m + over_m - 1e-9)
    start = np.flatnonzero(end < len(truths))
    end = end[start]
    one, other = (_motion(poses[start], poses[end]) for poses in (estimates, truths))
    turned = one[:, 2] - other[:, 2]
    return RelativeError(
        np.linalg.norm(one[:, :2] - other[:, :2], axis=1),
        np.abs((turned + np.pi) % (2.0 * np.pi) - np.pi),
    )


def _motion(start: Array, end: Array) -> Array:
    """(n, 3) poses of `end` in the frames of `start`."""
    apart = end - start
    c, s = np.cos(start[:, 2]), np.sin(start[:, 2])
    return np.stack(
        [c * apart[:, 0] + s * apart[:, 1], c * apart[:, 1] - s * apart[:, 0], apart[:, 2]], axis=1
    )

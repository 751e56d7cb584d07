"""The robot's true pose and driven distance at any time of a run."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.recorder.judging.recent_rows import RecentRows

JITTER_M = 2e-3
"""Displacements shorter than this are jitter of a robot at rest, and not driven distance."""

_RECENT = 1800
"""Newest poses, a minute's, kept at full rate; of older ones,"""
_OLD_PERIOD_NS = 500_000_000
"""one per this period is kept: a robot that can reach 0.5 m/s within a second is off the line
between two of them by less than 2 cm;"""
_LONGEST_GAP_NS = 2 * _OLD_PERIOD_NS
"""Upper bound of the interval between two poses of which one per that period is kept."""
_OLD_AGE_NS = 3_600_000_000_000
"""of those older than this, the interval between two is at most"""
_OLD_SHARE = 1 / 900
"""this share of their age: fewer with each doubling of it, so that a run of days takes little more
memory than one of hours.
"""
_AGED = 600
"""Number of poses that exceed that age before they are thinned again."""


class _Piece(NamedTuple):
    """A part of the driven path."""

    stamps_ns: NDArray[np.int64]
    poses: Array
    """(n, 4): x and y (m), yaw (rad) without jumps, and length (m)"""

    @property
    def start_ns(self) -> int:
        return int(self.stamps_ns[0])

    @property
    def end_ns(self) -> int:
        return int(self.stamps_ns[-1])

    def rows(self, part: slice | NDArray[np.int64]) -> _Piece:
        return _Piece(self.stamps_ns[part], self.poses[part])


class DrivenWay:
    """The true poses of a run in order of time, and the length of the path through them.

    Older poses lie in pieces that are not changed for an hour: arrays that grow with the run would
    be reallocated again and again, and fragment the heap.
    """

    def __init__(self) -> None:
        self.total_m = 0.0
        self._counted_xy: tuple[float, float] | None = None
        self._recent = RecentRows(4, _RECENT, 2 * _RECENT)
        self._pieces: list[_Piece] = []

    def add(self, stamp_ns: int, pose: SE2) -> None:
        """Add a true pose, newer than all before."""
        if self._counted_xy is None:
            self._counted_xy = pose.x_m, pose.y_m
        step_m = math.dist(self._counted_xy, pose[:2])
        if step_m >= JITTER_M:
            self.total_m += step_m
            self._counted_xy = pose.x_m, pose.y_m
        yaw_rad, before = pose.yaw_rad, self._recent.rows[-1:, 2]
        if len(before):
            yaw_rad = float(before[0]) + wrap_angle(yaw_rad - float(before[0]))
        if self._recent.is_full:
            self._put_away()
        self._recent.add(stamp_ns, (pose.x_m, pose.y_m, yaw_rad, self.total_m))

    def at(self, stamp_ns: int) -> tuple[SE2, float] | None:
        """Interpolated pose and driven length (m) at a time; outside the recorded range, the first
        or last one. None if there are no poses.
        """
        around = self._around(stamp_ns)
        if around is None:
            return None
        x_m, y_m, yaw_rad, length_m = (
            float(np.interp(stamp_ns, around.stamps_ns, column)) for column in around.poses.T
        )
        return SE2(x_m, y_m, wrap_angle(yaw_rad)), length_m

    def is_known(self, stamp_ns: int) -> bool:
        """Whether the pose at a time is known, as far as the recorded range goes: it is not inside
        a gap of over a second, such as a recorder leaves that died and was restarted.
        """
        around = self._around(stamp_ns)
        if around is None:
            return False
        before, after = around.stamps_ns[around.stamps_ns <= stamp_ns], around.stamps_ns
        gap_ns = int(after[len(before)] - before[-1]) if 0 < len(before) < len(after) else 0
        return stamp_ns in before or gap_ns <= _LONGEST_GAP_NS

    def state(self) -> dict[str, NDArray[Any]]:
        """The path so far, for `restore()`."""
        stamps_ns, poses = _joined([*self._pieces, self._recent_piece()])
        return {"stamps_ns": stamps_ns, "poses": poses}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a saved path. Raises ValueError, KeyError, TypeError if it is invalid."""
        piece = _Piece(state["stamps_ns"].astype(np.int64), state["poses"].reshape(-1, 4))
        if not len(piece.stamps_ns):
            return
        if len(piece.stamps_ns) > 1:
            self._pieces.append(piece.rows(slice(-1)))
        x_m, y_m, yaw_rad, self.total_m = (float(value) for value in piece.poses[-1])
        self._counted_xy = x_m, y_m
        self._recent.add(int(piece.stamps_ns[-1]), (x_m, y_m, yaw_rad, self.total_m))

    def _around(self, stamp_ns: int) -> _Piece | None:
        """The poses next to a time, two or three of them, or fewer at an end of the range; None if
        there are no poses.
        """
        recent = self._recent_piece()
        if not len(recent.stamps_ns):
            return None
        pieces = [*self._pieces, recent]
        after = bisect_right(pieces, stamp_ns, key=lambda piece: piece.start_ns)
        piece, *others = pieces[max(after - 1, 0) : after + 1]
        row = max(int(np.searchsorted(piece.stamps_ns, stamp_ns)) - 1, 0)
        return _joined(
            [piece.rows(slice(row, row + 2)), *(other.rows(slice(1)) for other in others)]
        )

    def _recent_piece(self) -> _Piece:
        return _Piece(self._recent.stamps_ns, self._recent.rows)

    def _put_away(self) -> None:
        """Thin out the poses that are no longer recent, and those that exceeded the old age."""
        piece = self._recent_piece().rows(slice(_RECENT))
        now_ns = piece.end_ns
        self._pieces.append(_thinned(piece, now_ns))
        old = bisect_right(self._pieces, now_ns - _OLD_AGE_NS, key=lambda piece: piece.end_ns)
        if sum(len(piece.stamps_ns) for piece in self._pieces[1:old]) >= _AGED:
            self._pieces[:old] = [_thinned(_joined(self._pieces[:old]), now_ns)]


def _joined(pieces: Sequence[_Piece]) -> _Piece:
    stamps_ns, poses = zip(*pieces, strict=True)
    return _Piece(np.concatenate(stamps_ns), np.concatenate(poses))


def _thinned(piece: _Piece, now_ns: int) -> _Piece:
    """The first pose of each period, whose length depends on the poses' age."""
    ages_ns = now_ns - piece.stamps_ns
    # More than half of the longest period allowed, since periods double.
    times = np.where(ages_ns > _OLD_AGE_NS, 0.5 * _OLD_SHARE * ages_ns / _OLD_PERIOD_NS, 1.0)
    periods_ns = _OLD_PERIOD_NS << np.ceil(np.log2(times)).astype(np.int64)
    kept = np.flatnonzero(np.diff(piece.stamps_ns // periods_ns, prepend=-1))
    return piece.rows(kept)

"""Rows of numbers over time, in bounded memory: the longer the run, the coarser."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array


class ThinnedRows:
    """At most one row per period, and at most `most` of them: whenever they are full, the period
    doubles, and of two rows that share one then the first is left.
    """

    def __init__(
        self, columns: Sequence[str], period_ns: int, most: int, peaks: str | None = None
    ) -> None:
        """With `peaks`, the name of a column, the row with the greater value is left instead."""
        self.columns = tuple(columns)
        self._peak = None if peaks is None else self.columns.index(peaks)
        self._period_ns = period_ns
        self._count = 0
        self._stamps_ns = np.empty(most, np.int64)
        self._rows = np.empty((most, len(columns)))

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(n,), valid until the next row is added."""
        return self._stamps_ns[: self._count]

    def column(self, name: str) -> Array:
        """(n,), valid until the next row is added."""
        return self._rows[: self._count, self.columns.index(name)]

    def add(self, stamp_ns: int, row: Sequence[float]) -> None:
        """Add a row; one older than the newest is dropped."""
        if self._count:
            last = self._count - 1
            behind = stamp_ns // self._period_ns - int(self._stamps_ns[last]) // self._period_ns
            if behind < 0:
                return
            if behind == 0:
                if self._peak is not None and row[self._peak] > self._rows[last, self._peak]:
                    self._stamps_ns[last] = stamp_ns
                    self._rows[last] = row
                return
        if self._count == len(self._rows):
            self._halve()
            self.add(stamp_ns, row)
            return
        self._stamps_ns[self._count] = stamp_ns
        self._rows[self._count] = row
        self._count += 1

    def _halve(self) -> None:
        self._period_ns *= 2
        starts = np.flatnonzero(np.diff(self.stamps_ns // self._period_ns, prepend=-1))
        kept = starts
        if self._peak is not None:
            # No more than two rows share a period.
            seconds = np.minimum(starts + 1, np.append(starts[1:], self._count) - 1)
            peaks = self._rows[: self._count, self._peak]
            kept = np.where(peaks[seconds] > peaks[starts], seconds, starts)
        self._stamps_ns[: len(kept)] = self._stamps_ns[kept]
        self._rows[: len(kept)] = self._rows[kept]
        self._count = len(kept)

    def state(self) -> dict[str, NDArray[Any]]:
        """The rows so far, for `restore()`."""
        return {
            "stamps_ns": self.stamps_ns,
            "rows": self._rows[: self._count],
            "period_ns": np.array(self._period_ns),
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from saved rows. Raises ValueError, KeyError, TypeError if they are invalid."""
        stamps_ns, period_ns = state["stamps_ns"], int(state["period_ns"])
        if period_ns <= 0:
            raise ValueError(f"period_ns: {period_ns}: must be greater than 0")
        self._stamps_ns[: len(stamps_ns)] = stamps_ns
        self._rows[: len(stamps_ns)] = state["rows"].reshape(-1, len(self.columns))
        self._count, self._period_ns = len(stamps_ns), period_ns

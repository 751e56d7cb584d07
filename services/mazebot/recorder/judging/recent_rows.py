"""The newest rows of numbers, by their stamps, in memory that is allocated once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array


class RecentRows:
    """Holds at least the newest `kept` rows, once that many were added, and at most `capacity`.

    Its arrays are never reallocated: growing ones would be moved again and again, and fragment the
    heap.
    """

    def __init__(self, columns: int, kept: int, capacity: int) -> None:
        self._kept = kept
        self._count = 0
        self._stamps_ns = np.empty(capacity, np.int64)
        self._rows = np.empty((capacity, columns))

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(n,), valid until the next row is added."""
        return self._stamps_ns[: self._count]

    @property
    def rows(self) -> Array:
        """(n, columns), valid until the next row is added."""
        return self._rows[: self._count]

    @property
    def is_full(self) -> bool:
        """Whether adding the next row drops all but the newest `kept`."""
        return self._count == len(self._rows)

    def add(self, stamp_ns: int, row: Sequence[float]) -> None:
        """Add a row."""
        if self.is_full:
            self._let_go()
        self._stamps_ns[self._count] = stamp_ns
        self._rows[self._count] = row
        self._count += 1

    def _let_go(self) -> None:
        """Drop all rows but the newest."""
        space = self._count - self._kept
        for column in (self._stamps_ns, self._rows):
            # In blocks that do not overlap: for overlapping ones NumPy would make a copy.
            for start in range(space, self._count, space):
                block = column[start : start + space]
                column[start - space :][: len(block)] = block
        self._count = self._kept

"""The newest rows of numbers, by their stamps, in memory that is taken once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from services.common.frames import Array


class RecentRows:
    """At least the newest `kept` rows, once as many have come, at most `capacity`.

    Its arrays stay where they are: ones that grew would be moved, again and again, and leave holes
    in the heap.
    """

    def __init__(self, columns: int, kept: int, capacity: int) -> None:
        self._kept = kept
        self._count = 0
        self._stamps_ns = np.empty(capacity, np.int64)
        self._rows = np.empty((capacity, columns))

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(n,), good until the next row comes."""
        return self._stamps_ns[: self._count]

    @property
    def rows(self) -> Array:
        """(n, columns), good until the next row comes."""
        return self._rows[: self._count]

    @property
    def is_full(self) -> bool:
        """Whether the next row is the one for which all but the newest `kept` are let go of."""
        return self._count == len(self._rows)

    def add(self, stamp_ns: int, row: Sequence[float]) -> None:
        """Take in a row."""
        if self.is_full:
            self._let_go()
        self._stamps_ns[self._count] = stamp_ns
        self._rows[self._count] = row
        self._count += 1

    def _let_go(self) -> None:
        """Of all but the newest."""
        space = self._count - self._kept
        for column in (self._stamps_ns, self._rows):
            # In blocks that do not overlap: of two that do, NumPy would make a copy.
            for start in range(space, self._count, space):
                block = column[start : start + space]
                column[start - space :][: len(block)] = block
        self._count = self._kept

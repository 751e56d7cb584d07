"""Mean, 95th percentile and maximum of any number of errors, in bounded memory."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.common.messages.documents import ErrorStatistics

_MOST_KEPT = 5_000
_LEAST = 1e-6
"""Smaller errors count as this."""
_STEP = math.log(1.001)
_SIDE = 144
"""Side of the square of counts: errors above 1,000 are counted together."""


class ErrorSummary:
    """Of errors in any unit. Beyond 5,000 errors the percentile is exact to 0.1 %: they are then
    only counted, by size.
    """

    def __init__(self) -> None:
        self._kept = np.empty(_MOST_KEPT)
        """The first ones, until they are counted by size"""
        self._counts = np.zeros((_SIDE, _SIDE), np.int64)
        """By size, in rows: no array over all sizes is made for a percentile, which is requested
        every second.
        """
        self._count = 0
        self._sum = 0.0
        self._max = 0.0

    def add(self, error: float) -> None:
        """Add an error, not negative."""
        if self._count < len(self._kept):
            self._kept[self._count] = error
        else:
            if self._count == len(self._kept):
                for kept in self._kept.tolist():
                    self._counts[_bin(kept)] += 1
            self._counts[_bin(error)] += 1
        self._count += 1
        self._sum += error
        self._max = max(self._max, error)

    def statistics(self) -> ErrorStatistics:
        """Of all errors so far; each None if there are none."""
        if not self._count:
            return ErrorStatistics()
        if self._count <= len(self._kept):
            p95 = float(np.percentile(self._kept[: self._count], 95))
        else:
            sums = self._counts.sum(axis=1)
            below = np.cumsum(sums)
            row = int(np.searchsorted(below, 0.95 * self._count))
            rest = 0.95 * self._count - float(below[row] - sums[row])
            at = row * _SIDE + int(np.searchsorted(np.cumsum(self._counts[row]), rest))
            p95 = min(_LEAST * math.exp((at + 0.5) * _STEP), self._max)
        return ErrorStatistics(mean=self._sum / self._count, p95=p95, max=self._max)

    def state(self) -> dict[str, NDArray[Any]]:
        """All errors so far, for `restore()`."""
        totals = np.array([self._count, self._sum, self._max])
        return {"kept": self._kept[: self._count], "counts": self._counts, "totals": totals}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a saved state. Raises ValueError, KeyError if it is invalid."""
        count, self._sum, self._max = (float(value) for value in state["totals"])
        self._count = int(count)
        self._kept[: len(state["kept"])] = state["kept"]
        self._counts[:] = state["counts"]


def _bin(error: float) -> tuple[int, int]:
    """Row and column of the bin for its size."""
    size = math.log(max(error, _LEAST) / _LEAST) / _STEP
    return divmod(int(min(size, _SIDE**2 - 1)), _SIDE)

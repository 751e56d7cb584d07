"""Mean, 95th percentile and maximum of any number of errors, in bounded memory."""

from __future__ import annotations

import math
from array import array

import numpy as np
from numpy.typing import NDArray

from services.common.documents import ErrorStatistics

_MOST_KEPT = 5_000
_LEAST = 1e-6
"""Smaller errors count as this."""
_STEP = math.log(1.001)
_SIDE = 144
"""Of the square of counts: above 1,000, all sizes count as one."""


class ErrorSummary:
    """Of errors in whichever unit. Of more than 5,000 the percentile is exact to 0.1 %: the
    earlier ones are only counted, by their size.
    """

    def __init__(self) -> None:
        self._kept = array("d")
        self._counts = np.zeros((0, _SIDE), np.int64)
        """By size, row by row"""
        self._count = 0
        self._sum = 0.0
        self._max = 0.0

    def add(self, error: float) -> None:
        """Take in an error, not negative."""
        self._kept.append(error)
        self._count += 1
        self._sum += error
        self._max = max(self._max, error)
        if len(self._kept) >= _MOST_KEPT:
            if not len(self._counts):
                self._counts = np.zeros((_SIDE, _SIDE), np.int64)
            np.add.at(self._counts, self._bins(), 1)
            self._kept = array("d")

    def statistics(self) -> ErrorStatistics:
        """Of all so far."""
        if not self._count:
            return ErrorStatistics()
        if not len(self._counts):
            p95 = float(np.percentile(np.array(self._kept), 95))
        else:
            # Row sums first: no array of all sizes is made, as one is asked for every second.
            row_of, column_of = self._bins()
            sums = self._counts.sum(axis=1) + np.bincount(row_of, minlength=_SIDE)
            below = np.cumsum(sums)
            row = int(np.searchsorted(below, 0.95 * self._count))
            counts = self._counts[row] + np.bincount(column_of[row_of == row], minlength=_SIDE)
            rest = 0.95 * self._count - float(below[row] - sums[row])
            at = row * _SIDE + int(np.searchsorted(np.cumsum(counts), rest))
            p95 = min(_LEAST * math.exp((at + 0.5) * _STEP), self._max)
        return ErrorStatistics(mean=self._sum / self._count, p95=p95, max=self._max)

    def _bins(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows and columns of those that are kept."""
        sizes = np.maximum(np.array(self._kept), _LEAST) / _LEAST
        bins = np.minimum((np.log(sizes) / _STEP).astype(np.int64), _SIDE**2 - 1)
        return bins // _SIDE, bins % _SIDE

"""Mean, 95th percentile and maximum of any number of errors, in bounded memory."""

from __future__ import annotations

import math
from array import array

import numpy as np

from services.common.documents import ErrorStatistics

_MOST_KEPT = 5_000
_LEAST = 1e-6
"""Smaller errors count as this."""
_STEP = math.log(1.001)
_BINS = math.ceil(math.log(1e9) / _STEP)


class ErrorSummary:
    """Of errors in whichever unit. Of more than 5,000 the percentile is exact to 0.1 %: the
    earlier ones are only counted, by their size.
    """

    def __init__(self) -> None:
        self._kept = array("d")
        self._counts = np.zeros(0, np.int64)
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
            sizes = np.maximum(np.array(self._kept), _LEAST) / _LEAST
            bins = np.minimum((np.log(sizes) / _STEP).astype(np.int64), _BINS - 1)
            if not len(self._counts):
                self._counts = np.zeros(_BINS, np.int64)
            self._counts += np.bincount(bins, minlength=_BINS)
            self._kept = array("d")

    def statistics(self) -> ErrorStatistics:
        """Of all so far."""
        if not self._count:
            return ErrorStatistics()
        if not len(self._counts):
            p95 = float(np.percentile(np.array(self._kept), 95))
        else:
            counts = self._counts.copy()
            sizes = np.maximum(np.array(self._kept), _LEAST) / _LEAST
            np.add.at(counts, np.minimum((np.log(sizes) / _STEP).astype(int), _BINS - 1), 1)
            at = int(np.searchsorted(np.cumsum(counts), 0.95 * self._count))
            p95 = min(_LEAST * math.exp((at + 0.5) * _STEP), self._max)
        return ErrorStatistics(mean=self._sum / self._count, p95=p95, max=self._max)

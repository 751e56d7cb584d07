"""Detects the start of a new run by the simulation's time."""

from __future__ import annotations

from collections.abc import Iterable

NEW_RUN_NS = 1_000_000_000
"""A clock that goes back by more than this belongs to another run."""


class Beginnings:
    """Detects that time goes back: on the clock, or in the simulation's stats.

    The stats show every restart, even one within the first second. The clock may show it earlier or
    later.
    """

    def __init__(self) -> None:
        self.now_ns = 0
        """Time in the current run."""
        self.ended_ns = 0
        """The newest time of the previous run."""
        self._stats_ns: int | None = None
        self._stale_ns: int | None = None

    def look(self, clock_ns: int, stats_ns: Iterable[int]) -> bool:
        """Whether a new run starts, by the clock and the times of the stats received since."""
        if self._stale_ns is not None:
            if clock_ns >= self._stale_ns:
                clock_ns = self.now_ns
            else:
                self._stale_ns = None
        started_ns = None
        for time_ns in stats_ns:
            if self._stats_ns is not None and time_ns < self._stats_ns:
                started_ns = time_ns
            self._stats_ns = time_ns
        if started_ns is None and clock_ns < self.now_ns - NEW_RUN_NS:
            started_ns, self._stats_ns = clock_ns, None
        if started_ns is not None:
            self.ended_ns = self.now_ns
            if clock_ns > (self.ended_ns + started_ns) // 2:
                # The clock will show the new time in a moment.
                self._stale_ns, clock_ns = clock_ns, started_ns
        self.now_ns = clock_ns
        return started_ns is not None

    def is_before(self, sent_ns: int) -> bool:
        """Whether a message, by its send time, belongs to the run before a restart just found."""
        return sent_ns > (self.ended_ns + self.now_ns) // 2

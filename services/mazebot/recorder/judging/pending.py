"""Entries that cannot be judged before the ground truth of their time is known."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

P = TypeVar("P")

_MOST = 1000


class Pending(Generic[P]):
    """Entries with their stamps. Of too many the oldest are dropped."""

    def __init__(self) -> None:
        self._entries: deque[tuple[int, P]] = deque(maxlen=_MOST)

    def __iter__(self) -> Iterator[P]:
        return (entry for _, entry in self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, stamp_ns: int, entry: P) -> None:
        """Add an entry."""
        self._entries.append((stamp_ns, entry))

    def take_until(self, newest_ns: int) -> list[tuple[int, P]]:
        """Remove and return the entries stamped no later than this, with their stamps."""
        ready = [entry for entry in self._entries if entry[0] <= newest_ns]
        if ready:
            waiting = [entry for entry in self._entries if entry[0] > newest_ns]
            self._entries.clear()
            self._entries.extend(waiting)
        return ready

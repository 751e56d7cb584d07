"""When what a node publishes periodically is due."""

from __future__ import annotations


class Schedule:
    """Times of simulation by name, at whole periods."""

    def __init__(self) -> None:
        self._due_ns: dict[str, int] = {}

    def is_due(self, what: str, now_ns: int, period_ns: int) -> bool:
        """Whether it is due; if so, it is next at the beginning of the next period."""
        if now_ns < self._due_ns.get(what, 0):
            return False
        self._due_ns[what] = (now_ns // period_ns + 1) * period_ns
        return True

    def put_off(self, what: str, until_ns: int) -> None:
        """Let it be due at that time."""
        self._due_ns[what] = until_ns

    def clear(self) -> None:
        """Let everything be due at once."""
        self._due_ns.clear()

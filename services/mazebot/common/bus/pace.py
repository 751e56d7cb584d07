"""When the next step is due by the wall clock."""

from __future__ import annotations

MAX_LAG_S = 0.1
"""A lag beyond this is not caught up with: simulation time then runs slower than real time."""


class Pace:
    """Keeps simulation time in step with the wall clock."""

    def __init__(self) -> None:
        self._start_s = 0.0
        self._start_ns = 0
        self._speed: float | None = None

    def rest(self) -> None:
        """Simulation time is stopped: the wall time that passes is not caught up with."""
        self._speed = None

    def wait_s(self, now_s: float, next_ns: int, speed: float) -> float:
        """Seconds from `now_s`, by a steady clock, until the step to `next_ns` is due at `speed`
        simulated seconds a second (0: as fast as possible).
        """
        if speed != self._speed:
            self._start_s, self._start_ns, self._speed = now_s, next_ns, speed
        if speed == 0.0:
            return 0.0
        due_s = self._start_s + (next_ns - self._start_ns) * 1e-9 / speed
        lag_s = now_s - due_s
        if lag_s > MAX_LAG_S:
            self._start_s += lag_s
        return max(-lag_s, 0.0)

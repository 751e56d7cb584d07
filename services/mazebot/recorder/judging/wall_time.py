"""Wall time and real-time factor of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass
class WallTime:
    """Measures between two clock messages, the first and the newest received.

    Both ends are pairs of wall time and the message's own time: the recorder's current time may lag
    behind it, by the whole duration of a simulation that it has just joined.
    """

    pauses: int = 0
    """Number of times the simulation was paused."""
    first: tuple[float, int] | None = None
    """Wall time (s) and clock time (ns) of the first clock message,"""
    newest: tuple[float, int] | None = None
    """and of the newest."""
    paused_since_s: float | None = None
    ended_pauses_s: float = 0.0
    """Wall time of the pauses that have ended,"""
    pauses_before_newest_s: float = 0.0
    """and of those that ended before the newest tick."""

    @classmethod
    def restored(cls, state: Mapping[str, Any]) -> WallTime:
        """A WallTime from the JSON of its `dataclasses.asdict`."""
        pairs = {name: tuple(value) for name, value in state.items() if isinstance(value, list)}
        return cls(**{**state, **pairs})

    def tick(self, wall_s: float, clock_ns: int) -> None:
        """Set the newest clock time."""
        self.newest = wall_s, clock_ns
        self.pauses_before_newest_s = self.ended_pauses_s
        if self.first is None:
            self.first = self.newest

    def pause(self, wall_s: float) -> None:
        """The simulation was paused."""
        if self.paused_since_s is None:
            self.pauses += 1
            self.paused_since_s = wall_s

    def resume(self, wall_s: float) -> None:
        """The simulation was resumed."""
        self.ended_pauses_s = self.paused_s(wall_s)
        self.paused_since_s = None

    def paused_s(self, wall_s: float) -> float:
        """Wall time spent in pauses, from the first tick until now."""
        if self.paused_since_s is None or self.first is None:
            return self.ended_pauses_s
        return self.ended_pauses_s + max(wall_s - max(self.paused_since_s, self.first[0]), 0.0)

    @property
    def ticked(self) -> bool:
        """Whether a clock message was received."""
        return self.first is not None

    @property
    def simulated_s(self) -> float | None:
        """Simulation time between the two clock messages; None before there are two."""
        if self.first is None or self.newest is None or self.newest == self.first:
            return None
        return (self.newest[1] - self.first[1]) * 1e-9

    @property
    def wall_time_s(self) -> float | None:
        """Wall time between the two clock messages, without pauses; None before there are two."""
        if self.first is None or self.newest is None or self.newest == self.first:
            return None
        return max(self.newest[0] - self.first[0] - self.pauses_before_newest_s, 0.0)

    @property
    def real_time_factor(self) -> float | None:
        """Simulation time per wall time; None before any has passed."""
        simulated_s, wall_time_s = self.simulated_s, self.wall_time_s
        if simulated_s is None or not wall_time_s:
            return None
        return simulated_s / wall_time_s

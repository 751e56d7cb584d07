"""A recording to replay: its messages, and what is known about them beforehand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from mazebot.cli.logs.log import set_back_remark
from mazebot.cli.replay.reading.replayed import Replayed
from mazebot.common.config import ConfigError


@dataclass
class Recording:
    """What is known about a recording, and its messages."""

    name: str
    start_ns: int
    """Simulation time at which it begins."""
    end_ns: int
    """Simulation time at which it ends."""
    read: Callable[[], Iterator[Replayed]]
    """Reads its messages from the beginning, in the order in which they stand in its files."""
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """The settings with which each service ran, by name, as far as they were recorded."""
    services: frozenset[str] = frozenset()
    """Those that have sent something."""
    in_one_process: bool = True
    """Whether the services ran in one process, so that nothing came late."""
    pictures: str = "raw"
    """`raw`: as physics has sent them; `jpeg`: compressed, with a loss; `none`."""
    is_run: bool = True
    """Whether Mazebot recorded it; else it is a bag of another robot."""
    unfit: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Messages that are left out, by topic and reason; complete when all have been read."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Topics that are left out as a whole, each with the reason."""
    gap: str = ""
    """What of the run was not recorded, in words; empty: nothing that is known of."""
    unended: str = ""
    """That its recorder has not ended it, and why, in words; empty: it has."""
    faults: tuple[str, ...] = ()
    """What its files lack, or have of another run, in words; empty: nothing that is known of."""
    clock_set_back: int = 0
    """How often its clock was set back; complete when all has been read."""

    def span_ns(self, start_s: float, duration_s: float | None) -> tuple[int, int]:
        """From when to when to replay: simulation time.

        Raises ConfigError where that is after the end.
        """
        start_ns = self.start_ns + round(start_s * 1e9)
        if start_ns > self.end_ns:
            length_s = (self.end_ns - self.start_ns) * 1e-9
            raise ConfigError(f"--start: {start_s:g}: must be at most its length, {length_s:g} s")
        if duration_s is None:
            return start_ns, self.end_ns
        return start_ns, min(start_ns + round(duration_s * 1e9), self.end_ns)

    def lines_of_unfit(self) -> list[str]:
        """What is left out and why, and what is not as it was, a line each."""
        lines = []
        if self.clock_set_back:
            lines.append(set_back_remark(self.clock_set_back))
        lines += [f"left out: {topic}: {reason}" for topic, reason in sorted(self.left_out.items())]
        for (topic, reason), count in sorted(self.unfit.items()):
            what = "message" if count == 1 else "messages"
            lines.append(f"left out: {topic}: {count} {what}: {reason}")
        return lines

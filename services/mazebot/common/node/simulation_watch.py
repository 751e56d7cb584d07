"""Notices a reset of the simulation: time went back, or the epoch or the seed is another one."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from mazebot.common.messages.documents import SimulationStats
from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Inbox

M = TypeVar("M")


class SimulationWatch:
    """What a node knows of the run that it is in."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        """The simulation's seed, as soon as it is known; before, the configured one."""
        self.epoch: int | None = None
        """The current epoch; None before it is known."""
        self._now_ns = 0
        self._begun_ns = 0

    def restarted(self, now_ns: int, news: Iterable[SimulationStats]) -> bool:
        """Whether the simulation was reset since the last step. Call it once in each step, with the
        new messages of SIMULATION_STATS.
        """
        restarted = now_ns < self._now_ns
        if restarted:
            self._begun_ns = 0
        for stats in news:
            if self.epoch is not None and stats.epoch != self.epoch:
                restarted = True
                self._begun_ns = round(stats.sim_time_s * 1e9)
            restarted = restarted or stats.seed != self.seed
            self.epoch, self.seed = stats.epoch, stats.seed
        self._now_ns = now_ns
        return restarted

    def is_of_this_run(self, stamp_ns: int, topic: Topic[M], inbox: Inbox) -> bool:
        """Whether a measurement is from this epoch; one that is not is rejected and counted."""
        if stamp_ns > self._now_ns:
            # From a simulation that has ended since.
            inbox.reject(topic, "stamp in the future")
            return False
        if stamp_ns < self._begun_ns:
            inbox.reject(topic, "from an earlier epoch")
            return False
        return True

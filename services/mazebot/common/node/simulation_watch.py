"""Notices a reset of the simulation: time went back, or the epoch or the seed is another one."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar

from mazebot.common.messages.documents import SimulationStats
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Inbox

M = TypeVar("M")


class SimulationWatch:
    """What a node knows of the run that it is in."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        """The simulation's seed, as soon as it is known; before, the configured one."""
        self.epoch: int | None = None
        """The epoch in which the current run began; None before it is known. A simulator that was
        started again and goes on where it was changes nothing."""
        self._now_ns = 0
        self._begun_ns = 0
        self._newest: dict[str, Any] = {}
        """Messages by topic, see latest_of_this_run."""
        self._given: set[str] = set()
        """Topics whose newest message was given to the node in this run."""

    def restarted(self, now_ns: int, news: Iterable[SimulationStats]) -> bool:
        """Whether the simulation was reset since the last step. Call it once in each step, with the
        new messages of SIMULATION_STATS.
        """
        restarted = now_ns < self._now_ns
        if restarted:
            self._begun_ns = 0
        for stats in news:
            epoch = stats.run_epoch
            if self.epoch is not None and epoch != self.epoch:
                restarted = True
                self._begun_ns = round(stats.sim_time_s * 1e9)
            restarted = restarted or stats.seed != self.seed
            self.epoch, self.seed = epoch, stats.seed
        self._now_ns = now_ns
        if restarted:
            self._given.clear()
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

    def latest_of_this_run(self, topic: Topic[M], inbox: Inbox) -> M | None:
        """The newest message with a header of a latched topic, once it is known to be of this run.

        It is sent once, and may come before the clock that it is stamped by: then it waits for its
        time. As it may have come before the news of a restart, it is given again after one. That of
        a simulation that has ended waits until the new one's takes its place.
        """
        came: Any = inbox.latest(topic)
        if came is not None:
            self._newest[topic.name] = came
            self._given.discard(topic.name)
        newest = self._newest.get(topic.name)
        if newest is None or topic.name in self._given:
            return None
        stamp_ns = ns_from_time(newest.header.stamp)
        if stamp_ns > self._now_ns:
            return None
        self._given.add(topic.name)
        return newest if self.is_of_this_run(stamp_ns, topic, inbox) else None

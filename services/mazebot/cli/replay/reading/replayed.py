"""Recorded messages in the order in which they were sent, each with the service that sent it."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from mazebot.common.messages.topics import Delivery, Topic
from mazebot.common.node.node import Envelope

CLOCK_SERVICE = "physics"
"""The service whose clock all others follow."""
WINDOW_NS = 5_000_000_000
"""A message is at most so much later in a file than another one that was sent at the same time."""


class Replayed(NamedTuple):
    """A recorded message."""

    topic: Topic[Any]
    data: bytes
    """CDR, as recorded."""
    service: str
    """The service that sent it, or EDGE."""
    envelope: Envelope
    """As recorded."""
    time_ns: int
    """When it is sent in the replay: simulation time."""

    @property
    def is_repeated(self) -> bool:
        """Whether it was sent before the replay's beginning, and held then."""
        return self.time_ns != self.envelope.sent_ns


def in_time(messages: Iterable[Replayed], window_ns: int = WINDOW_NS) -> Iterator[Replayed]:
    """The messages by time; those of one time in the order in which they come."""
    waiting: list[tuple[int, int, Replayed]] = []
    newest_ns: int | None = None
    for number, message in enumerate(messages):
        heapq.heappush(waiting, (message.time_ns, number, message))
        newest_ns = message.time_ns if newest_ns is None else max(newest_ns, message.time_ns)
        while waiting[0][0] < newest_ns - window_ns:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


def between(
    messages: Iterable[Replayed], start_ns: int, end_ns: int | None = None
) -> Iterator[Replayed]:
    """The messages from `start_ns` to `end_ns`, in time; before them, at `start_ns`, the latched
    ones that were valid then.
    """
    latched: dict[tuple[str, str], deque[Replayed]] = {}
    begun = False
    for message in messages:
        if message.time_ns < start_ns:
            topic = message.topic
            if topic.delivery is Delivery.LATCHED:
                key = topic.name, message.service
                latched.setdefault(key, deque(maxlen=topic.depth)).append(message)
            continue
        if end_ns is not None and message.time_ns > end_ns:
            break
        if not begun:
            begun = True
            yield from _at(start_ns, latched.values())
        yield message
    if not begun:
        yield from _at(start_ns, latched.values())


def _at(time_ns: int, kept: Iterable[Iterable[Replayed]]) -> Iterator[Replayed]:
    for one in sorted((one for some in kept for one in some), key=lambda one: one.time_ns):
        yield one._replace(time_ns=time_ns)

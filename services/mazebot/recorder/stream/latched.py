"""Keeps what a late subscriber would get, for the head of each file of a run."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any

from mazebot.common.messages.topics import Delivery, Topic
from mazebot.common.node.held import MAX_SOURCES, is_alone
from mazebot.recorder.stream.message_log import Taken

Kept = tuple[Topic[Any], Taken]


class Latched:
    """The newest messages on the latched topics, of each publisher."""

    def __init__(self) -> None:
        self._kept: dict[Topic[Any], dict[str, deque[Taken]]] = {}

    def keep(self, topic: Topic[Any], taken: Taken) -> None:
        """Keep a message in place of an older one, if its topic is latched."""
        if topic.delivery is not Delivery.LATCHED or not taken.pieces:
            return
        sources = self._kept.setdefault(topic, {})
        source = taken.envelope.source
        messages = sources.pop(source, None)
        if messages is None:
            if is_alone(topic):
                sources.clear()
            messages = deque(maxlen=topic.depth)
        # The most recent publisher comes last.
        sources[source] = messages
        messages.append(taken)
        while len(sources) > MAX_SOURCES:
            del sources[next(iter(sources))]

    def forget(self, topic: Topic[Any]) -> None:
        """Drop the messages on a topic."""
        self._kept.pop(topic, None)

    def clear(self) -> None:
        """Drop all."""
        self._kept.clear()

    def __iter__(self) -> Iterator[Kept]:
        """The messages, topic by topic."""
        for topic, sources in self._kept.items():
            for messages in sources.values():
                for taken in messages:
                    yield topic, taken

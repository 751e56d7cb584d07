"""Latched messages outlive their publisher: subscribers keep them for later subscribers."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection, Iterable
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from mazebot.common.messages.topics import Delivery, Topic, kept_by, owned_by, read_by

MAX_SOURCES = 16
"""Publishers of one topic whose messages are kept: the most recent ones."""
MAX_BYTES = 128 * 1024 * 1024


class _Sent(Protocol):
    @property
    def source(self) -> str:
        """Its publisher."""


E = TypeVar("E", bound=_Sent)


class HeldMessage(NamedTuple, Generic[E]):
    """A message as it came from the wire."""

    topic: Topic[Any]
    data: bytes
    envelope: E
    received_ns: int
    """Wall clock time."""


def wanted_by(service: str) -> list[Topic[object]]:
    """The latched topics whose last messages a service requests from the others when it starts: the
    non-periodic ones that it reads, and its own ones that are `returned` after a restart.
    """
    read = [topic for topic in read_by(service) if topic.rate_hz is None]
    own = [topic for topic in owned_by(service) if topic.returned]
    return [topic for topic in (*read, *own) if topic.delivery is Delivery.LATCHED]


def is_alone(topic: Topic[Any]) -> bool:
    """Whether a topic has only one publisher at a time."""
    return topic.in_turn or len(topic.owners) == 1


class HeldMessages(Generic[E]):
    """The newest messages of each publisher, for topics that others may request."""

    def __init__(self, service: str) -> None:
        latched = [topic for topic in read_by(service) if topic.delivery is Delivery.LATCHED]
        shared = [
            topic
            for topic in latched
            if topic.returned or (topic.rate_hz is None and len(topic.readers) > 1)
        ]
        self._topics = {topic.name: topic for topic in (*shared, *kept_by(service))}
        self._messages: dict[str, dict[str, deque[HeldMessage[E]]]] = {
            name: {} for name in self._topics
        }
        self._bytes = 0

    def keep(self, name: str, data: bytes, envelope: E) -> None:
        """Keep a message in place of an older one. Beyond MAX_SOURCES the least recent publisher is
        dropped; beyond MAX_BYTES the new message is.
        """
        topic = self._topics.get(name)
        if topic is None or self._bytes + len(data) > MAX_BYTES:
            return
        sources = self._messages[name]
        messages = sources.pop(envelope.source, deque())
        sources[envelope.source] = messages
        messages.append(HeldMessage(topic, data, envelope, time.time_ns()))
        self._bytes += len(data)
        while len(messages) > topic.depth:
            self._bytes -= len(messages.popleft().data)
        while len(sources) > MAX_SOURCES:
            oldest = sources.pop(next(iter(sources)))
            self._bytes -= sum(len(message.data) for message in oldest)

    def forget(self, is_known: Callable[[str], bool], before_ns: int) -> bool:
        """Drop what came before a wall clock time from publishers that nobody knows; whether there
        was any.
        """
        found = False
        for sources in self._messages.values():
            for source, messages in list(sources.items()):
                if not is_known(source) and messages[-1].received_ns < before_ns:
                    self._bytes -= sum(len(message.data) for message in sources.pop(source))
                    found = True
        return found

    def kept_from(
        self, names: Collection[str], is_meant: Callable[[str], bool]
    ) -> list[HeldMessage[E]]:
        """The kept messages on these topics, of the publishers for which `is_meant` is true."""
        return [
            message
            for name in names
            for source, messages in self._messages.get(name, {}).items()
            if is_meant(source)
            for message in messages
        ]


def newest(messages: Iterable[HeldMessage[E]]) -> list[HeldMessage[E]]:
    """The messages kept by several subscribers, without duplicates, oldest first; of a topic with
    only one publisher at a time, only the messages of the most recent one.
    """
    by_topic: dict[str, dict[str, list[HeldMessage[E]]]] = {}
    for message in sorted(messages, key=lambda one: one.received_ns):
        sources = by_topic.setdefault(message.topic.name, {})
        # The most recent publisher comes last.
        kept = sources.pop(message.envelope.source, [])
        if all(message.data != other.data for other in kept):
            kept.append(message)
        sources[message.envelope.source] = kept
    chosen: list[HeldMessage[E]] = []
    for sources in by_topic.values():
        lists = list(sources.values())
        alone = is_alone(lists[-1][-1].topic)
        for kept in lists[-1:] if alone else lists:
            chosen += kept[-kept[-1].topic.depth :]
    return chosen

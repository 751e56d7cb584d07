"""Compares what a service sends in a replay with what was recorded of it, byte by byte."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mazebot.common.messages import wire
from mazebot.common.messages.documents import Document
from mazebot.common.messages.topics import Topic

_SHOWN = 60


@dataclass(frozen=True)
class Difference:
    """A message in which the replay differs from the recording."""

    time_ns: int
    """Simulation time at which it was sent."""
    number: int
    """Of the message on its topic, from 0."""
    only_in: str | None
    """`recording` or `replay`, where only that one has it."""
    field: str = ""
    """The first field that differs."""
    recorded: str = ""
    replayed: str = ""


@dataclass
class TopicComparison:
    """One topic of a service."""

    topic: str
    recorded: int = 0
    replayed: int = 0
    same: int = 0
    first: Difference | None = None
    largest: dict[str, float] = field(default_factory=dict)
    """By field, the largest difference of a number in messages of the same time."""


class Comparison:
    """Takes the messages of both, each in the order of time, and compares those of one time."""

    def __init__(self) -> None:
        self._topics: dict[str, TopicComparison] = {}
        self._waiting: dict[str, tuple[deque[_Sent], deque[_Sent]]] = {}
        self._begun: dict[str, int] = {}
        self.rejected: dict[tuple[str, str], int] = {}
        """Messages that the service did not take, by topic and reason."""

    @property
    def topics(self) -> list[TopicComparison]:
        """The topics on which there was a message, by name."""
        return [self._topics[name] for name in sorted(self._topics)]

    @property
    def is_same(self) -> bool:
        """Whether no message differs."""
        return all(one.first is None for one in self._topics.values())

    def take_recorded(self, topic: Topic[Any], time_ns: int, data: bytes) -> None:
        """A message of the recording."""
        self._take(topic, 0, (time_ns, data)).recorded += 1
        self._compare(topic)

    def take_replayed(self, topic: Topic[Any], time_ns: int, data: bytes) -> None:
        """A message of the replay."""
        self._take(topic, 1, (time_ns, data)).replayed += 1
        self._compare(topic)

    def missing_at(self, time_ns: int) -> bool:
        """Whether the recording has a message of that time that the replay has not."""
        return any(
            recorded and recorded[-1][0] == time_ns for recorded, _ in self._waiting.values()
        )

    def end(self) -> None:
        """No message is to come."""
        for name, (recorded, replayed) in self._waiting.items():
            for time_ns, _ in recorded:
                self._differs(name, Difference(time_ns, self._begun[name], "recording"))
            for time_ns, _ in replayed:
                self._differs(name, Difference(time_ns, self._begun[name], "replay"))
            recorded.clear()
            replayed.clear()

    def _take(self, topic: Topic[Any], which: int, sent: _Sent) -> TopicComparison:
        name = topic.name
        if name not in self._topics:
            self._topics[name] = TopicComparison(name)
            self._waiting[name] = deque(), deque()
            self._begun[name] = 0
        self._waiting[name][which].append(sent)
        return self._topics[name]

    def _compare(self, topic: Topic[Any]) -> None:
        name = topic.name
        recorded, replayed = self._waiting[name]
        while recorded and replayed:
            (recorded_ns, was), (replayed_ns, now) = recorded[0], replayed[0]
            number = self._begun[name]
            self._begun[name] += 1
            if recorded_ns <= replayed_ns:
                recorded.popleft()
            if replayed_ns <= recorded_ns:
                replayed.popleft()
            if recorded_ns < replayed_ns:
                self._differs(name, Difference(recorded_ns, number, "recording"))
            elif replayed_ns < recorded_ns:
                self._differs(name, Difference(replayed_ns, number, "replay"))
            elif was == now:
                self._topics[name].same += 1
            else:
                self._tell_apart(topic, recorded_ns, number, was, now)

    def _tell_apart(
        self, topic: Topic[Any], time_ns: int, number: int, was: bytes, now: bytes
    ) -> None:
        compared = self._topics[topic.name]
        try:
            one, other = wire.decode(topic, was), wire.decode(topic, now)
        except wire.WireError:
            found = None
        else:
            found = _difference("", one, other)
            before, after = dict(_numbers("", one)), dict(_numbers("", other))
            for name in before.keys() & after.keys():
                apart = abs(after[name] - before[name])
                if apart > compared.largest.get(name, 0.0):
                    compared.largest[name] = apart
        place = found or ("bytes", f"{len(was)} bytes", f"{len(now)} bytes")
        self._differs(topic.name, Difference(time_ns, number, None, *place))

    def _differs(self, name: str, difference: Difference) -> None:
        if self._topics[name].first is None:
            self._topics[name].first = difference


_Sent = tuple[int, bytes]


def _difference(path: str, one: Any, other: Any) -> tuple[str, str, str] | None:
    """The path of the first field that differs, with its values."""
    if type(one) is not type(other):
        return path, _text(one), _text(other)
    if isinstance(one, np.ndarray):
        if one.shape != other.shape:
            return f"{path} (length)", str(len(one)), str(len(other))
        places = np.flatnonzero(~_same(one, other))
        if not len(places):
            return None
        at = int(places[0])
        return f"{path}[{at}]", _text(one[at]), _text(other[at])
    if isinstance(one, list | tuple):
        if len(one) != len(other):
            return f"{path} (length)", str(len(one)), str(len(other))
        pairs = [(f"{path}[{at}]", *both) for at, both in enumerate(zip(one, other, strict=True))]
    elif isinstance(one, dict):
        names = dict.fromkeys((*one, *other))
        pairs = [(_dotted(path, str(name)), one.get(name), other.get(name)) for name in names]
    elif isinstance(one, Document):
        names = dict.fromkeys(type(one).model_fields)
        pairs = [(_dotted(path, name), getattr(one, name), getattr(other, name)) for name in names]
    elif dataclasses.is_dataclass(one):
        pairs = [
            (_dotted(path, field.name), getattr(one, field.name), getattr(other, field.name))
            for field in dataclasses.fields(one)
            if not field.name.startswith("__")
        ]
    else:
        return None if _same(one, other) else (path, _text(one), _text(other))
    for pair in pairs:
        found = _difference(*pair)
        if found is not None:
            return found
    return None


def _numbers(path: str, message: Any) -> Iterator[tuple[str, float]]:
    """The numbers in the fields of a message, by path; not those in lists."""
    if isinstance(message, float):
        yield path, message
        return
    if isinstance(message, Document):
        names = list(type(message).model_fields)
    elif dataclasses.is_dataclass(message):
        names = [one.name for one in dataclasses.fields(message) if not one.name.startswith("__")]
    else:
        return
    for name in names:
        yield from _numbers(_dotted(path, name), getattr(message, name))


def _same(one: Any, other: Any) -> Any:
    """Whether values are equal; one that is not a number equals another."""
    return (one == other) | ((one != one) & (other != other))  # noqa: PLR0124 - NaN alone differs


def _dotted(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _text(value: Any) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    return f"{value!r:.{_SHOWN}}"

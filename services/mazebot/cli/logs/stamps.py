"""The times of a bag's messages, by their stamps."""

from __future__ import annotations

import heapq
import statistics
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

SET_BACK_NS = 1_000_000_000
"""A clock that goes back by more, and on from there, was set back."""
_SOON_NS = 5_000_000_000
"""In which a topic has a message of after the clock was set back; its stamps are of another clock
where it shows none.
"""
_RECENT = 10
"""Messages of a topic of which the quickest tells how long they are on the way."""


class Told(NamedTuple):
    """A message: when it was logged, its stamp, 0 for none, and what it says."""

    log_ns: int
    stamp_ns: int
    says: Any


class _Step(NamedTuple):
    """A clock of stamps that was set back."""

    log_ns: int
    """When it was first seen."""
    size_ns: int


@dataclass
class _Topic:
    times_ns: list[int] = field(default_factory=list)
    newest_ns: int | None = None
    moved_ns: int = 0
    passed: int = 0
    """Steps that it has taken, or that were not of its clock."""
    lags_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_RECENT))
    """By what the clock of logging is ahead of its newest times."""


def times_ns(topics: Sequence[Sequence[Told]]) -> tuple[list[list[int]], int]:
    """The times of the messages of each topic, given in the order of logging, and how often the
    clock of their stamps was set back.

    They are the stamps, or where there are none the time of logging, by the clock of the stamps.
    After that was set back, the stamps of all its topics go on from there, as much later as their
    messages were logged.
    """
    stamped = [[told for told in topic if told.stamp_ns] for topic in topics]
    states = [_Topic() for _ in topics]
    steps: list[_Step] = []
    series = [
        [(told.log_ns, number, i) for i, told in enumerate(topic)]
        for number, topic in enumerate(stamped)
    ]
    for _, number, i in heapq.merge(*series):
        # A single one that comes late is no clock that was set.
        _take(states[number], stamped[number][i : i + 2], steps)
    times = [iter(state.times_ns) for state in states]
    lag_ns = _median_ns(
        told.log_ns - time_ns
        for topic, state in zip(stamped, states, strict=True)
        for told, time_ns in zip(topic, state.times_ns, strict=True)
    )
    return [
        [next(own) if told.stamp_ns else told.log_ns - lag_ns for told in topic]
        for topic, own in zip(topics, times, strict=True)
    ], len(steps)


def stamped_later_s(topic: Sequence[Told], other: Sequence[Told]) -> float:
    """How much later the messages of a topic are stamped than those of another, by when both were
    logged, in the middle; 0 where they were not logged at one time.
    """
    logged_ns, lags_ns, other_ns, other_lags_ns = (
        np.array(values, np.int64)
        for told in ([one for one in topic if one.stamp_ns], [one for one in other if one.stamp_ns])
        for values in ([one.log_ns for one in told], [one.log_ns - one.stamp_ns for one in told])
    )
    if not len(other_ns):
        return 0.0
    meanwhile = (logged_ns >= other_ns[0]) & (logged_ns <= other_ns[-1])
    if not meanwhile.any():
        return 0.0
    # Simulated time passes faster or slower than that of logging.
    usual_ns = np.interp(logged_ns[meanwhile], other_ns, other_lags_ns)
    return float(np.median(usual_ns - lags_ns[meanwhile])) * 1e-9


def _take(topic: _Topic, following: Sequence[Told], steps: list[_Step]) -> None:
    """Add the time of the first of one or two messages that follow each other."""
    told = following[0]
    if topic.newest_ns is not None:
        lag_ns = min(one.log_ns - one.stamp_ns for one in following) - topic.moved_ns
        later_ns = lag_ns - min(topic.lags_ns)
        is_back = max(one.stamp_ns for one in following) + topic.moved_ns < topic.newest_ns
        while topic.passed < len(steps):
            step = steps[topic.passed]
            if later_ns > step.size_ns / 2:
                topic.moved_ns += step.size_ns
                later_ns -= step.size_ns
                is_back = False
            elif told.log_ns < step.log_ns + _SOON_NS:
                break
            topic.passed += 1
        if topic.passed == len(steps) and is_back and later_ns > SET_BACK_NS:
            steps.append(_Step(told.log_ns, later_ns))
            topic.moved_ns += later_ns
            topic.passed += 1
    time_ns = told.stamp_ns + topic.moved_ns
    topic.times_ns.append(time_ns)
    topic.newest_ns = max(time_ns, time_ns if topic.newest_ns is None else topic.newest_ns)
    topic.lags_ns.append(told.log_ns - time_ns)


def _median_ns(values_ns: Iterable[int]) -> int:
    values = list(values_ns)
    return statistics.median_low(values) if values else 0

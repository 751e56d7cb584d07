"""Log times by a clock that was set back while it recorded: they go on from there.

Messages may stand in any order in a file. That the clock was set back shows where the later ones of
a topic have times among those of its earlier ones, or long before them.
"""

from __future__ import annotations

import heapq
import statistics
from array import array
from bisect import bisect_right
from collections.abc import Callable, Container, Hashable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_SET_BACK_NS = 1_000_000_000
"""A clock that goes back by more, and on from there, was set back."""
_AMONG_NS = 500_000_000
"""As long a topic has two messages at a time then; less may be disorder."""
_MISSING = 3.0
"""Usual intervals without a message of a topic: some are elsewhere."""
_APART_NS = 10_000_000_000
"""Without any message, between what is later in the file and what is earlier."""
_MOST = 50
"""Times that a clock is set back; where times go back more often, it is disorder."""
_MESSAGE_BITS = 32
_Array = NDArray[np.float64]
Span = tuple[int, int]
"""The first and the last log time of some messages, in ns."""
Message = tuple[int, int, bytes]
"""Log time in ns, the connection's id, content."""


class Place(NamedTuple):
    """A message in the order of writing."""

    at: int
    """A number that grows in a file."""
    connection: int
    """Its id."""
    log_ns: int


class Move(NamedTuple):
    """From a place on, log times are later than the file says."""

    at: int
    by_ns: int
    end_ns: int
    """The latest log time that is moved so."""


def may_go_back(spans: Iterable[Span]) -> bool:
    """Whether a clock may have been set back in parts of a file, given in the order of writing."""
    newest_ns: float = -np.inf
    for start_ns, end_ns in spans:
        newest_ns = max(newest_ns, end_ns)
        if start_ns < newest_ns - _SET_BACK_NS:
            return True
    return False


def moves_of(files: Sequence[Iterable[tuple[Hashable, Place]]]) -> list[list[Move]]:
    """How the log times of each file are moved, by its messages in the order of writing, each with
    the series that it belongs to. A series goes on after its usual interval.
    """
    numbers: dict[Hashable, int] = {}
    series, ats, times_ns = array("q"), array("q"), array("d")
    ends = [0]
    for file in files:
        for one, place in file:
            series.append(numbers.setdefault(one, len(numbers)))
            ats.append(place.at)
            times_ns.append(place.log_ns)
        ends.append(len(ats))
    times = np.array(times_ns)
    steps = _steps(np.array(series), times)
    found = []
    for begin, end in pairwise(ends):
        passed = [(begin, by_ns) for i, by_ns in steps if i <= begin < end]
        parts = [*passed[-1:], *((i, by_ns) for i, by_ns in steps if begin < i < end)]
        lasts = [*(i for i, _ in parts), end][1:]
        found.append(
            [
                Move(ats[i], by_ns, int(times[i:last].max()) + by_ns)
                for (i, by_ns), last in zip(parts, lasts, strict=False)
            ]
        )
    return found


def _steps(series: NDArray[np.int64], times_ns: _Array) -> list[tuple[int, int]]:
    """The index of the first message after each time that the clock was set back, and by how many
    ns all log times are moved from there on.
    """
    begins = _begins(times_ns)
    # None also where a file that is damaged has no message.
    if not begins or len(begins) > _MOST:
        return []
    found: list[tuple[int, int]] = []
    all_ns = np.sort(times_ns)
    before: dict[int, _Array] = {}
    moved_ns = 0.0
    for begin, end in pairwise((0, *begins, len(times_ns))):
        parts = _parts(series[begin:end], times_ns[begin:end])
        steps_ns = [
            before[one][-1] + np.median(np.diff(before[one])) - (part[0] + moved_ns)
            for one, part in parts
            if len(before.get(one, ())) > 1
            and (_are_among(before[one], part + moved_ns) or _are_apart(all_ns, part))
        ]
        steps_ns = [step_ns for step_ns in steps_ns if step_ns > _SET_BACK_NS]
        if steps_ns:
            moved_ns += float(statistics.median_low(steps_ns))
            found.append((begin, round(moved_ns)))
        for one, part in parts:
            before[one] = np.sort(np.concatenate((before.get(one, part[:0]), part + moved_ns)))
    return found


def in_time(
    starts_ns: Sequence[int],
    inside: Callable[[int], Iterable[Message]],
    wanted: Container[int],
    moved: Sequence[Move] = (),
) -> Iterator[Message]:
    """The messages of some connections in a file's blocks by their log time, moved where that is to
    be.

    No message of a block is before its start; `inside` reads those of the block of a number. Those
    of one time come in the order of writing.
    """
    waiting: list[tuple[int, int, int, bytes]] = []
    for part in (*sorted(_blocks(starts_ns, moved)), None):
        while waiting and (part is None or waiting[0][0] < part.start_ns):
            log_ns, _, connection, data = heapq.heappop(waiting)
            yield log_ns, connection, data
        if part is None:
            return
        for at, message in enumerate(inside(part.number), place_in(part.number, 0)):
            log_ns, connection, data = message
            if connection in wanted and part.begin <= at < part.end:
                heapq.heappush(waiting, (log_ns + part.by_ns, at, connection, data))


def place_in(block: int, message: int) -> int:
    """Where a message of a block of a file is in the order of writing, both by their numbers."""
    return block << _MESSAGE_BITS | message


class _Part(NamedTuple):
    """Messages of a block that are moved by the same."""

    start_ns: int
    number: int
    begin: int
    end: int
    by_ns: int


def _blocks(starts_ns: Sequence[int], moved: Sequence[Move]) -> Iterator[_Part]:
    firsts = [move.at for move in moved]
    for number, start_ns in enumerate(starts_ns):
        begin, end = place_in(number, 0), place_in(number + 1, 0)
        cuts = [first for first in firsts if begin < first < end]
        for first, last in pairwise((begin, *cuts, end)):
            passed = bisect_right(firsts, first)
            by_ns = moved[passed - 1].by_ns if passed else 0
            yield _Part(start_ns + by_ns, number, first, last, by_ns)


def _begins(times_ns: _Array) -> list[int]:
    """From which messages on the times go on far before those until there."""
    found: list[int] = []
    begin = 0
    while len(found) <= _MOST:
        rest = times_ns[begin:]
        # A single one that comes late is no clock that was set.
        own_and_next = np.maximum(rest, np.append(rest[1:], -np.inf))
        is_back = own_and_next[1:] < np.maximum.accumulate(rest)[:-1] - _SET_BACK_NS
        if not is_back.any():
            break
        begin += int(is_back.argmax()) + 1
        found.append(begin)
    return found


def _parts(series: NDArray[np.int64], times_ns: _Array) -> list[tuple[int, _Array]]:
    """The times of each topic."""
    order = np.argsort(series, kind="stable")
    numbers, firsts = np.unique(series[order], return_index=True)
    return list(zip(numbers.tolist(), np.split(times_ns[order], firsts[1:]), strict=True))


def _are_among(before: _Array, part: _Array) -> bool:
    """Whether times of before, which are sorted, are between these, and not where some are missing:
    there it is disorder.
    """
    own = np.sort(part)
    within = before[(before > own[0]) & (before < own[-1])]
    if not len(within):
        return False
    gaps = np.diff(own)
    gap_of_each = gaps[np.searchsorted(own, within, side="right") - 1]
    among = within[gap_of_each <= _MISSING * np.quantile(gaps, 0.75)]
    return bool(len(among) and among[-1] - among[0] >= _AMONG_NS)


def _are_apart(all_ns: _Array, part: _Array) -> bool:
    """Whether no other is for long after these, of all, which are sorted."""
    following = all_ns[np.searchsorted(all_ns, part.max(), side="right") :]
    return bool(len(following) and following[0] - part.max() > _APART_NS)

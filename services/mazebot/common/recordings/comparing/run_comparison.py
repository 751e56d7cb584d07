"""Where two runs diverge: the first differing message of each publisher on each topic."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from mazebot.common.recordings.comparing.digests import OTHERS, Digests

Rows = NDArray[np.void]

_TAIL_NS = 1_000_000_000
"""Before the common end of both runs: messages missing there may have been in transit."""

_BLOCK = 4096


@dataclass(frozen=True)
class Difference:
    """The first message on a topic that differs between the two runs."""

    time_ns: int
    """Simulation time at which it was sent."""
    topic: str
    source: str
    """Name of the service; empty if unknown."""
    number: int
    """Sequence number of the message at its source on this topic, from 0."""
    only_in: int | None
    """The run, 0 or 1, that alone has it; None: both have one, and they differ."""


@dataclass(frozen=True)
class Comparison:
    """Result of the comparison of two runs."""

    differences: tuple[Difference, ...]
    """One per topic and publisher, the earliest first."""
    messages: int
    """Number of equal messages."""
    lost: tuple[int, int]
    """Messages missing in each run's recording that the other has."""
    ends_ns: tuple[int, int]
    """When each run sent its last message."""


def compare(first: Digests, second: Digests) -> Comparison:
    """Compare two runs, up to the end of the shorter one.

    A message is identified by its send time, and by its order among messages of equal time. Before
    simulation time advances, the number of repetitions depends on the services' start order: there,
    only the last messages are compared.
    """
    ends_ns = _end_ns(first), _end_ns(second)
    differences: list[Difference] = []
    same, lost = 0, [0, 0]
    order = {name: number for number, name in enumerate(first.topics + second.topics)}
    pairs = _paired(_streams(first), _streams(second))
    for (topic, source), (a, b) in pairs.items():
        walk = _Walk(a, b, min(ends_ns))
        found = walk.first_difference()
        same += walk.same
        lost = [lost[0] + walk.lost[0], lost[1] + walk.lost[1]]
        if found is not None:
            row, only_in = found
            time_ns, number = int(row["time_ns"]), int(row["sequence"])
            differences.append(Difference(time_ns, topic, source, number, only_in))
    differences.sort(key=lambda one: (one.time_ns, order[one.topic], one.source))
    return Comparison(tuple(differences), same, (lost[0], lost[1]), ends_ns)


def _end_ns(digests: Digests) -> int:
    return int(digests.rows["time_ns"].max(initial=0))


_Streams = dict[str, list[tuple[str, Rows]]]
"""By topic, the name and messages of each publisher; an empty name if unknown."""


def _streams(digests: Digests) -> _Streams:
    rows = digests.rows
    kinds = rows["topic"].astype(np.int64) << 16 | rows["source"]
    ordered = np.argsort(kinds, kind="stable")
    edges = np.flatnonzero(np.diff(kinds[ordered])) + 1
    streams: _Streams = {}
    for members in np.split(ordered, edges) if len(rows) else ():
        stream = rows[members]
        source = int(stream["source"][0])
        known = source < min(OTHERS, len(digests.services))
        name = digests.services[source] if known else ""
        streams.setdefault(digests.topics[stream["topic"][0]], []).append((name, stream))
    return streams


def _paired(first: _Streams, second: _Streams) -> dict[tuple[str, str], tuple[Rows, Rows]]:
    """The messages of both runs by topic and publisher.

    Publishers have names within one process, but not over a bus: those without a namesake are
    matched by their first message, which is the same in both runs.
    """
    pairs = {}
    for topic in dict.fromkeys((*first, *second)):
        runs = first.get(topic, []), second.get(topic, [])
        some = (runs[0] or runs[1])[0][1]
        named = [{name: rows for name, rows in run if name} for run in runs]
        for name in dict.fromkeys((*named[0], *named[1])):
            if all(name in run for run in named) or not any("" in dict(run) for run in runs):
                pairs[topic, name] = named[0].pop(name, some[:0]), named[1].pop(name, some[:0])
        rest = [
            sorted(
                [*left.items(), *(one for one in run if not one[0])],
                key=lambda one: (int(one[1]["time_ns"][0]), int(one[1]["digest"][0])),
            )
            for left, run in zip(named, runs, strict=True)
        ]
        for number, (one, other) in enumerate(zip_longest(*rest, fillvalue=("", some[:0]))):
            name = one[0] or other[0] or (f"publisher {number + 1}" if number else "")
            pairs[topic, name] = one[1], other[1]
    return pairs


class _Walk:
    """Walks through the messages of one publisher in two runs, side by side."""

    def __init__(self, first: Rows, second: Rows, end_ns: int) -> None:
        self._rows = first, second
        self._end_ns = end_ns
        self.same = 0
        self.lost = [0, 0]

    def first_difference(self) -> tuple[np.void, int | None] | None:
        """The message, and the run that alone has it; None if there is no difference."""
        at = [0, 0]
        while any(i < len(rows) for i, rows in zip(at, self._rows, strict=True)):
            alike = self._alike(at)
            if alike:
                self.same += alike
                at = [i + alike for i in at]
                continue
            time_ns = min(
                int(rows["time_ns"][i])
                for rows, i in zip(self._rows, at, strict=True)
                if i < len(rows)
            )
            if time_ns > self._end_ns:
                return None
            ends = [self._group_end(run, at[run], time_ns) for run in (0, 1)]
            found = self._difference(at, ends, time_ns)
            if found is not None:
                return found
            at = ends
        return None

    def _alike(self, at: list[int]) -> int:
        """Number of equal next messages, in whole groups of equal time."""
        a, b = (rows[i : i + _BLOCK] for rows, i in zip(self._rows, at, strict=True))
        count = min(len(a), len(b))
        same = (a["time_ns"][:count] == b["time_ns"][:count]) & (
            a["digest"][:count] == b["digest"][:count]
        )
        end = count if same.all() else int(same.argmin())
        if end == len(a) == len(b) < _BLOCK:
            return end
        # Messages of the time of a possible difference are compared together.
        while end > 0 and any(
            end == len(rows) or rows["time_ns"][end] == rows["time_ns"][end - 1] for rows in (a, b)
        ):
            end -= 1
        return end

    def _group_end(self, run: int, start: int, time_ns: int) -> int:
        times_ns = self._rows[run]["time_ns"]
        end = start
        while end < len(times_ns) and times_ns[end] == time_ns:
            end += 1
        return end

    def _difference(
        self, at: list[int], ends: list[int], time_ns: int
    ) -> tuple[np.void, int | None] | None:
        """As `first_difference`, among the messages of one time."""
        a, b = (
            rows["digest"][start:end] for rows, start, end in zip(self._rows, at, ends, strict=True)
        )
        both = min(len(a), len(b))
        if time_ns == 0:
            a, b = a[len(a) - both :], b[len(b) - both :]
            at = [ends[0] - both, ends[1] - both]
        if len(a) == len(b):
            other = np.flatnonzero(a != b)
            self.same += int(other[0]) if len(other) else both
            return (self._rows[0][at[0] + int(other[0])], None) if len(other) else None
        longer = int(len(b) > len(a))
        shorter = 1 - longer
        missing = abs(len(a) - len(b))
        if self._gap(shorter, at[shorter], ends[shorter]) >= missing and set(
            (a, b)[shorter].tolist()
        ) <= set((a, b)[longer].tolist()):
            self.same += both
            self.lost[shorter] += missing
            return None
        if ends[shorter] == len(self._rows[shorter]) and time_ns > self._end_ns - _TAIL_NS:
            self.same += both
            return None
        other = np.flatnonzero(a[:both] != b[:both])
        row = int(other[0]) if len(other) else both
        self.same += row
        return self._rows[longer][at[longer] + row], None if len(other) else longer

    def _gap(self, run: int, start: int, end: int) -> int:
        """Number of messages missing in a run's recording around rows `start` to `end`."""
        numbers = self._rows[run]["sequence"]
        if end >= len(numbers):
            return 0
        before = int(numbers[start - 1]) if start else -1
        return int(numbers[end]) - before - 1 - (end - start)

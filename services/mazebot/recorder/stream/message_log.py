"""Writes every message of a run to `run.mcap`, in a thread, so that the recorder never waits."""

from __future__ import annotations

import operator
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mazebot.common.messages import wire
from mazebot.common.messages.topics import BY_NAME, Topic
from mazebot.common.messages.type_hash import hash_of
from mazebot.common.node.node import Envelope
from mazebot.common.recordings.mcap.mcap_channels import definition_of, qos_profiles_of
from mazebot.common.recordings.mcap.mcap_counts import by_origin, count_messages
from mazebot.common.recordings.mcap.mcap_file import McapFile, Row
from mazebot.common.recordings.mcap.mcap_messages import MADE_FROM, REPEATED, SOURCE, WORLD_HASH
from mazebot.common.recordings.mcap.mcap_records import McapError
from mazebot.common.recordings.run_folder import attachments_of
from mazebot.recorder.stream.file_writer import RecordingError

CHUNK_BYTES = 4 * 1024 * 1024
"""Uncompressed size at which a chunk is written before its time."""
MOST_WAITING_BYTES = 64 * 1024 * 1024
PATIENCE_S = 1.0
"""Wall time for which the recorder waits for the disk if more than that is not written yet."""
CLOSE_TIMEOUT_S = 1.5
_LOOK_S = 0.005

Pieces = tuple[wire.Buffer, ...]
"""CDR bytes, in pieces."""


class Taken(NamedTuple):
    """A message that the recorder has taken."""

    message: Any
    envelope: Envelope
    pieces: Pieces | Callable[[], Pieces]
    """Empty if nothing is recorded. Of an image that is not yet made, what waits for it."""


class Compressed(NamedTuple):
    """What is recorded in place of a picture."""

    topic_name: str
    make: Callable[[], Pieces]
    """Waits for its CDR."""


_Route = tuple[str, str, str, str]
"""What all messages of a channel have in common: its topic, their source and world, and of a
compressed picture the topic with the whole one.
"""
_Task = tuple[Callable[[], None], bool]
"""What the thread shall do, and whether even after it could not write."""
_Unmade = tuple[int, int, int, int, Pieces | Callable[[], Pieces]]
"""As a `Row`, of a message that may not be compressed yet."""


class MessageLog:
    """The files `run.mcap`, `run_2.mcap` ... of a run: when one is large, the next one begins."""

    def __init__(
        self,
        path_of: Callable[[int], Path],
        part: int,
        about: Mapping[str, Mapping[str, str]],
        segment_bytes: int,
    ) -> None:
        """Begin file number `part`, or go on with it. `about`: its metadata records.

        Raises RecordingError if it cannot be written.
        """
        self._path_of = path_of
        self._part = part
        self._about = about
        self._segment_bytes = segment_bytes
        self._routes: dict[_Route, int] = {}
        self._waiting: list[_Unmade] = []
        self._waiting_bytes = 0
        self._queued_bytes = 0
        self._repeated: Counter[str] = Counter()
        self._begins_next = False
        self._problem: str | None = None
        try:
            self._earlier = count_messages(path_of(number) for number in range(1, part))
            self._file = McapFile(path_of(part))
            self.is_new = not self._file.channels
            """Whether there is nothing in it yet."""
            if self.is_new:
                self._introduce({})
            else:
                self._take_over()
        except OSError as error:
            raise RecordingError(error.strerror or str(error)) from error
        except McapError as error:
            raise RecordingError(str(error)) from error
        self._tasks: queue.SimpleQueue[_Task | None] = queue.SimpleQueue()
        # Not a pool: the interpreter's end would wait for it, even if the disk hangs.
        self._thread = threading.Thread(target=self._run, name="messages", daemon=True)
        self._thread.start()

    @property
    def path(self) -> Path:
        """The file that is written."""
        return self._path_of(self._part)

    def add(
        self, topic: Topic[Any], taken: Taken, now_ns: int, compressed: Compressed | None = None
    ) -> None:
        """Add a message, or what is recorded in its place."""
        # Hand-written publishers do not tell when they send.
        row, size = self._row(topic, taken, taken.envelope.sent_ns or now_ns, compressed)
        self._waiting.append(row)
        self._waiting_bytes += size

    def add_latched(self, topic: Topic[Any], taken: Taken, now_ns: int) -> None:
        """Add a message that was sent before this run began, maybe in another run."""
        row, size = self._row(topic, taken, min(taken.envelope.sent_ns, now_ns))
        self._waiting.append(row)
        self._waiting_bytes += size

    @property
    def is_large(self) -> bool:
        """Whether enough is waiting for a chunk."""
        return self._waiting_bytes >= CHUNK_BYTES

    def flush(self, latched: Callable[[], Iterable[tuple[Topic[Any], Taken]]], now_ns: int) -> None:
        """Hand everything to the thread that writes; if the file is large, begin the next one with
        the `latched` messages.

        Raises RecordingError if something could not be written.
        """
        self.hand_over()
        if self._file.size >= self._segment_bytes and not self._begins_next:
            rows, repeated = [], Counter[str]()
            for topic, taken in latched():
                rows.append(self._row(topic, taken, now_ns)[0])
                repeated[topic.name] += 1
            routes = list(self._routes)
            self._begins_next = True
            self._put(lambda: self._begin_next(routes, rows, repeated))
        if self._problem is not None:
            raise RecordingError(self._problem)

    def recorded(self) -> dict[str, int]:
        """Messages in all files so far, by topic."""
        return dict(self._earlier + self._counts() - self._repeated)

    def wait(self, timeout_s: float) -> bool:
        """Whether, within a timeout, everything handed over was written."""
        done = threading.Event()
        self._put(done.set, always=True)
        return done.wait(timeout_s)

    def close(self) -> None:
        """End the file, with the run's files attached.

        Raises RecordingError if it is incomplete, or the disk takes too long.
        """
        self.hand_over()
        self._put(self._end, always=True)
        self._tasks.put(None)
        self._thread.join(CLOSE_TIMEOUT_S)
        if self._problem is not None:
            raise RecordingError(self._problem)
        if self._thread.is_alive():
            raise RecordingError(f"writing to the disk timed out after {CLOSE_TIMEOUT_S:g} s")

    def _row(
        self, topic: Topic[Any], taken: Taken, time_ns: int, compressed: Compressed | None = None
    ) -> tuple[_Unmade, int]:
        """A message with its channel, and its size as far as it is known."""
        envelope = taken.envelope
        name, made_from, unmade, size = topic.name, "", taken.pieces, 0
        if compressed is not None:
            made_from, (name, unmade) = name, compressed
        elif callable(unmade):
            size = taken.message.height * taken.message.step
        else:
            size = len(unmade[0]) if len(unmade) == 1 else sum(map(len, unmade))
        key = name, envelope.source, envelope.world_hash, made_from
        channel = self._routes.get(key)
        if channel is None:
            channel = self._routes[key] = len(self._routes)
            self._put(lambda: _add_channel(self._file, key))
        sequence, sent_ns = envelope.sequence & 0xFFFFFFFF, max(0, envelope.sent_ns)
        return (channel, sequence, max(0, time_ns), sent_ns, unmade), size

    def hand_over(self) -> None:
        """Queue the waiting messages to be written as one chunk."""
        rows, size = self._waiting, self._waiting_bytes
        if not rows:
            return
        self._waiting, self._waiting_bytes = [], 0
        end_s = time.monotonic() + PATIENCE_S
        while self._queued_bytes > MOST_WAITING_BYTES and self._problem is None:
            if time.monotonic() >= end_s:
                self._problem = "the disk is too slow"
            time.sleep(_LOOK_S)
        self._queued_bytes += size

        def write() -> None:
            self._queued_bytes -= size
            self._file.add_messages(_made(rows))

        self._put(write)

    def _put(self, task: Callable[[], None], always: bool = False) -> None:
        self._tasks.put((task, always))

    def _run(self) -> None:
        while (entry := self._tasks.get()) is not None:
            task, always = entry
            if self._problem is None or always:
                try:
                    task()
                except OSError as error:
                    self._problem = error.strerror or str(error)

    def _begin_next(
        self, routes: Sequence[_Route], rows: Sequence[_Unmade], repeated: Counter[str]
    ) -> None:
        counts = self._counts() - self._repeated
        self._end()
        file = McapFile(self._path_of(self._part + 1))
        self._earlier += counts
        self._part += 1
        self._file, self._repeated = file, repeated
        self._introduce(repeated)
        for route in routes:
            _add_channel(self._file, route)
        self._file.add_messages(_made(rows))
        self._begins_next = False

    def _introduce(self, repeated: Mapping[str, int]) -> None:
        for name, texts in self._about.items():
            self._file.add_metadata(name, texts)
        if repeated:
            self._file.add_metadata(REPEATED, {name: str(n) for name, n in repeated.items()})

    def _take_over(self) -> None:
        """Go on with the channels of the file."""
        repeated = self._file.texts.get(REPEATED, {})
        self._repeated = Counter({name: int(count) for name, count in repeated.items()})
        for channel in self._file.channels:
            texts = channel.metadata
            about = (texts.get(SOURCE, ""), texts.get(WORLD_HASH, ""), texts.get(MADE_FROM, ""))
            self._routes[channel.topic, *about] = channel.id

    def _counts(self) -> Counter[str]:
        return by_origin(list(self._file.channels), self._file.counts)

    def _end(self) -> None:
        self._file.close(attachments_of(self.path.parent))


def _add_channel(file: McapFile, route: _Route) -> None:
    topic_name, source, world_hash, made_from = route
    type_name = wire.type_name(BY_NAME[topic_name])
    texts = {
        SOURCE: source,
        WORLD_HASH: world_hash,
        "offered_qos_profiles": qos_profiles_of(topic_name),
        "topic_type_hash": hash_of(type_name),
    }
    if made_from:
        texts[MADE_FROM] = made_from
    file.add_channel(topic_name, type_name, definition_of(type_name), texts)


def _made(rows: Iterable[_Unmade]) -> list[Row]:
    """The messages, compressed, in the order in which they were sent."""
    made: list[Row] = [(*row[:4], row[4]() if callable(row[4]) else row[4]) for row in rows]
    made.sort(key=operator.itemgetter(2))
    return made

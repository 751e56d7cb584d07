"""A digest of each message of a run, to compare two runs.

The file is one line of JSON (`HEAD`, with the names of topics and services in the order of their
numbers), and then 24 bytes per message (`ROW`), in the order in which they were added.
"""

from __future__ import annotations

import functools
import hashlib
import json
import struct
import zlib
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.common.files.reading import NotReadableError, read_limited
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import DIAGNOSTICS, PARAMETERS, ROSOUT, SERVICES, TOPICS, Topic
from mazebot.common.node.node import Envelope

LEFT_OUT: tuple[Topic[Any], ...] = (PARAMETERS, DIAGNOSTICS, ROSOUT)
"""They contain folder names or wall times, which differ even between bit-identical runs."""

HEAD = "mazebot digests 2"
OTHERS = 100
ROW_FIELDS = (
    ("time_ns", "<i8", "simulation time at which the message was sent, ns"),
    ("sequence", "<u4", "number of the message at its source, on its topic"),
    ("topic", "<u2", "index of the topic in `topics` of the first line"),
    (
        "source",
        "<u2",
        "index of the publisher in `services` of the first line; from "
        f"{OTHERS}: a publisher that is none of them, in the order of their first message",
    ),
    ("digest", "<u8", "hash of the message's CDR"),
)
"""Name, NumPy type and meaning."""
ROW = np.dtype([(name, kind) for name, kind, _ in ROW_FIELDS])

_PACK = struct.Struct("<qIHH").pack
_TOGETHER = 4
"""Images: waking the other thread for each takes the interpreter from this one."""
_MOST_WAITING = 2
_MOST_UNWRITTEN_BYTES = 16 * 1024 * 1024
_MAX_BYTES = 1 << 29
_LARGE_BYTES = 1 << 16
_LARGE = struct.Struct("<II").pack


class DigestError(ValueError):
    """An invalid digest file; one line of text."""


def digest_of(pieces: Sequence[wire.Buffer]) -> bytes:
    """Eight bytes for a message's CDR, however it is cut into pieces: of its sha1, for which CPUs
    have instructions, or, as that takes three times as long, of a large one's CRC-32 and length.
    """
    if len(pieces) == 1 and len(pieces[0]) <= _LARGE_BYTES:
        return hashlib.sha1(pieces[0], usedforsecurity=False).digest()[:8]
    taken = hashlib.sha1(usedforsecurity=False)
    size = sum(map(len, pieces))
    if size > _LARGE_BYTES:
        taken.update(_LARGE(functools.reduce(_crc32, pieces, 0), size))
    else:
        for piece in pieces:
            taken.update(piece)
    return taken.digest()[:8]


def _crc32(crc: int, piece: wire.Buffer) -> int:
    return zlib.crc32(piece, crc)


class _LargeRow:
    """The row of an image, whose digest is made later."""

    def __init__(
        self, start: bytes, pieces: tuple[wire.Buffer, ...] | Callable[[], tuple[wire.Buffer, ...]]
    ) -> None:
        self.data = start
        self._pieces = pieces

    def make(self) -> None:
        """Add the digest; the image is not needed any more."""
        pieces, self._pieces = self._pieces, ()
        self.data += digest_of(pieces() if callable(pieces) else pieces)


def _make_all(rows: Sequence[_LargeRow]) -> None:
    for row in rows:
        row.make()


class DigestWriter:
    """Writes the digests of one run to a file."""

    def __init__(self, path: Path) -> None:
        """Create the file, or continue that of a run whose recorder died.

        Raises OSError if it cannot be created.
        """
        self.waits = False
        """Whether data is still waiting to be written to disk."""
        self.lost = 0
        """Digests lost because neither the disk nor the buffer had room."""
        self._topics = {topic.name: number for number, topic in enumerate(TOPICS)}
        self._left_out = {topic.name for topic in LEFT_OUT}
        self._sources = {name: number for number, name in enumerate(SERVICES)}
        self._first_other = OTHERS
        self._unwritten = bytearray()
        names = {"topics": [topic.name for topic in TOPICS], "services": list(SERVICES)}
        self._head = json.dumps({"head": HEAD, **names}).encode() + b"\n"
        # Unbuffered: unwritten data must be known, and written again.
        self._file = path.open("a+b", buffering=0)
        self._go_on(path)
        self._rows: list[bytes | _LargeRow] = []
        self._unmade: list[_LargeRow] = []
        self._maker = ThreadPoolExecutor(1, thread_name_prefix="digests")
        self._making: deque[Future[None]] = deque()

    def _go_on(self, path: Path) -> None:
        """Continue after the last whole row, or start a new file if none of this version exists."""
        try:
            rows = read_digests(path).rows
        except DigestError:
            rows = np.zeros(0, ROW)
        others = rows["source"][rows["source"] >= OTHERS]
        if len(rows):
            self._file.truncate(len(self._head) + rows.nbytes)
        else:
            self._file.truncate(0)
            self._unwritten += self._head
        if len(others):
            self._first_other = int(others.max()) + 1

    def add(
        self,
        topic: Topic[Any],
        pieces: tuple[wire.Buffer, ...] | Callable[[], tuple[wire.Buffer, ...]],
        envelope: Envelope,
    ) -> None:
        """Add a message by its CDR, or an image by what waits for its CDR."""
        if topic.name in self._left_out:
            return
        source = self._sources.get(envelope.source)
        if source is None:
            known = len(self._sources) - len(SERVICES)
            source = min(self._first_other + known, 0xFFFF)
            if source < 0xFFFF:
                self._sources[envelope.source] = source
        number = self._topics[topic.name]
        start = _PACK(envelope.sent_ns, envelope.sequence & 0xFFFFFFFF, number, source)
        if callable(pieces) or topic.type is msg.Image:
            # Hashing an image takes longer than all the rest, and lets other threads run.
            row = _LargeRow(start, pieces)
            self._rows.append(row)
            self._unmade.append(row)
            if len(self._unmade) >= _TOGETHER:
                self._make()
        else:
            self._rows.append(start + digest_of(pieces))

    def _make(self) -> None:
        """Have the digests of images made in the other thread."""
        unmade, self._unmade = self._unmade, []
        if not unmade:
            return
        while len(self._making) >= _MOST_WAITING:
            self._making.popleft().result()
        self._making.append(self._maker.submit(_make_all, unmade))

    def flush(self) -> None:
        """Write the added digests to disk.

        Raises OSError; unwritten data is kept for the next call, as far as there is room.
        """
        rows, self._rows = self._rows, []
        self._make()
        for made in self._making:
            made.result()
        self._making.clear()
        data = b"".join(row if isinstance(row, bytes) else row.data for row in rows)
        if len(self._unwritten) + len(data) <= _MOST_UNWRITTEN_BYTES:
            self._unwritten += data
        else:
            self.lost += len(rows)
        self.waits = True
        while self._unwritten:
            written = self._file.write(self._unwritten)
            del self._unwritten[:written]
        self.waits = False

    def close(self) -> None:
        """Write the rest. Raises OSError; the file is closed in any case."""
        try:
            self.flush()
        finally:
            self._maker.shutdown()
            self._file.close()


@dataclass(frozen=True, eq=False)
class Digests:
    """The contents of a digest file."""

    topics: tuple[str, ...]
    services: tuple[str, ...]
    rows: NDArray[np.void]
    """(n,) of `ROW`"""


def read_digests(path: Path) -> Digests:
    """Read a digest file; an incomplete row is left out.

    Raises DigestError if it is invalid, OSError if it cannot be read.
    """
    try:
        head, _, data = read_limited(path, _MAX_BYTES).partition(b"\n")
    except NotReadableError as error:
        raise DigestError(f"{path}: {error}") from error
    try:
        names = json.loads(head)
        if names["head"] != HEAD:
            raise DigestError(f"{path}: written by another version ({names['head']})")
        topics, services = tuple(map(str, names["topics"])), tuple(map(str, names["services"]))
    except DigestError:
        raise
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DigestError(f"{path}: not a digests file") from error
    rows = np.frombuffer(data[: len(data) // ROW.itemsize * ROW.itemsize], ROW)
    return Digests(topics, services, rows[rows["topic"] < len(topics)])

"""What a run said, as a digest of each message: by them two runs can be told apart.

The file is one line of JSON (`HEAD`, with the names of topics and services in the order of their
numbers), and then 24 bytes a message (`ROW`), in the order in which they were taken in.
"""

from __future__ import annotations

import json
import struct
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.common import messages as msg
from services.common.node import Envelope
from services.common.topics import DIAGNOSTICS, PARAMETERS, ROSOUT, SERVICES, TOPICS, Topic
from services.recorder.message_digest import digest_of

LEFT_OUT: tuple[Topic[Any], ...] = (PARAMETERS, DIAGNOSTICS, ROSOUT)
"""They name folders, or tell of wall time: two runs alike to the last bit differ in them."""

HEAD = "mazebot digests 1"
ROW = np.dtype(
    [
        ("time_ns", "<i8"),
        ("sequence", "<u4"),
        ("topic", "<u2"),
        ("source", "<u2"),
        ("digest", "<u8"),
    ]
)
"""Simulation time at which the message was sent; its number at its source, on its topic; number of
the topic; number of the service, or `OTHERS` and up for publishers by nothing but an identity, in
the order of their first message; what `message_digest` makes of the message.
"""
OTHERS = 100

_PACK = struct.Struct("<qIHH").pack
_MOST_SOURCES = 0xFFFF - OTHERS
_MOST_WAITING = 8
_HEAD_BYTES = 1 << 16


class DigestError(ValueError):
    """A file that holds no digests, in one line."""


class DigestWriter:
    """Writes the digests of one run to a new file."""

    def __init__(self, path: Path) -> None:
        """Raises OSError where the file cannot be made."""
        self._file = path.open("wb")
        names = {"topics": [topic.name for topic in TOPICS], "services": list(SERVICES)}
        self._file.write(json.dumps({"head": HEAD, **names}).encode() + b"\n")
        self._topics = {topic.name: number for number, topic in enumerate(TOPICS)}
        self._left_out = {topic.name for topic in LEFT_OUT}
        self._sources = {name: number for number, name in enumerate(SERVICES)}
        self._rows: list[bytes | Future[bytes]] = []
        self._maker = ThreadPoolExecutor(1, thread_name_prefix="digests")
        self._making: deque[Future[bytes]] = deque()

    def add(self, topic: Topic[Any], message: Any, envelope: Envelope) -> None:
        """Take in a message."""
        if topic.name in self._left_out:
            return
        source = self._sources.get(envelope.source)
        if source is None:
            known = len(self._sources) - len(SERVICES)
            source = OTHERS + min(known, _MOST_SOURCES)
            if known < _MOST_SOURCES:
                self._sources[envelope.source] = source
        number = self._topics[topic.name]
        start = _PACK(envelope.sent_ns, envelope.sequence & 0xFFFFFFFF, number, source)
        if topic.type is msg.Image:
            # A picture takes longer than all the rest, and hashing it leaves others to work.
            while len(self._making) >= _MOST_WAITING:
                self._making.popleft().result()
            row = self._maker.submit(lambda: start + digest_of(topic, message))
            self._making.append(row)
            self._rows.append(row)
        else:
            self._rows.append(start + digest_of(topic, message))

    def flush(self) -> None:
        """Bring what was taken in to the disk. Raises OSError."""
        rows, self._rows = self._rows, []
        self._making.clear()
        self._file.write(b"".join(row if isinstance(row, bytes) else row.result() for row in rows))
        self._file.flush()

    def close(self) -> None:
        """Write the rest. Raises OSError; the file is closed all the same."""
        try:
            self.flush()
        finally:
            self._maker.shutdown()
            self._file.close()


@dataclass(frozen=True, eq=False)
class Digests:
    """What a file of digests holds."""

    topics: tuple[str, ...]
    services: tuple[str, ...]
    rows: NDArray[np.void]
    """(n,) of `ROW`"""


def read_digests(path: Path) -> Digests:
    """Read a file of digests; a row that was cut short is left out.

    Raises DigestError where it holds none, OSError where it cannot be read.
    """
    with path.open("rb") as file:
        head = file.readline(_HEAD_BYTES)
        data = file.read()
    try:
        names = json.loads(head)
        if names["head"] != HEAD:
            raise DigestError(f"{path}: made by another version ({names['head']})")
        topics, services = tuple(map(str, names["topics"])), tuple(map(str, names["services"]))
    except DigestError:
        raise
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DigestError(f"{path}: no digests of a run") from error
    rows = np.frombuffer(data[: len(data) // ROW.itemsize * ROW.itemsize], ROW)
    return Digests(topics, services, rows[rows["topic"] < len(topics)])

"""Reads the messages of a run's `run.mcap`, and of other people's MCAP files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mazebot.common.messages import wire
from mazebot.common.messages.topics import BY_NAME
from mazebot.common.node.node import Envelope
from mazebot.common.recordings.mcap import mcap_records as rec
from mazebot.common.recordings.mcap.mcap_scan import content, records

SOURCE = "source"
"""Of a channel's metadata: the publisher,"""
WORLD_HASH = "world_hash"
"""the hash of the world for which its messages are,"""
MADE_FROM = "made_from"
"""and the topic of which its messages are a compressed form."""
REPEATED = "repeated"
"""Name of the metadata record of a run's later files: how many messages, by topic, stand at the
head that an earlier file has already, so that each file can be used by itself.
"""


class RecordedMessage(NamedTuple):
    """A message as it was on the wire."""

    topic: str
    type_name: str
    data: bytes
    """CDR."""
    envelope: Envelope
    time_ns: int
    """Log time: the simulation time of sending, or of receiving if the sender did not tell."""
    made_from: str = ""
    """The topic with the whole picture, if this is a compressed form of it."""


def read_messages(
    parts: Sequence[Path], topics: Collection[str] | None = None
) -> Iterator[RecordedMessage]:
    """The CDR messages of a recording's files, of all topics or some, in the order in which they
    were recorded; of a file that was cut off, all that is whole.

    Raises McapError, a line of text, if a file is no MCAP; OSError if it cannot be read.
    """
    for number, path in enumerate(parts):
        yield from _read_part(path, topics, skips_repeated=number > 0)


class _Route(NamedTuple):
    """What all messages of a channel have in common."""

    topic: str
    type_name: str
    source: str
    world_hash: str
    made_from: str
    decode: Callable[[bytes], Any] | None
    """Where its documents are as another version of Mazebot recorded them."""

    def as_today(self, data: bytes) -> tuple[str, bytes]:
        """The type and the bytes of a message."""
        if self.decode is None:
            return self.type_name, data
        topic = BY_NAME[self.topic]
        try:
            return wire.type_name(topic), wire.encode(topic, self.decode(data))
        except wire.WireError as error:
            # Its reader tells that it is none of the topic's.
            return f"{self.type_name} of another version ({error.reason})", data


_WITH_MESSAGES = (rec.SCHEMA, rec.CHANNEL, rec.MESSAGE, rec.CHUNK)


def _read_part(
    path: Path, topics: Collection[str] | None, skips_repeated: bool
) -> Iterator[RecordedMessage]:
    schemas: dict[int, rec.Schema] = {}
    routes: dict[int, _Route] = {}
    skipped = 0
    head_bytes = rec.MESSAGE_HEAD.size
    with path.open("rb") as file:
        for found in records(file):
            if found.opcode == rec.DATA_END:
                return
            if found.opcode == rec.METADATA and skips_repeated:
                skipped += _repeated(content(file, found))
            if found.opcode not in _WITH_MESSAGES:
                continue
            try:
                block, inner = _opened(found.opcode, content(file, found))
                for opcode, start, end in inner:
                    if opcode == rec.SCHEMA:
                        schema = rec.read_schema(block[start:end])
                        schemas[schema.id] = schema
                    elif opcode == rec.CHANNEL:
                        channel = rec.read_channel(block[start:end])
                        routes.pop(channel.id, None)
                        if channel.message_encoding == "cdr" and _is_wanted(channel.topic, topics):
                            routes[channel.id] = _route(channel, schemas)
                    elif opcode == rec.MESSAGE and skipped:
                        skipped -= 1
                    elif opcode == rec.MESSAGE:
                        id_, sequence, log_ns, sent_ns = rec.MESSAGE_HEAD.unpack_from(block, start)
                        route = routes.get(id_)
                        if route is not None:
                            yield RecordedMessage(
                                route.topic,
                                *route.as_today(block[start + head_bytes : end]),
                                Envelope(route.source, sequence, sent_ns, route.world_hash),
                                log_ns,
                                route.made_from,
                            )
            except rec.McapError as error:
                raise rec.McapError(f"{path}: {error}, at byte {found.offset}") from error


def _opened(opcode: int, data: bytes) -> tuple[bytes, Iterable[tuple[int, int, int]]]:
    """The records in a chunk, or a record by itself, and where their contents are."""
    if opcode != rec.CHUNK:
        return data, ((opcode, 0, len(data)),)
    block = rec.records_of(rec.read_chunk(data))
    return block, rec.split(block)


def _repeated(data: bytes) -> int:
    name, texts = rec.read_metadata(data)
    counts = texts.values() if name == REPEATED else ()
    return sum(int(count) for count in counts if count.isdecimal())


def _is_wanted(topic: str, topics: Collection[str] | None) -> bool:
    return topics is None or topic in topics


def _route(channel: rec.Channel, schemas: Mapping[int, rec.Schema]) -> _Route:
    texts, schema = channel.metadata, schemas.get(channel.schema_id)
    type_name = schema.name if schema is not None else ""
    topic = BY_NAME.get(channel.topic)
    decode = None
    if schema is not None and topic is not None:
        text = schema.data.decode(errors="replace")
        decode = wire.decoder_of_another_version(topic, type_name, text)
    return _Route(
        channel.topic,
        type_name,
        texts.get(SOURCE, ""),
        texts.get(WORLD_HASH, ""),
        texts.get(MADE_FROM, ""),
        decode,
    )

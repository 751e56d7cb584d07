"""Reads MCAP files of any writer: chunks or none, an index or none, whole or cut, of messages of
ROS 2, or of ROS 1 as `mcap convert` leaves them.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)

from mazebot.cli.bags.log_clock import Message, Move, Place, Span, in_time, place_in
from mazebot.cli.bags.ros1_messages import ROS_1, as_cdr, ros1_connection
from mazebot.common.files.reading import open_regular
from mazebot.common.recordings.mcap import mcap_records as mcap
from mazebot.common.recordings.mcap.mcap_scan import Found, chunk_head, content, records

_FORMATS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
}


class _Block(NamedTuple):
    """A chunk, or a message outside of any, in the file."""

    start_ns: int
    end_ns: int
    found: Found
    is_whole: bool = True


class McapBag:
    """The topics of an MCAP file, and its messages by their log time.

    Raises McapError where it is no MCAP file, OSError where it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: dict[int, mcap.Schema] = {}
        self._channels: dict[int, mcap.Channel] = {}
        self._blocks: list[_Block] = []
        self.is_whole = False
        """Whether the file has its end."""
        self.too_large = ""
        """Why the last chunk that is too large is left out."""
        self.damaged = 0
        """Chunks with a part that cannot be read; complete when all messages have been."""
        with open_regular(path) as file:
            self._look_through(file)
            if not self.is_whole or not self._channels:
                self._look_into_chunks(file)
        self.damaged = 0
        self.connections = [self._connection(channel) for channel in self._channels.values()]

    @property
    def end_ns(self) -> int:
        """When the last message was logged; 0: there is none."""
        return max((block.end_ns for block in self._blocks), default=0)

    @property
    def spans_ns(self) -> list[Span]:
        """Of parts of the file, in the order of writing."""
        return [(block.start_ns, block.end_ns) for block in self._blocks]

    def places(self) -> Iterator[Place]:
        """All messages in the order of writing."""
        with open_regular(self._path) as file:
            for number, block in enumerate(self._blocks):
                for i, (log_ns, channel, _) in enumerate(self._inside(file, block)):
                    yield Place(place_in(number, i), channel, log_ns)

    def messages(
        self, connections: Collection[Connection], moves: Sequence[Move] = ()
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """The messages of some topics by their log time; those of one time as they stand."""
        wanted = {connection.id: connection for connection in connections}
        self.damaged = 0
        starts_ns = [block.start_ns for block in self._blocks]
        with open_regular(self._path) as file:
            for log_ns, channel, data in in_time(
                starts_ns, lambda number: self._inside(file, self._blocks[number]), wanted, moves
            ):
                is_ros1 = self._channels[channel].message_encoding == ROS_1
                yield wanted[channel], log_ns, as_cdr(wanted[channel], data) if is_ros1 else data

    def _look_through(self, file: BinaryIO) -> None:
        """Where the messages are, and what stands outside of chunks."""
        end = len(mcap.MAGIC)
        for found in records(file):
            end = found.offset + found.length
            if found.opcode == mcap.CHUNK:
                self._blocks.append(_Block(*chunk_head(file, found)[:2], found))
            elif found.opcode == mcap.MESSAGE:
                self._blocks.append(_Block(*_message_span_ns(file, found), found))
            elif found.opcode == mcap.FOOTER:
                file.seek(end)
                self.is_whole = file.read(len(mcap.MAGIC)) == mcap.MAGIC
            elif found.opcode in (mcap.SCHEMA, mcap.CHANNEL):
                self._define(found.opcode, content(file, found))
        rest = os.fstat(file.fileno()).st_size - end
        if self.is_whole or rest < mcap.RECORD_HEAD.size:
            return
        file.seek(end)
        (opcode, _) = mcap.RECORD_HEAD.unpack(file.read(mcap.RECORD_HEAD.size))
        if opcode == mcap.CHUNK:
            begun = Found(opcode, end, rest)
            with contextlib.suppress(mcap.McapError):
                self._blocks.append(_Block(*chunk_head(file, begun)[:2], begun, is_whole=False))

    def _look_into_chunks(self, file: BinaryIO) -> None:
        for block in self._blocks:
            for _ in self._inside(file, block):
                pass

    def _define(self, opcode: int, data: bytes) -> None:
        if opcode == mcap.SCHEMA:
            schema = mcap.read_schema(data)
            self._schemas.setdefault(schema.id, schema)
        else:
            channel = mcap.read_channel(data)
            self._channels.setdefault(channel.id, channel)

    def _inside(self, file: BinaryIO, block: _Block) -> Iterator[Message]:
        """The messages of a block, as far as they go."""
        data = content(file, block.found)
        if block.found.opcode == mcap.MESSAGE:
            yield _message(data)
            return
        try:
            inner = (
                mcap.records_of(mcap.read_chunk(data)) if block.is_whole else mcap.begun_chunk(data)
            )
            for opcode, start, end in mcap.split(inner):
                if opcode == mcap.MESSAGE and end - start >= mcap.MESSAGE_HEAD.size:
                    yield _message(inner[start:end])
                elif opcode in (mcap.SCHEMA, mcap.CHANNEL):
                    self._define(opcode, inner[start:end])
        except mcap.McapError as error:
            if isinstance(error, mcap.McapSizeError):
                self.too_large = str(error)
            # What follows a damaged chunk may be sound. A file that is cut ends in a part of one.
            self.damaged += block.is_whole

    def _connection(self, channel: mcap.Channel) -> Connection:
        schema = self._schemas.get(channel.schema_id, mcap.Schema(0, "", "", b""))
        if channel.message_encoding == ROS_1:
            definition = schema.data.decode(errors="replace")
            return ros1_connection(channel.id, channel.topic, schema.name, definition, self)
        kind = _FORMATS.get(schema.encoding, MessageDefinitionFormat.NONE)
        text = "" if kind is MessageDefinitionFormat.NONE else schema.data.decode(errors="replace")
        how = ConnectionExtRosbag2(channel.message_encoding, [])
        return Connection(
            channel.id, channel.topic, schema.name, MessageDefinition(kind, text), "", 0, how, self
        )


def _message_span_ns(file: BinaryIO, found: Found) -> tuple[int, int]:
    if found.length < mcap.RECORD_HEAD.size + mcap.MESSAGE_HEAD.size:
        raise mcap.McapError("truncated record")
    file.seek(found.offset + mcap.RECORD_HEAD.size)
    _, _, log_ns, _ = mcap.MESSAGE_HEAD.unpack(file.read(mcap.MESSAGE_HEAD.size))
    return log_ns, log_ns


def _message(data: bytes) -> Message:
    channel, _, log_ns, _ = mcap.MESSAGE_HEAD.unpack_from(data)
    return log_ns, channel, data[mcap.MESSAGE_HEAD.size :]

"""Reads bags of ROS 1 (format 2.0): whole, not closed or cut. Messages whose definition is the same
in ROS 2 come as CDR.

The format: https://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

import bz2
import os
import struct
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
from rosbags.interfaces import Connection

from mazebot.cli.bags.log_clock import Move, Place, Span, in_time, place_in
from mazebot.cli.bags.ros1_messages import as_cdr, ros1_connection
from mazebot.common.files.limits import MAX_CHUNK_BYTES, MAX_TEXT_BYTES
from mazebot.common.files.reading import most_unpacked, open_regular

MAGIC = b"#ROSBAG V"
_VERSION = b"2.0\n"
_MESSAGE, _BAG, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 5, 6, 7
_MAX_HEAD_BYTES = 65_536
"""Of a record's head; that of a connection has a few hundred."""
_U32, _U64, _TIME = struct.Struct("<I"), struct.Struct("<Q"), struct.Struct("<II")
_Read = Callable[[int, int], bytes]
"""Bytes from a place, so many."""


class Ros1BagError(ValueError):
    """A bag that cannot be read; one line of text."""


class _Record(NamedTuple):
    at: int
    """Where it begins."""
    opcode: int
    fields: dict[bytes, bytes]
    data_at: int
    size: int
    """Bytes of its data, as far as they are there."""
    is_whole: bool


class Ros1Bag:
    """The topics of a file, and its messages by the time of logging.

    Raises Ros1BagError where it is no such file, OSError where it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._connections: dict[int, Connection] = {}
        self._chunks: list[_Record] = []
        self._spans_ns: dict[int, Span] = {}
        """Of the chunks, by where they begin."""
        self.is_whole = False
        """Whether the file has its end."""
        self.too_large = ""
        """Why the last chunk that is too large is left out."""
        self.damaged = 0
        """Chunks with a part that cannot be read; complete when all messages have been."""
        with open_regular(path) as file:
            self._look_through(_reader(file), os.fstat(file.fileno()).st_size)
            self._check_sizes(most_unpacked(file))
            are_known = self.is_whole and self._connections
            for record in self._chunks:
                if not are_known or record.at not in self._spans_ns:
                    times_ns = [log_ns for log_ns, _, _ in self._inside(_reader(file), record)]
                    self._spans_ns[record.at] = min(times_ns, default=0), max(times_ns, default=0)
        self.damaged = 0
        self.connections = list(self._connections.values())

    @property
    def spans_ns(self) -> list[Span]:
        """Of parts of the file, in the order of writing."""
        return [self._spans_ns[record.at] for record in self._chunks]

    @property
    def end_ns(self) -> int:
        """When the last message was logged; 0: there is none."""
        return max((end_ns for _, end_ns in self._spans_ns.values()), default=0)

    def places(self) -> Iterator[Place]:
        """All messages in the order of writing."""
        with open_regular(self._path) as file:
            for number, record in enumerate(self._chunks):
                for i, (log_ns, own, _) in enumerate(self._inside(_reader(file), record)):
                    yield Place(place_in(number, i), own, log_ns)

    def messages(
        self, connections: Collection[Connection], moves: Sequence[Move] = ()
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """The messages of some topics by their time; those of one time as they stand."""
        wanted = {connection.id: connection for connection in connections}
        self.damaged = 0
        starts_ns = [start_ns for start_ns, _ in self.spans_ns]
        with open_regular(self._path) as file:
            read = _reader(file)
            for log_ns, number, data in in_time(
                starts_ns, lambda chunk: self._inside(read, self._chunks[chunk]), wanted, moves
            ):
                yield wanted[number], log_ns, as_cdr(wanted[number], data)

    def _look_through(self, read: _Read, size: int) -> None:
        """Where the chunks are, and what stands outside of them."""
        if read(len(MAGIC), len(_VERSION)) != _VERSION:
            raise Ros1BagError("must be of format 2.0: rosbag migrate")
        chunks: int | None = None
        described = 0
        for record in _records(read, size, len(MAGIC) + len(_VERSION)):
            if record.opcode == _CHUNK:
                self._chunks.append(record)
            # The index is not needed: where it is damaged, the chunks tell.
            with suppress(Ros1BagError):
                if record.opcode == _BAG and _number(_U64, record.fields, b"index_pos"):
                    chunks = _number(_U32, record.fields, b"chunk_count")
                elif record.opcode == _CONNECTION and record.is_whole:
                    self._define(record, _content(read, record, MAX_TEXT_BYTES))
                elif record.opcode == _CHUNK_INFO and record.is_whole:
                    described += 1
                    span_ns = (
                        _time_ns(record.fields, b"start_time"),
                        _time_ns(record.fields, b"end_time"),
                    )
                    self._spans_ns[_number(_U64, record.fields, b"chunk_pos")] = span_ns
        # The description of the last chunk is the end of the file.
        self.is_whole = chunks == described

    def _check_sizes(self, most: int) -> None:
        """Raises Ros1BagError where the chunks together would grow to more."""
        if sum(_number(_U32, chunk.fields, b"size") for chunk in self._chunks) > most:
            raise Ros1BagError(f"must unpack to at most {most} bytes")

    def _inside(self, read: _Read, record: _Record) -> Iterator[tuple[int, int, bytes]]:
        """Time, connection and content of the messages of a chunk, as far as they go."""
        end = 0
        try:
            data = _unpacked(record, _content(read, record, MAX_CHUNK_BYTES))
            for inner in _records(lambda at, count: data[at : at + count], len(data)):
                if not inner.is_whole:
                    break
                end = inner.data_at + inner.size
                content = data[inner.data_at : end]
                if inner.opcode == _CONNECTION:
                    self._define(inner, content)
                elif inner.opcode == _MESSAGE:
                    number = _number(_U32, inner.fields, b"conn")
                    yield _time_ns(inner.fields, b"time"), number, content
        except _TooLargeError as error:
            self.too_large, end = str(error), -1
        except Ros1BagError:
            end = -1
        else:
            end = end if end == len(data) else -1
        # What follows a damaged chunk may be sound. A file that is cut ends in a part of one.
        self.damaged += end < 0 and record.is_whole

    def _define(self, record: _Record, data: bytes) -> None:
        number = _number(_U32, record.fields, b"conn")
        if number in self._connections:
            return
        fields = _fields(data)
        topic, kind, definition = (
            value.decode(errors="replace")
            for value in (
                record.fields.get(b"topic", b""),
                fields.get(b"type", b""),
                fields.get(b"message_definition", b""),
            )
        )
        self._connections[number] = ros1_connection(number, topic, kind, definition, self)


class _TooLargeError(Ros1BagError):
    pass


def _reader(file: Any) -> _Read:
    def read(at: int, count: int) -> bytes:
        file.seek(at)
        data: bytes = file.read(count)
        return data

    return read


def _content(read: _Read, record: _Record, most: int) -> bytes:
    """The data of a record, of at most so many bytes."""
    if record.size > most:
        raise _TooLargeError(f"has {record.size} bytes, must have at most {most}")
    return read(record.data_at, record.size)


def _records(read: _Read, size: int, at: int = 0) -> Iterator[_Record]:
    """The records up to a size, in order, until one that is cut off or damaged; of that, what is
    there of its data.
    """
    while at + 2 * _U32.size <= size:
        (length,) = _U32.unpack(read(at, _U32.size))
        data_at = at + 2 * _U32.size + length
        if length > _MAX_HEAD_BYTES or data_at > size:
            return
        fields = _fields(read(at + _U32.size, length))
        if len(fields.get(b"op", b"")) != 1:
            # A machine that crashed may leave zeros.
            return
        (data_size,) = _U32.unpack(read(data_at - _U32.size, _U32.size))
        is_whole = data_at + data_size <= size
        yield _Record(
            at, fields[b"op"][0], fields, data_at, min(data_size, size - data_at), is_whole
        )
        at = data_at + data_size


def _fields(head: bytes) -> dict[bytes, bytes]:
    """The fields of a head; those up to the first that is damaged."""
    fields, at = {}, 0
    while at + _U32.size <= len(head):
        (length,) = _U32.unpack_from(head, at)
        at += _U32.size
        name, equals, value = head[at : at + length].partition(b"=")
        if not equals or at + length > len(head):
            break
        fields[name] = value
        at += length
    return fields


def _numbers(form: struct.Struct, fields: dict[bytes, bytes], name: bytes) -> tuple[int, ...]:
    value = fields.get(name, b"")
    if len(value) != form.size:
        raise Ros1BagError(f"a record has no {name.decode()}")
    return form.unpack(value)


def _number(form: struct.Struct, fields: dict[bytes, bytes], name: bytes) -> int:
    return _numbers(form, fields, name)[0]


def _time_ns(fields: dict[bytes, bytes], name: bytes) -> int:
    seconds, nanoseconds = _numbers(_TIME, fields, name)
    return seconds * 1_000_000_000 + nanoseconds


def _unpacked(record: _Record, data: bytes) -> bytes:
    """The records of a chunk; of one that is cut, its beginning."""
    how = record.fields.get(b"compression", b"")
    most = min(_number(_U32, record.fields, b"size"), MAX_CHUNK_BYTES)
    try:
        if how == b"bz2":
            data = bz2.BZ2Decompressor().decompress(data, most + 1)
        elif how == b"lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, most + 1)
        elif how != b"none":
            raise Ros1BagError(f"a chunk is packed by {how.decode(errors='replace')!r:.20}")
    except (OSError, EOFError, RuntimeError) as error:
        raise Ros1BagError(f"a chunk cannot be unpacked: {error}") from error
    if len(data) > most:
        raise _TooLargeError(f"has more than {most} bytes unpacked")
    return data

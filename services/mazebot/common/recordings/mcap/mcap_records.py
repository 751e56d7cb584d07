"""Records of MCAP files (https://mcap.dev/spec), packed and read."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeVar

import zstandard

from mazebot.common.files.limits import MAX_CHUNK_BYTES
from mazebot.common.messages.wire import Buffer

T = TypeVar("T")

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = (
    range(9, 16)
)

RECORD_HEAD = struct.Struct("<BQ")
"""Opcode, and bytes of the content that follows."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence number, log time in ns, publish time in ns; then the message."""
CHUNK_HEAD = struct.Struct("<QQQI")
"""First and last log time in ns, size and CRC-32 (0: none) of the uncompressed records."""
INDEX_ENTRY = struct.Struct("<QQ")
"""Log time in ns, offset in the uncompressed records."""

_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_LARGE_BYTES = 1 << 16


class McapError(ValueError):
    """No valid MCAP file, or a part of one; one line of text."""


class McapSizeError(McapError):
    """A chunk that would take too much memory."""


class Schema(NamedTuple):
    """The definition of a message type, such as `sensor_msgs/msg/Imu`."""

    id: int
    name: str
    encoding: str
    data: bytes


class Channel(NamedTuple):
    """A series of messages of one type, with text about it."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: Mapping[str, str]


class Chunk(NamedTuple):
    """A block of messages."""

    start_ns: int
    end_ns: int
    size: int
    """Bytes of the uncompressed records."""
    crc: int
    compression: str
    compressed: bytes


class ChunkIndex(NamedTuple):
    """Where a chunk and the indexes of its messages are in the file; see the specification."""

    start_ns: int
    end_ns: int
    offset: int
    length: int
    index_offsets: Mapping[int, int]
    """Offset of each channel's message index."""
    index_length: int
    compression: str
    compressed_size: int
    size: int


class Entry(NamedTuple):
    """Where an attachment or a metadata record is."""

    offset: int
    length: int
    name: str
    media_type: str = ""
    time_ns: int = 0
    data_size: int = 0


def record(opcode: int, *content: bytes) -> bytes:
    """A record of some content."""
    data = b"".join(content)
    return RECORD_HEAD.pack(opcode, len(data)) + data


def header(profile: str, library: str) -> bytes:
    """The record at the beginning of a file, after `MAGIC`."""
    return record(HEADER, _text(profile), _text(library))


def schema_record(schema: Schema) -> bytes:
    """A record with a message definition."""
    head = _U16.pack(schema.id) + _text(schema.name) + _text(schema.encoding)
    return record(SCHEMA, head, _U32.pack(len(schema.data)), schema.data)


def channel_record(channel: Channel) -> bytes:
    """A record that introduces a channel."""
    head = _U16.pack(channel.id) + _U16.pack(channel.schema_id)
    texts = _text(channel.topic) + _text(channel.message_encoding)
    return record(CHANNEL, head, texts, _texts(channel.metadata))


def chunk_record(chunk: Chunk) -> bytes:
    """A record of a block of messages."""
    return record(
        CHUNK,
        CHUNK_HEAD.pack(chunk.start_ns, chunk.end_ns, chunk.size, chunk.crc),
        _text(chunk.compression),
        _U64.pack(len(chunk.compressed)),
        chunk.compressed,
    )


def message_index(channel: int, entries: Sequence[int]) -> bytes:
    """A record of the log times and offsets, in turn, of a channel's messages in a chunk."""
    packed = struct.pack(f"<{len(entries)}Q", *entries)
    return record(MESSAGE_INDEX, _U16.pack(channel), _U32.pack(len(packed)), packed)


def chunk_index(index: ChunkIndex) -> bytes:
    """A record of the summary about a chunk."""
    offsets = b"".join(struct.pack("<HQ", *entry) for entry in index.index_offsets.items())
    return record(
        CHUNK_INDEX,
        struct.pack("<4Q", index.start_ns, index.end_ns, index.offset, index.length),
        _U32.pack(len(offsets)),
        offsets,
        _U64.pack(index.index_length),
        _text(index.compression),
        struct.pack("<2Q", index.compressed_size, index.size),
    )


def attachment(name: str, media_type: str, data: bytes, time_ns: int) -> bytes:
    """A record with a file in it."""
    content = b"".join(
        (
            struct.pack("<2Q", time_ns, time_ns),
            _text(name),
            _text(media_type),
            _U64.pack(len(data)),
            data,
        )
    )
    return record(ATTACHMENT, content, _U32.pack(zlib.crc32(content)))


def attachment_index(entry: Entry) -> bytes:
    """A record of the summary about an attachment."""
    return record(
        ATTACHMENT_INDEX,
        struct.pack(
            "<5Q", entry.offset, entry.length, entry.time_ns, entry.time_ns, entry.data_size
        ),
        _text(entry.name),
        _text(entry.media_type),
    )


def metadata(name: str, values: Mapping[str, str]) -> bytes:
    """A record with named texts."""
    return record(METADATA, _text(name), _texts(values))


def metadata_index(entry: Entry) -> bytes:
    """A record of the summary about a metadata record."""
    return record(METADATA_INDEX, _U64.pack(entry.offset), _U64.pack(entry.length),
                  _text(entry.name))  # fmt: skip


def _text(text: str) -> bytes:
    data = text.encode()
    return _U32.pack(len(data)) + data


def _texts(values: Mapping[str, str]) -> bytes:
    data = b"".join(_text(key) + _text(value) for key, value in values.items())
    return _U32.pack(len(data)) + data


class ChunkHead(NamedTuple):
    """What a chunk says of its records: their times, and bytes with and without compression."""

    start_ns: int
    end_ns: int
    size: int
    compression: str
    compressed_size: int


class _Cursor:
    """Reads the fields of a record one after the other."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0

    def number(self, kind: struct.Struct) -> int:
        (value,) = kind.unpack_from(self.data, self.at)
        self.at += kind.size
        return int(value)

    def bytes(self, kind: struct.Struct = _U32) -> bytes:
        size = self.number(kind)
        self.at += size
        if self.at > len(self.data):
            raise McapError("truncated record")
        return self.data[self.at - size : self.at]

    def text(self) -> str:
        return self.bytes().decode(errors="replace")

    def texts(self) -> dict[str, str]:
        inner = _Cursor(self.bytes())
        values = {}
        while inner.at < len(inner.data):
            key = inner.text()
            values[key] = inner.text()
        return values


def read_schema(data: bytes) -> Schema:
    """The schema in a record's content. Raises McapError."""
    return _read(data, lambda at: Schema(at.number(_U16), at.text(), at.text(), at.bytes()))


def read_channel(data: bytes) -> Channel:
    """The channel in a record's content. Raises McapError."""
    return _read(
        data,
        lambda at: Channel(at.number(_U16), at.number(_U16), at.text(), at.text(), at.texts()),
    )


def read_metadata(data: bytes) -> tuple[str, dict[str, str]]:
    """Name and texts of a metadata record's content. Raises McapError."""
    return _read(data, lambda at: (at.text(), at.texts()))


def read_index(data: bytes) -> tuple[int, int]:
    """Channel, and number of messages, of a message index's content. Raises McapError."""
    return _read(data, lambda at: (at.number(_U16), at.number(_U32) // INDEX_ENTRY.size))


def read_chunk(data: bytes) -> Chunk:
    """The chunk in a record's content. Raises McapError."""

    def read(at: _Cursor) -> Chunk:
        start_ns, end_ns, size, crc = CHUNK_HEAD.unpack_from(data)
        at.at = CHUNK_HEAD.size
        return Chunk(start_ns, end_ns, size, crc, at.text(), at.bytes(_U64))

    return _read(data, read)


def read_chunk_head(data: bytes) -> ChunkHead:
    """What the chunk is whose content begins so. Raises McapError."""

    def read(at: _Cursor) -> ChunkHead:
        start_ns, end_ns, size, _ = CHUNK_HEAD.unpack_from(data)
        at.at = CHUNK_HEAD.size
        return ChunkHead(start_ns, end_ns, size, at.text(), at.number(_U64))

    return _read(data, read)


def _read(data: bytes, read: Callable[[_Cursor], T]) -> T:
    try:
        return read(_Cursor(data))
    except struct.error as error:
        raise McapError("truncated record") from error


def compressed(pieces: Sequence[Buffer], start_ns: int, end_ns: int, level: int) -> Chunk:
    """A chunk of the records in these pieces. Its checksum is that of zstd, at a third of the cost
    of MCAP's.
    """
    size = sum(map(len, pieces))
    compressor = zstandard.ZstdCompressor(level=level, write_checksum=True).compressobj(size)
    data: list[bytes] = []
    small: list[Buffer] = []
    for piece in pieces:
        small.append(piece)
        if len(piece) > _LARGE_BYTES:
            # A picture is not copied.
            small.pop()
            data += (compressor.compress(b"".join(small)), compressor.compress(piece))
            small.clear()
    data += (compressor.compress(b"".join(small)), compressor.flush())
    return Chunk(start_ns, end_ns, size, 0, "zstd", b"".join(data))


def records_of(chunk: Chunk) -> bytes:
    """The uncompressed records of a chunk. Raises McapError if they are damaged."""
    check_size(chunk.size)
    try:
        if chunk.compression == "zstd":
            data = unpacked_zstd(chunk.compressed, chunk.size)
        elif chunk.compression == "lz4":
            # Only other people's files need it.
            import lz4.frame  # type: ignore[import-untyped] # noqa: PLC0415

            unpacker = lz4.frame.LZ4FrameDecompressor()
            data = unpacker.decompress(chunk.compressed, max_length=chunk.size)
            if not unpacker.eof and unpacker.decompress(b"", max_length=1):
                raise McapError("corrupt chunk")
        elif chunk.compression == "":
            data = chunk.compressed
        else:
            raise McapError(f"unknown compression {chunk.compression!r}")
    except (zstandard.ZstdError, RuntimeError) as error:
        raise McapError("corrupt chunk") from error
    if chunk.crc and zlib.crc32(data) != chunk.crc:
        raise McapError("corrupt chunk")
    return bytes(data)


def check_size(size: int) -> None:
    """Raises McapError where a chunk or a message that declares a size must not be unpacked."""
    if size > MAX_CHUNK_BYTES:
        raise McapSizeError(f"has {size} bytes unpacked, must have at most {MAX_CHUNK_BYTES}")


def unpacked_zstd(data: bytes, max_bytes: int) -> bytes:
    """The content of data packed by zstd.

    Raises McapError if it has more bytes, zstandard.ZstdError if it is damaged.
    """
    # A frame that tells its size is unpacked to that, whatever the maximum.
    if zstandard.frame_content_size(data) > max_bytes:
        raise McapSizeError(f"has more than {max_bytes} bytes unpacked")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=max_bytes)


def begun_chunk(data: bytes) -> bytes:
    """The uncompressed records, as far as they go, of a chunk whose content begins so.

    Raises McapError if not even its beginning can be read.
    """
    _, _, most, compression, size = read_chunk_head(data)
    check_size(most)
    body = data[CHUNK_HEAD.size + _U32.size + len(compression.encode()) + _U64.size :][:size]
    try:
        if compression == "zstd":
            return zstandard.ZstdDecompressor().stream_reader(body).read(most)
        if compression == "lz4":
            # Only other people's files need it.
            import lz4.frame  # noqa: PLC0415

            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(body, max_length=most))
    except (zstandard.ZstdError, RuntimeError) as error:
        raise McapError("corrupt chunk") from error
    if compression:
        raise McapError(f"unknown compression {compression!r}")
    return body


def split(records: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, and start and end of the content, of each record in a chunk. Raises McapError."""
    at, end = 0, len(records)
    while at < end:
        if end - at < RECORD_HEAD.size:
            raise McapError("truncated record")
        opcode, size = RECORD_HEAD.unpack_from(records, at)
        at += RECORD_HEAD.size
        if size > end - at:
            raise McapError("truncated record")
        yield opcode, at, at + size
        at += size

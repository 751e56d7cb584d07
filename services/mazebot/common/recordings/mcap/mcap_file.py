"""Writes an MCAP file chunk by chunk, so that whatever is written can be read, at any time."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from mazebot.common.messages.wire import Buffer
from mazebot.common.recordings.mcap import mcap_records as rec
from mazebot.common.recordings.mcap.mcap_scan import Contents, scan

PROFILE = "ros2"
LIBRARY = "mazebot"
COMPRESSION_LEVEL = 1
Row = tuple[int, int, int, int, tuple[Buffer, ...]]
"""Channel, sequence number, log time in ns, publish time in ns, and the message in pieces."""

_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_HEAD_REST = rec.MESSAGE_HEAD.size


class McapFile:
    """An MCAP file of the ROS 2 profile, not yet ended.

    Each call that writes does so in one piece. If that fails (the disk is full), the file is cut
    back to what it was.
    """

    def __init__(self, path: Path, level: int = COMPRESSION_LEVEL) -> None:
        """Begin a file, or go on with one that was begun here, after its last whole chunk: its end
        and attachments are dropped, to be written again by `close()`.

        Raises OSError if it cannot be written, McapError if there is another file.
        """
        exists = path.exists() and path.stat().st_size > 0
        self._contents = scan(path) if exists else Contents()
        # Unbuffered: what is written is with the kernel, and outlives this process.
        self._file = path.open("r+b" if exists else "wb", buffering=0)
        try:
            if self._contents.end:
                self._cut()
            else:
                self._file.truncate(0)
                self._append(rec.MAGIC + rec.header(PROFILE, LIBRARY))
        except OSError:
            self._file.close()
            raise
        self._level = level
        self._schemas = {schema.name: schema.id for schema in self._contents.schemas}

    @property
    def size(self) -> int:
        """Bytes of the file so far."""
        return self._contents.end

    @property
    def texts(self) -> Mapping[str, Mapping[str, str]]:
        """The texts of the metadata records, by their names."""
        return self._contents.texts

    @property
    def channels(self) -> Sequence[rec.Channel]:
        """All channels; the position of each is its id."""
        return self._contents.channels

    @property
    def counts(self) -> Mapping[int, int]:
        """Messages by channel."""
        return self._contents.counts

    def add_metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Write named texts. Raises OSError."""
        data = rec.metadata(name, texts)
        offset = self._append(data)
        self._contents.metadata.append(rec.Entry(offset, len(data), name))
        self._contents.texts[name] = dict(texts)

    def add_channel(
        self, topic: str, type_name: str, definition: str, metadata: Mapping[str, str]
    ) -> None:
        """Introduce a channel of CDR messages; its id is the number of channels before it.

        Raises OSError.
        """
        data = b""
        known = self._schemas.get(type_name)
        # A schema's id must not be 0.
        schema = rec.Schema(
            known or len(self._schemas) + 1, type_name, "ros2msg", definition.encode()
        )
        if known is None:
            data = rec.schema_record(schema)
        channel = rec.Channel(len(self.channels), schema.id, topic, "cdr", dict(metadata))
        self._append(data + rec.channel_record(channel))
        if known is None:
            self._schemas[type_name] = schema.id
            self._contents.schemas.append(schema)
        self._contents.channels.append(channel)

    def add_messages(self, rows: Sequence[Row]) -> None:
        """Write messages of known channels as one chunk. Raises OSError."""
        if not rows:
            return
        pieces: list[Buffer] = []
        index: dict[int, list[int]] = {}
        offset, head, rest = 0, _MESSAGE_HEAD.pack, _HEAD_REST
        for channel, sequence, log_ns, publish_ns, data in rows:
            length = sum(map(len, data)) + rest
            pieces.append(head(rec.MESSAGE, length, channel, sequence, log_ns, publish_ns))
            pieces += data
            entries = index.get(channel)
            if entries is None:
                entries = index[channel] = []
            entries += (log_ns, offset)
            offset += rec.RECORD_HEAD.size + length
        times_ns = [row[2] for row in rows]
        chunk = rec.compressed(pieces, min(times_ns), max(times_ns), self._level)
        written = rec.chunk_record(chunk)
        indexes = {
            channel: rec.message_index(channel, entries) for channel, entries in index.items()
        }
        start = self._append(b"".join((written, *indexes.values())))
        offsets, at = {}, start + len(written)
        for channel, packed in indexes.items():
            offsets[channel] = at
            at += len(packed)
            self._contents.counts[channel] += len(index[channel]) // 2
        self._contents.chunks.append(
            rec.ChunkIndex(
                *(chunk.start_ns, chunk.end_ns, start, len(written), offsets),
                at - start - len(written),
                *(chunk.compression, len(chunk.compressed), chunk.size),
            )
        )

    def close(self, attachments: Mapping[str, tuple[str, bytes]] = {}) -> None:
        """End the file, with files of a name, a media type and their content attached.

        Raises OSError; the file is closed in any case, and can be gone on with.
        """
        if self._file.closed:
            return
        try:
            self._append(self._end(attachments))
        finally:
            self._file.close()

    def _end(self, attachments: Mapping[str, tuple[str, bytes]]) -> bytes:
        """All that follows the last chunk."""
        contents = self._contents
        pieces: list[bytes] = []
        entries: list[rec.Entry] = []
        at = contents.end
        start_ns = min((chunk.start_ns for chunk in contents.chunks), default=0)
        end_ns = max((chunk.end_ns for chunk in contents.chunks), default=0)
        for name, (media_type, data) in attachments.items():
            pieces.append(rec.attachment(name, media_type, data, end_ns))
            length = len(pieces[-1])
            entries.append(rec.Entry(at, length, name, media_type, end_ns, len(data)))
            at += length
        pieces.append(rec.record(rec.DATA_END, bytes(4)))
        summary_start = at + len(pieces[-1])
        counts = b"".join(struct.pack("<HQ", *entry) for entry in sorted(contents.counts.items()))
        statistics = struct.pack(
            "<QHIIIIQQI",
            *(contents.counts.total(), len(contents.schemas), len(contents.channels)),
            *(len(entries), len(contents.metadata), len(contents.chunks)),
            *(start_ns, end_ns, len(counts)),
        )
        groups = (
            (rec.SCHEMA, map(rec.schema_record, contents.schemas)),
            (rec.CHANNEL, map(rec.channel_record, contents.channels)),
            (rec.STATISTICS, (rec.record(rec.STATISTICS, statistics, counts),)),
            (rec.CHUNK_INDEX, map(rec.chunk_index, contents.chunks)),
            (rec.ATTACHMENT_INDEX, map(rec.attachment_index, entries)),
            (rec.METADATA_INDEX, map(rec.metadata_index, contents.metadata)),
        )
        summary, offsets = b"", b""
        for opcode, group in groups:
            data = b"".join(group)
            if data:
                start = summary_start + len(summary)
                offsets += rec.record(
                    rec.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start, len(data))
                )
                summary += data
        offset_start = summary_start + len(summary)
        footer = rec.RECORD_HEAD.pack(rec.FOOTER, 20)
        footer += struct.pack("<2Q", summary_start, offset_start)
        crc = zlib.crc32(footer, zlib.crc32(offsets, zlib.crc32(summary)))
        return b"".join((*pieces, summary, offsets, footer, struct.pack("<I", crc), rec.MAGIC))

    def _append(self, data: bytes) -> int:
        """Write at the end; return where that was."""
        start = self._contents.end
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            self._cut()
            raise
        self._contents.end = start + len(data)
        return start

    def _cut(self) -> None:
        """Drop what follows the last whole chunk."""
        self._file.truncate(self._contents.end)
        self._file.seek(self._contents.end)


def repair(path: Path, attachments: Mapping[str, tuple[str, bytes]]) -> bool:
    """Give a file that was cut off its end again; return whether it needed one.

    Only what cannot be read is removed. Raises OSError, or McapError if it is no MCAP.
    """
    if path.stat().st_size and scan(path).is_whole:
        return False
    McapFile(path).close(attachments)
    return True

"""Looks an MCAP file through without reading its messages: what is whole in it, and where."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mazebot.common.recordings.mcap import mcap_records as rec

_HEAD_BYTES = rec.CHUNK_HEAD.size + 64


class Found(NamedTuple):
    """A whole record in a file."""

    opcode: int
    offset: int
    length: int
    """Bytes of the record with its head."""


def records(file: BinaryIO) -> Iterator[Found]:
    """The whole records of a file, in order, until its end or the first that is cut off.

    Raises McapError if the file is no MCAP.
    """
    size = os.fstat(file.fileno()).st_size
    file.seek(0)
    if file.read(len(rec.MAGIC)) != rec.MAGIC:
        raise rec.McapError(f"{file.name}: not an MCAP file")
    at = len(rec.MAGIC)
    while at + rec.RECORD_HEAD.size <= size:
        file.seek(at)
        opcode, length = rec.RECORD_HEAD.unpack(file.read(rec.RECORD_HEAD.size))
        end = at + rec.RECORD_HEAD.size + length
        if opcode == 0 or end > size:
            # A machine that crashed may leave zeros.
            return
        yield Found(opcode, at, end - at)
        if opcode == rec.FOOTER:
            return
        at = end


def content(file: BinaryIO, found: Found) -> bytes:
    """The content of a record."""
    file.seek(found.offset + rec.RECORD_HEAD.size)
    return file.read(found.length - rec.RECORD_HEAD.size)


@dataclass
class Contents:
    """What a file's data section has, up to the last whole chunk with its indexes."""

    schemas: list[rec.Schema] = field(default_factory=list)
    channels: list[rec.Channel] = field(default_factory=list)
    chunks: list[rec.ChunkIndex] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    """Messages by channel."""
    metadata: list[rec.Entry] = field(default_factory=list)
    texts: dict[str, dict[str, str]] = field(default_factory=dict)
    """The texts of the metadata records, by their names."""
    end: int = 0
    """Where the data section can go on."""
    is_whole: bool = False
    """Whether the file was ended properly."""


def scan(path: Path) -> Contents:
    """Look through a file that `McapFile` has begun.

    Raises McapError if it is no MCAP, OSError if it cannot be read.
    """
    contents = Contents()
    with path.open("rb") as file:
        chunk: Found | None = None
        indexes: list[tuple[Found, int, int]] = []
        for found in records(file):
            if found.opcode == rec.MESSAGE_INDEX:
                indexes.append((found, *rec.read_index(content(file, found))))
                continue
            if chunk is not None:
                _add_chunk(contents, file, chunk, indexes)
                chunk, indexes = None, []
            if found.opcode in (rec.ATTACHMENT, rec.DATA_END):
                contents.is_whole = _has_end(file)
                return contents
            if found.opcode == rec.FOOTER:
                # One here is damage: nobody would read on after it.
                break
            if found.opcode == rec.CHUNK:
                chunk = found
                continue
            _add(contents, file, found)
            contents.end = found.offset + found.length
        if chunk is not None and _is_complete(file, chunk, indexes):
            _add_chunk(contents, file, chunk, indexes)
    return contents


def _add(contents: Contents, file: BinaryIO, found: Found) -> None:
    if found.opcode == rec.SCHEMA:
        contents.schemas.append(rec.read_schema(content(file, found)))
    elif found.opcode == rec.CHANNEL:
        contents.channels.append(rec.read_channel(content(file, found)))
    elif found.opcode == rec.METADATA:
        name, texts = rec.read_metadata(content(file, found))
        contents.metadata.append(rec.Entry(found.offset, found.length, name))
        contents.texts[name] = texts


def chunk_head(file: BinaryIO, chunk: Found) -> rec.ChunkHead:
    """What a chunk says of its records. Raises McapError."""
    head = Found(chunk.opcode, chunk.offset, min(chunk.length, _HEAD_BYTES))
    return rec.read_chunk_head(content(file, head))


def _add_chunk(
    contents: Contents, file: BinaryIO, chunk: Found, indexes: list[tuple[Found, int, int]]
) -> None:
    told = chunk_head(file, chunk)
    for _, channel, count in indexes:
        contents.counts[channel] += count
    contents.end = chunk.offset + chunk.length + sum(found.length for found, _, _ in indexes)
    contents.chunks.append(
        rec.ChunkIndex(
            told.start_ns,
            told.end_ns,
            chunk.offset,
            chunk.length,
            {channel: found.offset for found, channel, _ in indexes},
            sum(found.length for found, _, _ in indexes),
            told.compression,
            told.compressed_size,
            told.size,
        )
    )


def _is_complete(file: BinaryIO, chunk: Found, indexes: list[tuple[Found, int, int]]) -> bool:
    """Whether the last chunk of a file is undamaged, and has all its indexes."""
    try:
        records_ = rec.records_of(rec.read_chunk(content(file, chunk)))
        messages = sum(opcode == rec.MESSAGE for opcode, _, _ in rec.split(records_))
    except rec.McapError:
        return False
    return messages == sum(count for _, _, count in indexes)


def _has_end(file: BinaryIO) -> bool:
    file.seek(-len(rec.MAGIC), os.SEEK_END)
    return file.read() == rec.MAGIC

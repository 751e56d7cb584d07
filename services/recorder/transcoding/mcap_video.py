"""Replaces the camera's pictures in an MCAP file by video that Foxglove plays."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from services.common.recordings import mcap_records as rec
from services.common.recordings.mcap_file import McapFile, Row
from services.common.recordings.mcap_messages import MADE_FROM
from services.common.recordings.mcap_scan import content, records
from services.common.recordings.run_folder import attachments_of
from services.recorder.transcoding.vp9 import VideoError, VideoFrame, encode

VIDEO_TYPE = "foxglove_msgs/msg/CompressedVideo"
VIDEO_FORMAT = "vp9"
_PICTURE_TYPE = "sensor_msgs/msg/CompressedImage"
_DEFINITION = f"""\
# A frame of a video. Its picture needs those before it, back to the newest key frame.
builtin_interfaces/Time timestamp
string frame_id
uint8[] data
string format
{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_CHUNK_BYTES = 1024 * 1024
"""Larger than while recording: it compresses better, and nothing has to be flushed."""
_LEVEL = 9
_CDR = b"\x00\x01\x00\x00"
"""Little endian."""


class _Picture(NamedTuple):
    """A CompressedImage."""

    sec: int
    nanosec: int
    frame_id: str
    data: bytes


def transcode_mcap(path: Path) -> bool:
    """Replace a whole file by one with video in the channels of pictures that were compressed for
    the recording, whatever happens either the old or the new one; False if there are none.

    The counts, times and sequence numbers of all messages stay. Raises VideoError if that is not
    possible, McapError for a damaged file, OSError for a disk that is full or a file that is gone.
    """
    videos = {
        channel: encode(_pictures(path, channel), path.with_suffix(f".{channel}.mp4"))
        for channel in _channels_of_pictures(path)
    }
    if not videos:
        return False
    whole = path.with_suffix(".whole_mcap")
    whole.unlink(missing_ok=True)
    try:
        _rewrite(path, whole, videos)
        with whole.open("rb") as file:
            os.fsync(file.fileno())
        whole.replace(path)
    finally:
        whole.unlink(missing_ok=True)
    return True


def frame_of(cdr: bytes) -> bytes:
    """The encoded frame in a message of VIDEO_TYPE. Raises VideoError if it is none."""
    return _read(cdr, is_video=True).data


def _rewrite(
    path: Path,
    whole: Path,
    videos: Mapping[int, Iterator[VideoFrame]],
) -> None:
    file = McapFile(whole, level=_LEVEL)
    schemas: dict[int, rec.Schema] = {}
    channels: dict[int, int] = {}
    rows: list[Row] = []
    size = 0
    for opcode, data in _records(path):
        if opcode == rec.METADATA:
            file.add_metadata(*rec.read_metadata(data))
        elif opcode == rec.SCHEMA:
            schema = rec.read_schema(data)
            schemas[schema.id] = schema
        elif opcode == rec.CHANNEL:
            channel = rec.read_channel(data)
            if channel.id not in channels:
                channels[channel.id] = len(channels)
                _add_channel(file, channel, schemas[channel.schema_id], channel.id in videos)
        elif opcode == rec.MESSAGE:
            id_, sequence, log_ns, sent_ns = rec.MESSAGE_HEAD.unpack_from(data)
            cdr = data[rec.MESSAGE_HEAD.size :]
            if id_ in videos:
                cdr = _video_cdr(_read(cdr), next(videos[id_], None))
            rows.append((channels[id_], sequence, log_ns, sent_ns, (cdr,)))
            size += len(cdr)
            if size >= _CHUNK_BYTES:
                file.add_messages(rows)
                rows, size = [], 0
    file.add_messages(rows)
    file.close(attachments_of(path.parent))


def _add_channel(file: McapFile, channel: rec.Channel, schema: rec.Schema, is_video: bool) -> None:
    if is_video:
        # Not the hash of the type that the channel had.
        texts = {key: text for key, text in channel.metadata.items() if key != "topic_type_hash"}
        topic = f"{channel.metadata[MADE_FROM]}/video"
        file.add_channel(topic, VIDEO_TYPE, _DEFINITION, texts)
    else:
        file.add_channel(channel.topic, schema.name, schema.data.decode(), channel.metadata)


def _channels_of_pictures(path: Path) -> list[int]:
    """Those that are compressed forms of another topic: what was on the wire stays as it is."""
    schemas: dict[int, str] = {}
    found: dict[int, None] = {}
    for opcode, data in _records(path):
        if opcode == rec.SCHEMA:
            schema = rec.read_schema(data)
            schemas[schema.id] = schema.name
        elif opcode == rec.CHANNEL:
            channel = rec.read_channel(data)
            is_picture = schemas.get(channel.schema_id) == _PICTURE_TYPE
            if is_picture and channel.metadata.get(MADE_FROM):
                found[channel.id] = None
    return list(found)


def _pictures(path: Path, channel: int) -> Iterator[bytes]:
    for opcode, data in _records(path):
        if opcode == rec.MESSAGE and rec.MESSAGE_HEAD.unpack_from(data)[0] == channel:
            yield _read(data[rec.MESSAGE_HEAD.size :]).data


def _records(path: Path) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of each record of the data section, those in chunks too."""
    with path.open("rb") as file:
        for found in records(file):
            if found.opcode == rec.DATA_END:
                return
            if found.opcode == rec.CHUNK:
                block = rec.records_of(rec.read_chunk(content(file, found)))
                for opcode, start, end in rec.split(block):
                    yield opcode, block[start:end]
            elif found.opcode in (rec.SCHEMA, rec.CHANNEL, rec.MESSAGE, rec.METADATA):
                yield found.opcode, content(file, found)


def _read(cdr: bytes, is_video: bool = False) -> _Picture:
    """A CompressedImage, or a CompressedVideo, from little-endian CDR."""
    if cdr[:4] != _CDR:
        raise VideoError("a picture's message is not little-endian CDR")
    try:
        sec, nanosec, length = struct.unpack_from("<iII", cdr, 4)
        frame_id, at = cdr[16 : 15 + length].decode(), _aligned(12 + length)
        if not is_video:
            # The format comes before the data, not after it.
            at = _aligned(at + 4 + struct.unpack_from("<I", cdr, 4 + at)[0])
        (size,) = struct.unpack_from("<I", cdr, 4 + at)
    except (struct.error, UnicodeDecodeError) as error:
        raise VideoError("a picture's message is cut off") from error
    return _Picture(sec, nanosec, frame_id, cdr[8 + at : 8 + at + size])


def _video_cdr(picture: _Picture, frame: VideoFrame | None) -> bytes:
    if frame is None:
        raise VideoError("the video has fewer frames than pictures")
    frame_id = picture.frame_id.encode() + b"\x00"
    body = struct.pack("<iII", picture.sec, picture.nanosec, len(frame_id)) + frame_id
    body += bytes(_aligned(len(body)) - len(body))
    body += struct.pack("<I", len(frame.data)) + frame.data
    body += bytes(_aligned(len(body)) - len(body))
    kind = VIDEO_FORMAT.encode() + b"\x00"
    return _CDR + body + struct.pack("<I", len(kind)) + kind


def _aligned(offset: int) -> int:
    """To the next multiple of four."""
    return (offset + 3) & ~3

"""Replaces the camera's pictures in an MCAP file by video that Foxglove plays."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from mazebot.common.messages import wire
from mazebot.common.messages.messages import CompressedImage
from mazebot.common.messages.topics import CAMERA_COMPRESSED, DEPTH_IMAGE
from mazebot.common.messages.wire import WireError
from mazebot.common.recordings.mcap import mcap_records as rec
from mazebot.common.recordings.mcap.mcap_channels import definition_of
from mazebot.common.recordings.mcap.mcap_file import McapFile, Row
from mazebot.common.recordings.mcap.mcap_messages import MADE_FROM, read_messages
from mazebot.common.recordings.mcap.mcap_scan import content, records
from mazebot.common.recordings.run_folder import attachments_of
from mazebot.recorder.transcoding.depth import compressed_depth
from mazebot.recorder.transcoding.vp9 import VideoError, VideoFrame, encode

VIDEO_TYPE = "foxglove_msgs/msg/CompressedVideo"
VIDEO_FORMAT = "vp9"
_PICTURE_TYPE = "sensor_msgs/msg/CompressedImage"
_IMAGE_TYPE = "sensor_msgs/msg/Image"
_NO_PICTURES = ("", DEPTH_IMAGE.name)
"""What compressed images are not made a video, by what they were made from: those that were on the
wire so, and depth images, which are as small as they get.
"""
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


class _Conversion(NamedTuple):
    """What becomes of the messages of a channel."""

    topic: str
    type_name: str
    definition: str
    convert: Callable[[bytes], bytes]
    """CDR to CDR, of each message in order."""


def transcode_mcap(path: Path) -> bool:
    """Replace a whole file by one with video in the channels of pictures that were compressed for
    the recording, whatever happens either the old or the new one; False if there are none. Depth
    images become PNGs in millimetres.

    The counts, times and sequence numbers of all messages stay. Raises VideoError if that is not
    possible, McapError for a damaged file, OSError for a disk that is full or a file that is gone.
    """
    conversions = _conversions(path)
    if not any(one.type_name == VIDEO_TYPE for one in conversions.values()):
        return False
    whole = path.with_suffix(".whole_mcap")
    whole.unlink(missing_ok=True)
    try:
        _rewrite(path, whole, conversions)
        with whole.open("rb") as file:
            os.fsync(file.fileno())
        whole.replace(path)
    except WireError as error:
        raise VideoError(f"{path}: {error}") from error
    finally:
        whole.unlink(missing_ok=True)
    return True


def video_topic(made_from: str) -> str:
    """The topic with the video of another topic's pictures."""
    return f"{made_from}/video"


def read_video(parts: Sequence[Path], made_from: str) -> Iterator[tuple[int, VideoFrame]]:
    """The stamp in ns and the frame of each picture of a topic in files with video, in order.

    Raises VideoError or McapError for a damaged file, OSError.
    """
    for message in read_messages(parts, {video_topic(made_from)}):
        if message.type_name == VIDEO_TYPE:
            stamp_ns, _, frame = frame_of(message.data)
            yield stamp_ns, frame


def frame_of(cdr: bytes) -> tuple[int, str, VideoFrame]:
    """Stamp in ns, frame id and encoded picture of a message of VIDEO_TYPE.

    Raises VideoError if it is none.
    """
    try:
        sec, nanosec, length = struct.unpack_from("<iII", cdr, 4)
        at = 4 + _aligned(12 + length)
        (size,) = struct.unpack_from("<I", cdr, at)
    except struct.error as error:
        raise VideoError("a video's message is cut off") from error
    frame_id = cdr[16 : 15 + length].decode(errors="replace")
    return sec * 1_000_000_000 + nanosec, frame_id, VideoFrame(cdr[at + 4 : at + 4 + size])


def _conversions(path: Path) -> dict[int, _Conversion]:
    """By channel: of pictures that are compressed forms of another topic, not of any that were on
    the wire so, and of depth images.
    """
    schemas: dict[int, str] = {}
    found: dict[int, _Conversion] = {}
    for opcode, data in _records(path):
        if opcode == rec.SCHEMA:
            schema = rec.read_schema(data)
            schemas[schema.id] = schema.name
        elif opcode == rec.CHANNEL:
            channel = rec.read_channel(data)
            kind = schemas.get(channel.schema_id)
            if channel.topic == DEPTH_IMAGE.name and kind == _IMAGE_TYPE:
                topic = f"{channel.topic}/compressedDepth"
                definition = definition_of(_PICTURE_TYPE)
                found[channel.id] = _Conversion(topic, _PICTURE_TYPE, definition, compressed_depth)
            elif kind == _PICTURE_TYPE and channel.metadata.get(MADE_FROM, "") not in _NO_PICTURES:
                found[channel.id] = _video(path, channel)
    return found


def _video(path: Path, channel: rec.Channel) -> _Conversion:
    frames = encode(_pictures(path, channel.id), path.with_suffix(f".{channel.id}.mp4"))

    def convert(cdr: bytes) -> bytes:
        frame = next(frames, None)
        if frame is None:
            raise VideoError("the video has fewer frames than pictures")
        return _video_cdr(wire.decode(CAMERA_COMPRESSED, cdr), frame)

    return _Conversion(video_topic(channel.metadata[MADE_FROM]), VIDEO_TYPE, _DEFINITION, convert)


def _rewrite(
    path: Path,
    whole: Path,
    conversions: Mapping[int, _Conversion],
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
                conversion = conversions.get(channel.id)
                _add_channel(file, channel, schemas[channel.schema_id], conversion)
        elif opcode == rec.MESSAGE:
            id_, sequence, log_ns, sent_ns = rec.MESSAGE_HEAD.unpack_from(data)
            cdr = data[rec.MESSAGE_HEAD.size :]
            if id_ in conversions:
                cdr = conversions[id_].convert(cdr)
            rows.append((channels[id_], sequence, log_ns, sent_ns, (cdr,)))
            size += len(cdr)
            if size >= _CHUNK_BYTES:
                file.add_messages(rows)
                rows, size = [], 0
    file.add_messages(rows)
    file.close(attachments_of(path.parent))


def _add_channel(
    file: McapFile, channel: rec.Channel, schema: rec.Schema, conversion: _Conversion | None
) -> None:
    if conversion is None:
        file.add_channel(channel.topic, schema.name, schema.data.decode(), channel.metadata)
        return
    # Not the hash of the type that the channel had.
    texts = {key: text for key, text in channel.metadata.items() if key != "topic_type_hash"}
    texts.setdefault(MADE_FROM, channel.topic)
    file.add_channel(conversion.topic, conversion.type_name, conversion.definition, texts)


def _pictures(path: Path, channel: int) -> Iterator[bytes]:
    for opcode, data in _records(path):
        if opcode == rec.MESSAGE and rec.MESSAGE_HEAD.unpack_from(data)[0] == channel:
            picture = wire.decode(CAMERA_COMPRESSED, data[rec.MESSAGE_HEAD.size :])
            yield picture.data.tobytes()


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


def _video_cdr(picture: CompressedImage, frame: VideoFrame) -> bytes:
    """A CompressedVideo with the stamp and frame id of a picture."""
    stamp, frame_id = picture.header.stamp, picture.header.frame_id.encode() + b"\x00"
    body = struct.pack("<iII", stamp.sec, stamp.nanosec, len(frame_id)) + frame_id
    body += bytes(_aligned(len(body)) - len(body))
    body += struct.pack("<I", len(frame.data)) + frame.data
    body += bytes(_aligned(len(body)) - len(body))
    kind = VIDEO_FORMAT.encode() + b"\x00"
    return _CDR + body + struct.pack("<I", len(kind)) + kind


def _aligned(offset: int) -> int:
    """To the next multiple of four."""
    return (offset + 3) & ~3

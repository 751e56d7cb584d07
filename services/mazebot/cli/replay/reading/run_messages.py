"""Reads the run of Mazebot that a `run.mcap` holds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mazebot.cli.replay.reading.recording import Recording
from mazebot.cli.replay.reading.replayed import Replayed
from mazebot.common.config import ConfigError
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import (
    BY_NAME,
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CLOCK,
    EDGE,
    PARAMETERS,
    SERVICES,
    Delivery,
    Topic,
)
from mazebot.common.recordings.mcap.mcap_messages import RecordedMessage, read_messages
from mazebot.common.recordings.mcap.mcap_records import McapError
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.recorder.transcoding.as_recorded import as_recorded
from mazebot.recorder.transcoding.mcap_video import video_topic
from mazebot.recorder.transcoding.vp9 import VideoError

_HEAD_NS = 2_000_000_000
"""This part of a run shows which services send."""


def open_run(name: str, parts: Sequence[Path]) -> Recording:
    """A run by its files, the first one first. Raises ConfigError where they cannot be read."""
    try:
        return _open(name, parts)
    except (McapError, wire.WireError, OSError) as error:
        raise ConfigError(f"replay: {_problem_text(error, parts[0])}") from error


def _problem_text(error: Exception, path: Path) -> str:
    if isinstance(error, OSError):
        return f"{error.filename or path}: {error.strerror}"
    return f"{path}: {error}" if isinstance(error, wire.WireError) else str(error)


def _open(name: str, parts: Sequence[Path]) -> Recording:
    owners: dict[str, str] = {}
    parameters: dict[str, dict[str, Any]] = {}
    clock_ns: int | None = None
    start_ns: int | None = None
    for message in as_recorded(read_messages(parts), parts):
        topic = BY_NAME.get(message.topic)
        if topic is None:
            continue
        source, time_ns = message.envelope.source, message.envelope.sent_ns
        if topic is PARAMETERS:
            recorded = wire.decode(PARAMETERS, message.data)
            owners[source] = recorded.service
            parameters.setdefault(recorded.service, recorded.values)
        if len(topic.owners) == 1:
            owners.setdefault(source, topic.owners[0])
        if topic.delivery is not Delivery.LATCHED and source:
            start_ns = time_ns if start_ns is None else min(start_ns, time_ns)
        if topic is CLOCK:
            clock_ns = time_ns if clock_ns is None else clock_ns
            if time_ns > clock_ns + _HEAD_NS:
                break
    contents = [scan(path) for path in parts]
    if start_ns is None:
        is_cut = not all(one.is_whole for one in contents)
        why = "is cut before the first message" if is_cut else "contains no message of a run"
        raise ConfigError(f"replay: {parts[0]}: {why}")
    end_ns = max((chunk.end_ns for one in contents for chunk in one.chunks), default=start_ns)
    counts = {
        channel.topic for one in contents for channel in one.channels if one.counts[channel.id]
    }
    pictures = "raw" if CAMERA_IMAGE.name in counts else "none"
    if pictures == "none" and {CAMERA_COMPRESSED.name, video_topic(CAMERA_IMAGE.name)} & counts:
        pictures = "jpeg"
    recording = Recording(
        name,
        start_ns,
        max(end_ns, start_ns),
        lambda: iter(()),
        parameters,
        frozenset(owners.values()) - {EDGE},
        all(source in SERVICES or source == EDGE for source in owners),
        pictures,
    )
    begun_ns = start_ns if clock_ns is None else clock_ns

    def read() -> Iterator[Replayed]:
        recording.unfit.clear()
        try:
            yield from _read(recording, parts, owners, begun_ns)
        except (McapError, VideoError, wire.WireError, OSError) as error:
            raise ConfigError(f"replay: {_problem_text(error, parts[0])}") from error

    recording.read = read
    return recording


def _read(
    recording: Recording, parts: Sequence[Path], owners: dict[str, str], clock_ns: int
) -> Iterator[Replayed]:
    begun = False
    for message in as_recorded(read_messages(parts), parts):
        topic: Topic[Any] | None = BY_NAME.get(message.topic)
        if topic is None:
            recording.unfit[message.topic, "not a topic of this version"] += 1
            continue
        if message.type_name != wire.type_name(topic):
            reason = f"{message.type_name}: must be {wire.type_name(topic)}"
            recording.unfit[message.topic, reason] += 1
            continue
        begun = begun or topic is CLOCK
        time_ns = message.envelope.sent_ns if message.envelope.source else message.time_ns
        if not begun and topic.delivery is Delivery.LATCHED and time_ns > clock_ns:
            # Sent in the simulation that was before this one.
            time_ns = recording.start_ns
        data = message.data
        if message.made_from == CAMERA_IMAGE.name and recording.pictures == "jpeg":
            topic, data = CAMERA_IMAGE, _picture(message)
        service = _service_of(message, topic.owners, owners)
        yield Replayed(topic, data, service, message.envelope, max(time_ns, recording.start_ns))


def _service_of(
    message: RecordedMessage, publishers: tuple[str, ...], owners: dict[str, str]
) -> str:
    """The service that has sent a message."""
    source = message.envelope.source
    if source in SERVICES or source == EDGE:
        return source
    if source in owners and owners[source] in publishers:
        return owners[source]
    return EDGE if EDGE in publishers else publishers[0]


def _picture(message: RecordedMessage) -> bytes:
    """The picture of a JPEG, without what that has lost."""
    packed = wire.decode(CAMERA_COMPRESSED, message.data)
    bgr = cv2.imdecode(np.frombuffer(packed.data, np.uint8), cv2.IMREAD_COLOR)
    if bgr is None:
        raise McapError(f"{message.topic}: corrupt image")
    rgb = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)
    height, width = rgb.shape[:2]
    picture = msg.Image(
        header=packed.header, height=height, width=width, encoding="rgb8", is_bigendian=0,
        step=3 * width, data=np.ascontiguousarray(rgb, np.uint8).reshape(-1),
    )  # fmt: skip
    return wire.encode(CAMERA_IMAGE, picture)

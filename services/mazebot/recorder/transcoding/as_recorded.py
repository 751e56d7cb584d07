"""Undoes the video: the messages of a compressed run as they were recorded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import CAMERA_COMPRESSED, CAMERA_IMAGE, DEPTH_IMAGE
from mazebot.common.recordings.mcap.mcap_messages import RecordedMessage
from mazebot.recorder.transcoding.depth import depth_m_of
from mazebot.recorder.transcoding.mcap_video import VIDEO_TYPE, frame_of, read_video
from mazebot.recorder.transcoding.vp9 import VideoError, decode

_FORMAT = "rgb8; bmp compressed bgr8"


def as_recorded(
    messages: Iterable[RecordedMessage], parts: Sequence[Path]
) -> Iterator[RecordedMessage]:
    """The messages of a recording's files, with pictures in place of a video, and depth images in
    place of compressed ones; all others as they are.

    Raises VideoError if a picture cannot be read.
    """
    pictures: Iterator[NDArray[np.uint8]] | None = None
    for message in messages:
        if message.type_name == VIDEO_TYPE and message.made_from == CAMERA_IMAGE.name:
            if pictures is None:
                video = read_video(parts, CAMERA_IMAGE.name)
                pictures = decode(frame for _, frame in video)
            yield _picture(message, next(pictures, None))
        elif message.made_from == DEPTH_IMAGE.name:
            yield _depth(message)
        else:
            yield message


def _picture(message: RecordedMessage, picture: NDArray[np.uint8] | None) -> RecordedMessage:
    if picture is None:
        raise VideoError(f"{message.topic}: the video has fewer pictures than messages")
    stamp_ns, frame_id, _ = frame_of(message.data)
    # Nothing more is lost, and nothing has to be compressed.
    _, data = cv2.imencode(".bmp", picture)
    header = msg.header(stamp_ns, frame_id)
    packed = msg.CompressedImage(header, _FORMAT, np.asarray(data, np.uint8).reshape(-1))
    return message._replace(
        topic=CAMERA_COMPRESSED.name,
        type_name=wire.type_name(CAMERA_COMPRESSED),
        data=wire.encode(CAMERA_COMPRESSED, packed),
    )


def _depth(message: RecordedMessage) -> RecordedMessage:
    packed = wire.decode(CAMERA_COMPRESSED, message.data)
    depth_m = depth_m_of(packed)
    height, width = depth_m.shape
    data = depth_m.astype("<f4").reshape(-1).view(np.uint8)
    image = msg.Image(packed.header, height, width, "32FC1", 0, 4 * width, data)
    return message._replace(
        topic=DEPTH_IMAGE.name,
        type_name=wire.type_name(DEPTH_IMAGE),
        data=wire.encode(DEPTH_IMAGE, image),
        made_from="",
    )

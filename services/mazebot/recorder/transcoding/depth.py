"""Depth images as PNG, as ROS's compressed_depth_image_transport writes them."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import CAMERA_COMPRESSED, DEPTH_IMAGE
from mazebot.recorder.transcoding.vp9 import VideoError

DEPTH_FORMAT = "16UC1; compressedDepth png"
_CONFIG = struct.pack("<iff", 0, 0.0, 0.0)
"""ConfigHeader: PNG, and two parameters that only 32FC1 has."""
_MOST_MM = 65_535


def compressed_depth(image_cdr: bytes) -> bytes:
    """CDR of a CompressedImage in whole millimetres, from that of an Image in metres (32FC1).

    Nothing in range, NaN, becomes 0. Depths beyond 65 m become 65.535 m. Raises WireError for no
    Image, VideoError for one of another encoding.
    """
    image = wire.decode(DEPTH_IMAGE, image_cdr)
    if image.encoding != "32FC1" or image.is_bigendian or image.step < 4 * image.width:
        raise VideoError(
            f"a depth image with encoding {image.encoding} and rows of {image.step} bytes"
        )
    rows = image.data.reshape(image.height, image.step)[:, : 4 * image.width]
    depth_m = np.ascontiguousarray(rows).view(np.float32)
    finite_m = np.nan_to_num(depth_m, nan=0.0, posinf=0.0, neginf=0.0)
    depth_mm = np.clip(np.round(1000.0 * finite_m), 0, _MOST_MM).astype(np.uint16)
    _, png = cv2.imencode(".png", depth_mm, [cv2.IMWRITE_PNG_COMPRESSION, 6])
    data = np.frombuffer(_CONFIG + png.tobytes(), np.uint8)
    return wire.encode(CAMERA_COMPRESSED, msg.CompressedImage(image.header, DEPTH_FORMAT, data))


def depth_m_of(compressed: msg.CompressedImage) -> NDArray[np.float32]:
    """(h, w) metres of an image that was compressed here, NaN where nothing was in range. Raises
    VideoError for any other.
    """
    png = compressed.data[len(_CONFIG) :]
    depth_mm = cv2.imdecode(png, cv2.IMREAD_UNCHANGED) if len(png) else None
    if compressed.format != DEPTH_FORMAT or depth_mm is None or depth_mm.dtype != np.uint16:
        raise VideoError(f"not a depth image: {compressed.format!r}")
    return np.where(depth_mm > 0, depth_mm / np.float32(1000.0), np.float32(np.nan))

"""A picture and its intrinsics as ROS messages."""

from __future__ import annotations

import functools
import sys

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import CAMERA_OPTICAL_FRAME, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.pending_image import PendingImage
from mazebot.physics.camera.camera import Intrinsics
from mazebot.physics.camera.darkroom import Exposure


def image_message(stamp_ns: int, intrinsics: Intrinsics, taken: Exposure) -> msg.Image:
    """rgb8 message of a picture, without a copy; whoever asks for its pixels waits for them."""

    def pixels() -> NDArray[np.uint8]:
        return taken.picture().rgb.reshape(-1)

    return PendingImage(
        header=msg.header(stamp_ns, CAMERA_OPTICAL_FRAME),
        height=intrinsics.height,
        width=intrinsics.width,
        encoding="rgb8",
        is_bigendian=0,
        step=3 * intrinsics.width,
        data=pixels,
    )


def depth_message(stamp_ns: int, intrinsics: Intrinsics, taken: Exposure) -> msg.Image:
    """32FC1 message of a picture's depths, m, without a copy; see `image_message`.

    The renderer must have been made with a range of depths.
    """

    def depths() -> NDArray[np.uint8]:
        depth_m = taken.picture().depth_m
        assert depth_m is not None
        return depth_m.reshape(-1).view(np.uint8)

    return PendingImage(
        header=msg.header(stamp_ns, CAMERA_OPTICAL_FRAME),
        height=intrinsics.height,
        width=intrinsics.width,
        encoding="32FC1",
        is_bigendian=int(sys.byteorder == "big"),
        step=4 * intrinsics.width,
        data=depths,
    )


def compressed_message(stamp_ns: int, rgb: NDArray[np.uint8], quality: int) -> msg.CompressedImage:
    """JPEG of an (h, w, 3) picture, with the format string of ROS' compressed_image_transport."""
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return msg.CompressedImage(
        header=msg.header(stamp_ns, CAMERA_OPTICAL_FRAME),
        format="rgb8; jpeg compressed bgr8",
        data=np.asarray(jpeg, np.uint8).reshape(-1),
    )


def camera_info(stamp_ns: int, intrinsics: Intrinsics) -> msg.CameraInfo:
    """The calibration of a pinhole without distortion."""
    d, k, r, p = _matrices(intrinsics)
    return msg.CameraInfo(
        header=msg.header(stamp_ns, CAMERA_OPTICAL_FRAME),
        height=intrinsics.height,
        width=intrinsics.width,
        distortion_model="plumb_bob",
        d=d,
        k=k,
        r=r,
        p=p,
        binning_x=0,
        binning_y=0,
        roi=msg.RegionOfInterest(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


@functools.lru_cache(maxsize=4)
def _matrices(intrinsics: Intrinsics) -> tuple[Array, Array, Array, Array]:
    """`d`, `k`, `r` and `p` of a camera's messages, which are the same in all of them."""
    fx, fy, cx, cy = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    return (
        np.zeros(5),
        np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        np.eye(3).reshape(9),
        np.array([fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    )

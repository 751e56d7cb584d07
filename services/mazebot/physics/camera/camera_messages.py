"""A picture and its intrinsics as ROS messages."""

from __future__ import annotations

import sys

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import CAMERA_OPTICAL_FRAME
from mazebot.common.messages import messages as msg
from mazebot.physics.camera.camera import Intrinsics


def image_message(stamp_ns: int, rgb: NDArray[np.uint8]) -> msg.Image:
    """rgb8 message of an (h, w, 3) picture, without a copy."""
    height, width, _ = rgb.shape
    return msg.Image(
        header=msg.header(stamp_ns, CAMERA_OPTICAL_FRAME),
        height=height,
        width=width,
        encoding="rgb8",
        is_bigendian=0,
        step=3 * width,
        data=rgb.reshape(-1),
    )


def depth_message(stamp_ns: int, depth_m: NDArray[np.float32]) -> msg.Image:
    """32FC1 message of (h, w) metres, without a copy."""
    height, width = depth_m.shape
    return msg.Image(
        header=msg.header(stamp_ns, CAMERA_OPTICAL_FRAME),
        height=height,
        width=width,
        encoding="32FC1",
        is_bigendian=int(sys.byteorder == "big"),
        step=4 * width,
        data=depth_m.reshape(-1).view(np.uint8),
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
    fx, fy, cx, cy = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    return msg.CameraInfo(
        header=msg.header(stamp_ns, CAMERA_OPTICAL_FRAME),
        height=intrinsics.height,
        width=intrinsics.width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        r=np.eye(3).reshape(9),
        p=np.array([fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
        binning_x=0,
        binning_y=0,
        roi=msg.RegionOfInterest(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )

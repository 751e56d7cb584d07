"""Compresses pictures, each once, in a thread, for all who store them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import cv2
import numpy as np

from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import CAMERA_COMPRESSED

JPEG_FORMAT = "{encoding}; jpeg compressed bgr8"
"""As image_transport names it."""

_TO_BGR: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgr8": (3, None),
    "mono8": (1, None),
}


def is_drawable(image: msg.Image) -> bool:
    """Whether there is a JPEG of an image."""
    channels, _ = _TO_BGR.get(image.encoding, (0, None))
    return 0 < channels * image.width <= image.step


class Pictures:
    """Makes JPEGs of camera images; the newest one is kept for the next request."""

    def __init__(self, jpeg_quality: int) -> None:
        self._quality = jpeg_quality
        self._maker = ThreadPoolExecutor(1, thread_name_prefix="pictures")
        self._newest: tuple[msg.Image, Future[bytes]] | None = None

    def jpeg(self, image: msg.Image) -> Future[bytes]:
        """The JPEG of a drawable image, sooner or later."""
        newest = self._newest
        if newest is not None and newest[0] is image:
            return newest[1]
        future = self._maker.submit(_jpeg, image, self._quality)
        self._newest = image, future
        return future

    def jpeg_message(self, image: msg.Image) -> Callable[[], tuple[wire.Buffer, ...]]:
        """What waits for the same as the CDR of a sensor_msgs/CompressedImage."""
        jpeg = self.jpeg(image)

        def make() -> tuple[wire.Buffer, ...]:
            message = msg.CompressedImage(
                header=image.header,
                format=JPEG_FORMAT.format(encoding=image.encoding),
                data=np.frombuffer(jpeg.result(), np.uint8),
            )
            return wire.encode_in_pieces(CAMERA_COMPRESSED, message)

        return make

    def close(self) -> None:
        """End, when all are made."""
        self._maker.shutdown()


def _jpeg(image: msg.Image, quality: int) -> bytes:
    channels, conversion = _TO_BGR[image.encoding]
    rows = image.data.reshape(image.height, image.step)[:, : image.width * channels]
    pixels = rows.reshape(image.height, image.width, channels)
    bgr = pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return jpeg.tobytes()

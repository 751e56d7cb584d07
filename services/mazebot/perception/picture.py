"""A camera image as a PNG picture."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def png_from_rgb(data: NDArray[np.uint8], height: int, width: int, step: int) -> NDArray[np.uint8]:
    """The bytes of a PNG file.

    Args:
        data: bytes of an rgb8 image, row by row.
        height: in pixels.
        width: in pixels.
        step: bytes of a row, 3 * width or more.
    """
    rows = np.asarray(data, np.uint8)[: height * step].reshape(height, step)
    rgb = rows[:, : 3 * width].reshape(height, width, 3)
    # Fast compression: the smallest file is not worth the time.
    _, png = cv2.imencode(".png", rgb[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return np.asarray(png, np.uint8).reshape(-1)

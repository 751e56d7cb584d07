"""Pictures of a drive along a textured wall."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE_PX = 320, 240


def textured(count: int) -> Iterator[NDArray[np.uint8]]:
    """(h, w, 3) BGR; each picture is moved by three pixels against the one before."""
    width, height = SIZE_PX
    random = np.random.default_rng(0)
    bricks = random.integers(60, 200, (height // 8, width // 8, 1)) + np.array([0, 10, 40])
    wall = cv2.resize(bricks.astype(np.uint8), (2 * width, height), interpolation=cv2.INTER_AREA)
    for number in range(count):
        first = 3 * number % width
        yield np.ascontiguousarray(wall[:, first : first + width], np.uint8)


def jpeg(picture: NDArray[np.uint8]) -> bytes:
    """As the recorder stores it."""
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 75])
    return data.tobytes()

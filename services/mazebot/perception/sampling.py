"""Brightness between the pixels of a picture, with the same bits on every processor: OpenCV's
`remap` rounds otherwise where a processor has fused multiply-add.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel


def brightness_at(grey: NDArray[np.uint8], x_px: Array, y_px: Array) -> Array:
    """(n, m) whole numbers, 0 to 255: the brightness at (n, m) finite places in a (height, width)
    picture, bilinear between the centres of the pixels; outside, that of its border.
    """
    x, y = (np.ascontiguousarray(each, np.float64) for each in (x_px, y_px))
    found = np.empty(x.shape)
    _sample(np.require(grey, np.uint8, ["C", "W"]), x, y, found)
    return np.rint(found)


@kernel("void(uint8[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1])", nogil=True)
def _sample(grey: NDArray[np.uint8], x_px: Array, y_px: Array, found: Array) -> None:
    rows, columns = grey.shape
    for i in range(found.shape[0]):
        for j in range(found.shape[1]):
            x = min(max(x_px[i, j], 0.0), columns - 1.0)
            y = min(max(y_px[i, j], 0.0), rows - 1.0)
            left, top = math.floor(x), math.floor(y)
            right, low = min(left + 1, columns - 1), min(top + 1, rows - 1)
            u, v = x - left, y - top
            above = grey[top, left] * (1.0 - u) + grey[top, right] * u
            below = grey[low, left] * (1.0 - u) + grey[low, right] * u
            found[i, j] = above * (1.0 - v) + below * v

"""Noise of a camera: a normal deviate for each colour of each pixel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels

_SPARE = 1 << 16


class CameraNoise:
    """As Gazebo's: independent of position, colour and light, rounded to whole steps of 8 bits.

    The deviates are drawn once, and each picture takes a slice of them with another start: a
    thirtieth of the cost of drawing them for each picture.
    """

    def __init__(self, share: float, values: int, generator: np.random.Generator) -> None:
        """`share` is the standard deviation as a share of full scale; `values` the number of values
        in a picture.
        """
        self._generator = generator
        self._lighter: NDArray[np.uint8] | None = None
        if share:
            steps = portable_kernels.standard_normal(generator, values + _SPARE).astype(np.float32)
            np.rint(steps * np.float32(255.0 * share), out=steps)
            self._lighter = np.clip(steps, 0, 255).astype(np.uint8)
            self._darker = np.clip(-steps, 0, 255).astype(np.uint8)

    def add_to(self, rgb: NDArray[np.uint8]) -> None:
        """Change a contiguous picture in place; values are clipped to the scale."""
        if self._lighter is None:
            return
        first = int(self._generator.integers(_SPARE))
        flat = rgb.reshape(-1)
        stretch = slice(first, first + len(flat))
        # One of the two is zero everywhere, and both saturate.
        cv2.add(flat, self._lighter[stretch], dst=flat)
        cv2.subtract(flat, self._darker[stretch], dst=flat)

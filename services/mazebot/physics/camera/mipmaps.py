"""A texture's smaller mipmap levels, computed here for every renderer, and uploaded to OpenGL.

Mesa on a CPU would draw them with shaders that it first has to compile: 0.15 s of each start.
moderngl has no call for a level that OpenGL has not made itself.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.opencv import without_ipp

Texels = NDArray[np.uint8]

# Of the Khronos registry's gl.xml.
_TEXTURE_2D, _RGBA8, _RGBA, _UNSIGNED_BYTE = 0x0DE1, 0x8058, 0x1908, 0x1401


def smaller_levels(rgba: Texels) -> Iterator[Texels]:
    """Of (height, width, 4) texels, each level half as high and as wide as the one before, rounded
    down, to a single texel; a texel is the mean of those that it replaces.
    """
    without_ipp()
    while max(rgba.shape[:2]) > 1:
        height, width = (max(side // 2, 1) for side in rgba.shape[:2])
        rgba = np.asarray(cv2.resize(rgba, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
        yield rgba


class LevelUpload:
    """OpenGL's glTexImage2D, in the context that is current when it is created and used."""

    def __init__(self, libegl: str) -> None:
        """`libegl` is the library with which the context was created."""
        egl = ctypes.CDLL(libegl)
        egl.eglGetProcAddress.restype = ctypes.c_void_p
        number, place = ctypes.c_int, ctypes.c_void_p
        kind = ctypes.CFUNCTYPE(None, *[number] * 8, place)
        self._tex_image_2d = kind(egl.eglGetProcAddress(b"glTexImage2D"))

    def __call__(self, texture: Any, rgba: Texels) -> None:
        """Upload the smaller levels of a moderngl texture that holds (height, width, 4) texels."""
        texture.use()
        for level, texels in enumerate(smaller_levels(rgba), start=1):
            height, width = texels.shape[:2]
            self._tex_image_2d(
                _TEXTURE_2D, level, _RGBA8, width, height, 0, _RGBA, _UNSIGNED_BYTE,
                texels.ctypes.data,
            )  # fmt: skip

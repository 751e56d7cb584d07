"""A hash of a run's pictures: equal if those of two runs are the same to the last bit."""

from __future__ import annotations

import hashlib
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

_PACK = struct.Struct("<II").pack


class ImageHash:
    """sha1 over the CRC-32 and the size of the colours of successive pictures: a CRC takes a third
    of the time, and what differs by chance differs in it.
    """

    def __init__(self) -> None:
        self._hash = hashlib.sha1(usedforsecurity=False)

    def add(self, rgb: NDArray[np.uint8]) -> None:
        """Add a contiguous picture."""
        self._hash.update(_PACK(zlib.crc32(rgb.data), rgb.nbytes))

    def hex(self) -> str:
        """The hash of all pictures so far, 16 hex digits."""
        return self._hash.hexdigest()[:16]

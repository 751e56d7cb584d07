"""A hash of a run's pictures: equal if those of two runs are the same to the last bit."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray


class ImageHash:
    """sha1, for which CPUs have instructions, over the colours of successive pictures."""

    def __init__(self) -> None:
        self._hash = hashlib.sha1(usedforsecurity=False)

    def add(self, rgb: NDArray[np.uint8]) -> None:
        """Add a contiguous picture."""
        self._hash.update(rgb.data)

    def hex(self) -> str:
        """The hash of all pictures so far, 16 hex digits."""
        return self._hash.hexdigest()[:16]

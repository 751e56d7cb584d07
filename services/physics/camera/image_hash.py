"""A fingerprint of a run's pictures: equal where two runs saw the same to the last bit."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray


class ImageHash:
    """sha1, for which CPUs have instructions, over the pictures' colours, one after the other."""

    def __init__(self) -> None:
        self._hash = hashlib.sha1(usedforsecurity=False)

    def add(self, rgb: NDArray[np.uint8]) -> None:
        """Take in a contiguous picture."""
        self._hash.update(rgb.data)

    def hex(self) -> str:
        """The hash of all pictures so far, 16 hex digits."""
        return self._hash.hexdigest()[:16]

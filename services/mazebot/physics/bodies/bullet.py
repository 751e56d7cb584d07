"""PyBullet without its printed lines, with portable sines, and with bounded memory.

glibc maps a block of 128 KiB or more separately, and returns it to the system when it is freed; but
each such block that is freed raises that threshold to its own size, up to 32 MiB (mallopt(3)).
PyBullet frees blocks of up to 8 MB when a world is rebuilt: from then on they came from the heap
and left holes in it, 50 MB after a few worlds. A threshold that is set explicitly does not change.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.physics.bodies.bullet_math import take_portable_math

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Of glibc's malloc.h"""
_OWN_BLOCK_BYTES = 5 << 18
"""More than a depth image of 640 x 480, which would cost a page fault every 4 KiB of it, a sixth of
its drawing time; less than the larger blocks that PyBullet frees.
"""
_KEPT_BYTES = 16 << 20
"""Free memory at the heap's end that is not returned, since the next step takes it again."""


def _keep_large_blocks_apart() -> None:
    """Fix malloc's thresholds, where the C library is glibc; others have no mallopt."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _OWN_BLOCK_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)


@contextlib.contextmanager
def quiet(*descriptors: int) -> Iterator[None]:
    """Discard everything that is written to standard output (1) or error (2)."""
    sys.stdout.flush()
    sys.stderr.flush()
    c_library = ctypes.CDLL(None)
    # Python's flush does not flush C's own buffers.
    c_library.fflush(None)
    kept = {number: os.dup(number) for number in descriptors}
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for number in kept:
            os.dup2(nowhere, number)
        yield
    finally:
        c_library.fflush(None)
        for number, copy in kept.items():
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)


_keep_large_blocks_apart()
with quiet(1, 2):
    import pybullet
take_portable_math(pybullet.__file__)

__all__ = ["lent", "pybullet", "quiet"]

_rows: dict[str, list[list[float]]] = {}
_lists: dict[str, list[Any]] = {}


def lent(name: str, values: NDArray[np.floating[Any] | np.integer[Any]]) -> list[Any]:
    """An array of one or two dimensions as lists, valid until the next call with this name.

    PyBullet 3.2.7 never releases the vertices, indices, normals and texture coordinates that a
    shape is made of, nor the rows in them. So those of one name are the same lists each time.
    """
    given = _lists.setdefault(name, [])
    if values.ndim == 1:
        given[:] = values.tolist()
        return given
    rows = _rows.setdefault(name, [])
    rows.extend([] for _ in range(len(values) - len(rows)))
    given[:] = rows[: len(values)]
    for row, value in zip(given, values.tolist(), strict=True):
        row[:] = value
    return given

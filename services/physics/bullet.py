"""PyBullet without the line that it prints on being imported, and what it may keep."""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray


def _import_quietly() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    kept = {number: os.dup(number) for number in (1, 2)}
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for number in kept:
            os.dup2(nowhere, number)
        import pybullet  # noqa: F401, PLC0415

        # The line may wait in C's buffer, which Python's flush does not reach.
        ctypes.CDLL(None).fflush(None)
    finally:
        for number, copy in kept.items():
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)


_import_quietly()
import pybullet  # noqa: E402

__all__ = ["lent", "pybullet"]

_rows: dict[str, list[list[float]]] = {}
_lists: dict[str, list[Any]] = {}


def lent(name: str, values: NDArray[np.floating[Any] | np.integer[Any]]) -> list[Any]:
    """An array of one or two dimensions as lists, good until the next call of this name.

    PyBullet 3.2.7 never lets go of the vertices, indices, normals and texture coordinates that a
    shape is made of, nor of the rows in them. So those of one name are the same lists each time.
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

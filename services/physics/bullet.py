"""PyBullet without the line that it prints on being imported."""

from __future__ import annotations

import ctypes
import os
import sys


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

__all__ = ["pybullet"]

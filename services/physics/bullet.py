"""PyBullet without the line that it prints on being imported."""

from __future__ import annotations

import ctypes
import os
import sys


def _import_quietly() -> None:
    sys.stdout.flush()
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        import pybullet  # noqa: F401, PLC0415

        # The line waits in C's buffer, which Python's flush does not reach.
        ctypes.CDLL(None).fflush(None)
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


_import_quietly()
import pybullet  # noqa: E402

__all__ = ["pybullet"]

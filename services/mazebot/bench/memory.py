"""Memory use of the process."""

from __future__ import annotations

import gc
import resource
from pathlib import Path

_STATM = Path("/proc/self/statm")
_STATUS = Path("/proc/self/status")


def resident_mb() -> float:
    """Resident memory of this process in MB (10^6 bytes), after a garbage collection.

    Without /proc, its peak memory.
    """
    gc.collect()
    if _STATM.is_file():
        return int(_STATM.read_text().split()[1]) * resource.getpagesize() / 1e6
    return peak_mb()


def peak_mb() -> float:
    """Peak memory of this process, in MB (10^6 bytes)."""
    if _STATUS.is_file():
        # On Linux ru_maxrss includes the memory of the parent process.
        lines = (line.split() for line in _STATUS.read_text().splitlines())
        return next(int(line[1]) for line in lines if line[0] == "VmHWM:") * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6

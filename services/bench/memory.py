"""How much memory a process takes."""

from __future__ import annotations

import gc
import resource
from pathlib import Path

_STATM = Path("/proc/self/statm")
_STATUS = Path("/proc/self/status")


def resident_mb() -> float:
    """Memory of this process in MB (10^6 bytes), after what is no longer used has been let go of.

    Where there is no /proc, the most that it has ever had.
    """
    gc.collect()
    if _STATM.is_file():
        return int(_STATM.read_text().split()[1]) * resource.getpagesize() / 1e6
    return peak_mb()


def peak_mb() -> float:
    """The most memory that this process has had, in MB (10^6 bytes)."""
    if _STATUS.is_file():
        # Linux counts in ru_maxrss what the process had that started this one.
        lines = (line.split() for line in _STATUS.read_text().splitlines())
        return next(int(line[1]) for line in lines if line[0] == "VmHWM:") * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6

"""Memory that a process has in use only for a time."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

_SMAPS = Path("/proc/self/smaps")
_MADV_DONTNEED = 4
"""Linux: the pages are read from their file again if they are needed."""


def give_back_unchanged(library: str) -> int:
    """Give back the memory in which the code and the constants of a shared library lie; what is
    used again is mapped again. Returns the size in bytes of all of them; 0 where there is none of
    that name, or no /proc.

    Only mappings that nobody may write to, and that are as in their file, are given back: others
    hold addresses that were written when the library was loaded.

    Args:
        library: start of its file's name.
    """
    if not _SMAPS.is_file():
        return 0
    # Its line, those about it, and among them the size of what is no longer as in the file.
    unchanged = re.compile(
        rf"^([0-9a-f]+)-([0-9a-f]+) r-[-x]p .*/{re.escape(library)}[^/\n]*\n"
        r"(?:[A-Z].*\n)*?Anonymous:\s+0 kB$",
        re.MULTILINE,
    )
    libc, given = ctypes.CDLL(None), 0
    libc.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    for mapping in unchanged.finditer(_SMAPS.read_text(encoding="utf-8")):
        first, last = int(mapping[1], 16), int(mapping[2], 16)
        if libc.madvise(first, last - first, _MADV_DONTNEED) == 0:
            given += last - first
    return given


def give_back_freed() -> None:
    """Give back what the allocator keeps of freed memory: after messages of many megabytes that is
    as much again. Does nothing where the C library has no such call.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)

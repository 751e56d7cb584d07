"""Opens and reads files of other people: regular ones only, of limited size."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from mazebot.common.files.limits import MAX_UNPACKED_RATIO, MIN_UNPACKED_BYTES

_OPENED: set[tuple[int, int]] = set()
"""Device and inode of each file that was opened here, for `was_opened`."""


class NotReadableError(ValueError):
    """A file that must not be read: a phrase that continues after its name."""


def open_regular(path: Path) -> BinaryIO:
    """A regular file, opened for reading.

    Raises NotReadableError for a folder, device, pipe or socket, and OSError.
    """
    # Without O_NONBLOCK, opening a pipe would block until somebody writes to it.
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:
        raise NotReadableError("must be a file name without NUL") from error
    except OSError:
        # A socket cannot even be opened.
        if path.exists() and not path.is_file():
            raise NotReadableError("must be a file") from None
        raise
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode):
        os.close(descriptor)
        raise NotReadableError("must be a file")
    _OPENED.add((found.st_dev, found.st_ino))
    return os.fdopen(descriptor, "rb")


def forget_opened() -> None:
    """Forget which files were opened: a command begins."""
    _OPENED.clear()


def was_opened(path: Path) -> bool:
    """Whether the file was opened here since `forget_opened`, under this name or that of a link."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return False
    return (found.st_dev, found.st_ino) in _OPENED


def read_limited(path: Path, max_bytes: int) -> bytes:
    """The content of a regular file. Its size is checked before anything is read.

    Raises NotReadableError, where it is larger, too, and OSError.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        data = file.read(max_bytes + 1) if size <= max_bytes else b""
    if size > max_bytes or len(data) > max_bytes:
        raise NotReadableError(f"must have at most {max_bytes} bytes")
    return data


def most_unpacked(packed: BinaryIO) -> int:
    """Bytes that the content of a packed file may have."""
    size = os.fstat(packed.fileno()).st_size
    return max(MIN_UNPACKED_BYTES, MAX_UNPACKED_RATIO * size)


def reason(error: OSError | NotReadableError) -> str:
    """An error of these functions, as a phrase that continues after the file's name."""
    return str(getattr(error, "strerror", None) or error)

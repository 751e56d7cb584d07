"""The log of a stack: one file with the lines of all services, each after its service's name."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

_NAME = "stack.log"
_MAX_BYTES = 5_000_000
"""Then the file is set aside, and the one before it is deleted."""
_POLL_S = 0.1

Line = tuple[str, str]
"""A service's name, and what it said."""


class LogWriter:
    """Appends lines."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / _NAME
        for old in (self._path, _before(self._path)):
            old.unlink(missing_ok=True)
        self._file = self._path.open("ab", buffering=0)

    def put(self, service: str, text: str) -> None:
        """Append a line."""
        if self._file.tell() > _MAX_BYTES:
            self._file.close()
            self._path.replace(_before(self._path))
            self._file = self._path.open("ab", buffering=0)
        self._file.write(f"{service}\t{text}\n".encode())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def exists(folder: Path) -> bool:
    """Whether there is a log."""
    return (folder / _NAME).is_file()


def read_lines(folder: Path, services: Collection[str]) -> Iterator[Line]:
    """The lines of some services so far."""
    path = folder / _NAME
    for file in (_before(path), path):
        if file.is_file():
            yield from _parsed(file.read_bytes(), services)


def follow(
    folder: Path, services: Collection[str], goes_on: Callable[[], bool]
) -> Iterator[Line | None]:
    """The lines of some services so far, and then those that come, until `goes_on()` is false and
    no more come. None where there are none for a while, so that the caller can do something else.
    """
    path, rest = folder / _NAME, b""
    yield from _parsed(_content(_before(path)), services)
    file = path.open("rb")
    try:
        while True:
            ends = not goes_on()
            data = file.read()
            if not data and path.is_file() and path.stat().st_ino != _inode(file.fileno()):
                file.close()
                file, rest = path.open("rb"), b""
                continue
            whole, newline, rest = (rest + data).rpartition(b"\n")
            yield from _parsed(whole + newline, services)
            if not data:
                if ends:
                    return
                yield None
                time.sleep(_POLL_S)
    finally:
        file.close()


def _before(path: Path) -> Path:
    return path.with_name(f"{path.name}.1")


def _content(path: Path) -> bytes:
    return path.read_bytes() if path.is_file() else b""


def _inode(descriptor: int) -> int:
    return os.fstat(descriptor).st_ino


def _parsed(data: bytes, services: Collection[str]) -> Iterator[Line]:
    for line in data.decode(errors="replace").splitlines():
        service, _, text = line.partition("\t")
        if service in services:
            yield service, text

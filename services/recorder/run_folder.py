"""The folder of one run: its name, its lock, and what must hold before anything starts."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import tempfile
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import IO

from services.common.config import ConfigError

RECORDING = "run.rrd"
DIGESTS = "digests.bin"
SUMMARY = "summary.json"
CONFIG = "config.yaml"
LOCK = ".recording"
"""Stands in a run's folder, locked, while its recorder lives; without the lock, it was killed."""


def check_writable(folder: Path) -> None:
    """Make a folder; raise ConfigError with one line where no file can be made in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigError(f"recordings folder not writable: {folder}: {error.strerror}") from error


def check_unused(folder: Path) -> None:
    """Raise ConfigError with one line where a folder holds a run already."""
    for name in (SUMMARY, RECORDING, CONFIG):
        if (folder / name).exists():
            raise ConfigError(f"out_dir: {folder} holds a run already ({name}); name another one")


class RunFolder:
    """A run's own folder, locked until `release()`."""

    def __init__(self, path: Path) -> None:
        """Raises FileExistsError where a run has the folder already."""
        self.path = path
        # Locked before it gets its name: nobody may find it unlocked and take the run for dead.
        with tempfile.NamedTemporaryFile("w", dir=path, prefix=f"{LOCK}.", delete=False) as file:
            lock = os.fdopen(os.dup(file.fileno()), "w", encoding="utf-8")
        temporary = Path(file.name)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            (path / LOCK).hardlink_to(temporary)
        except OSError:
            lock.close()
            raise
        finally:
            temporary.unlink()
        self._lock: IO[str] | None = lock

    @classmethod
    def in_folder(cls, recordings_dir: Path, started: datetime, world: str) -> RunFolder:
        """Make the folder of a run, `<time>_<world>`; a taken name gets a number."""
        safe_world = re.sub(r"[^A-Za-z0-9_.-]+", "-", world).strip(".-") or "world"
        name = f"{started:%Y-%m-%d_%H-%M-%S}_{safe_world}"
        return cls._make(recordings_dir, name)

    @classmethod
    def exactly(cls, path: Path) -> RunFolder:
        """Take a folder of that path, or beside it with a number where it holds a run already."""
        path.mkdir(parents=True, exist_ok=True)
        if not any((path / name).exists() for name in (LOCK, SUMMARY, RECORDING)):
            with contextlib.suppress(FileExistsError):
                return cls(path)
        return cls._make(path.parent, path.name)

    @classmethod
    def _make(cls, parent: Path, name: str) -> RunFolder:
        parent.mkdir(parents=True, exist_ok=True)
        number = 1
        while True:
            path = parent / (name if number == 1 else f"{name}_{number}")
            try:
                # mkdir is atomic: of two recorders that start at once, one gets the next number.
                path.mkdir()
            except FileExistsError:
                number += 1
                continue
            return cls(path)

    def release(self) -> None:
        """Say that the run is whole."""
        if self._lock is not None:
            (self.path / LOCK).unlink(missing_ok=True)
            self._lock.close()
            self._lock = None


def write_atomically(path: Path, pieces: Iterable[bytes]) -> None:
    """Write a file so that a reader, or a crash, finds the old one or the new one, whole."""
    temporary = path.with_name(f".{path.name}.part")
    with temporary.open("wb") as file:
        file.writelines(pieces)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)

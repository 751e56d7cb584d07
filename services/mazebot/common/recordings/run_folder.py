"""The folder of one run: its name, its lock, and the checks before a start."""

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

from mazebot.common.config import ConfigError

RECORDING = "run.rrd"
MESSAGES = "run.mcap"
REPORT = "report.html"
THUMBNAIL = "thumbnail.png"
SERIES = "series.json"
LABELS = "labels.json"
DIGESTS = "digests.bin"
SUMMARY = "summary.json"
CONFIG = "config.yaml"
PROGRESS = ".progress.npz"
"""Exists in a run's folder until the run has ended: another recorder can resume the run from it."""
TO_COMPRESS = ".to_compress"
"""Exists in an ended run's folder while the video of its pictures is still to be made."""
LOCK = ".recording"
"""Exists in a run's folder, locked while its recorder lives; if unlocked, it was killed."""


def parts_of(folder: Path, name: str = RECORDING) -> list[Path]:
    """The files of a run's recording, oldest first: more than one `run.rrd` while it is
    interrupted, or more than one `run.mcap` (`name`) of a long run.
    """
    numbered = [(_number(path.stem), path) for path in folder.glob(f"run*{Path(name).suffix}")]
    return [path for number, path in sorted(numbered) if number > 0]


def part_path(folder: Path, name: str, number: int) -> Path:
    """Path of a part of a recording, counted from 1."""
    return folder / (name if number == 1 else f"run_{number}{Path(name).suffix}")


def attachments_of(folder: Path) -> dict[str, tuple[str, bytes]]:
    """The files of a run that `run.mcap` carries: by name, media type and content."""
    kinds = {CONFIG: "application/yaml", SUMMARY: "application/json"}
    return {
        name: (kind, (folder / name).read_bytes())
        for name, kind in kinds.items()
        if (folder / name).is_file()
    }


def _number(stem: str) -> int:
    """The number of a part by its name without suffix; 0: not a part."""
    if stem == "run":
        return 1
    number = stem.removeprefix("run_")
    return int(number) if number.isdecimal() else 0


def is_recording(folder: Path) -> bool:
    """Whether the recorder of a run is alive, or a repair of it is under way."""
    try:
        with (folder / LOCK).open(encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def check_writable(folder: Path) -> None:
    """Create a folder; raise ConfigError with one line if no file can be created in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigError(f"recordings folder not writable: {folder}: {error.strerror}") from error


def check_free(field: str, folder: Path) -> None:
    """Raise ConfigError with one line, which begins with the field or flag, if a folder cannot be
    used for a new run. Leaves nothing behind.
    """
    for name in (SUMMARY, RECORDING, MESSAGES, CONFIG):
        if os.path.exists(folder / name):  # noqa: PTH110 - False for a name that cannot be
            raise ConfigError(
                f"{field}: {folder} already contains a run ({name}); choose another folder"
            )
    made: list[Path] = []
    try:
        for path in reversed((folder, *folder.parents)):
            if not path.is_dir():
                path.mkdir()
                made.append(path)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except FileExistsError as error:
        reason = f"must be a new folder: {error.filename} is not a folder"
        raise ConfigError(f"{field}: {folder}: {reason}") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(f"{field}: {str(folder)!r:.200}: cannot be created: {reason}") from error
    finally:
        for path in reversed(made):
            path.rmdir()


class RunFolder:
    """A run's folder, locked until `release()`."""

    def __init__(self, path: Path) -> None:
        """Raises FileExistsError if the folder already belongs to a run."""
        self.path = path
        # Locked before it gets its name: otherwise another recorder could take the run for dead.
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
        """Create the folder of a run, `<time>_<world>`; a taken name gets a number."""
        safe_world = re.sub(r"[^A-Za-z0-9_.-]+", "-", world).strip(".-") or "world"
        name = f"{started:%Y-%m-%d_%H-%M-%S}_{safe_world}"
        return cls._make(recordings_dir, name)

    @classmethod
    def exactly(cls, path: Path) -> RunFolder:
        """Use a folder of that path, or one with a number if it already contains a run."""
        path.mkdir(parents=True, exist_ok=True)
        if not any((path / name).exists() for name in (LOCK, SUMMARY, RECORDING, MESSAGES)):
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

    @classmethod
    def take_over(cls, path: Path) -> RunFolder:
        """Take over the folder of a run whose recorder died.

        Raises OSError if that recorder is alive, or the run has ended.
        """
        lock = (path / LOCK).open("r+", encoding="utf-8")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            raise
        folder = cls.__new__(cls)
        folder.path, folder._lock = path, lock
        return folder

    @property
    def is_gone(self) -> bool:
        """Whether the folder was removed or replaced."""
        return self._lock is not None and os.fstat(self._lock.fileno()).st_nlink == 0

    def part(self, number: int) -> Path:
        """Path of a part of the recording, counted from 1."""
        return part_path(self.path, RECORDING, number)

    def message_part(self, number: int) -> Path:
        """Path of a file with the run's messages, counted from 1."""
        return part_path(self.path, MESSAGES, number)

    def parts(self) -> list[Path]:
        """The files of the recording so far, oldest first."""
        return parts_of(self.path)

    def last_part(self, name: str = RECORDING) -> int:
        """The number of the newest part; 0: none."""
        return max((_number(path.stem) for path in parts_of(self.path, name)), default=0)

    def release(self) -> None:
        """Mark the run as complete."""
        if self._lock is not None and not self.is_gone:
            (self.path / PROGRESS).unlink(missing_ok=True)
            (self.path / LOCK).unlink(missing_ok=True)
        self.let_go()

    def let_go(self) -> None:
        """Leave the folder marked as that of an incomplete run."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def write_atomically(path: Path, pieces: Iterable[bytes], sync: bool = True) -> None:
    """Write a file so that after a crash, and for readers, it is either the old or the new one;
    `sync`: also after a crash of the machine. Raises OSError; the old one stays then, and nothing
    of the new one takes room.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        with temporary.open("wb") as file:
            file.writelines(pieces)
            file.flush()
            if sync:
                os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise

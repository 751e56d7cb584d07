"""Files and whole folders of them, written in one stroke."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from services.common.config import ConfigError


def write_folder(
    folder: Path, files: Mapping[str, bytes], is_ours: Callable[[str], bool] = lambda _: False
) -> Path:
    """Write files, by their path in a folder, so that all of them are there or none is.

    A folder that is there already is replaced where `is_ours` says of every file in it that an
    earlier writing made it. Raises ConfigError where it holds anything else, or cannot be written.
    """
    try:
        _refuse_foreign(folder, is_ours)
        folder.parent.mkdir(parents=True, exist_ok=True)
        making = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from error
    try:
        for name, data in files.items():
            file = making / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
        # mkdtemp's folders are for their owner alone.
        making.chmod(0o777 & ~_umask())
        _swap(making, folder)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from error
    finally:
        shutil.rmtree(making, ignore_errors=True)
    return folder


def write_file(file: Path, data: bytes) -> None:
    """Write a file, so that all of it is there or what was there before.

    Raises OSError where it cannot be written.
    """
    descriptor, name = tempfile.mkstemp(prefix=f".{file.name}-", dir=file.parent)
    making = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as new:
            new.write(data)
        # mkstemp's files are for their owner alone.
        making.chmod(0o666 & ~_umask())
        making.replace(file)
    finally:
        making.unlink(missing_ok=True)


def _refuse_foreign(folder: Path, is_ours: Callable[[str], bool]) -> None:
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise ConfigError(f"{folder}: must be a folder, or not there yet")
    # One level after the other: the first that is foreign ends it, however much there is.
    for inside, folders, files in os.walk(folder):
        folders.sort()
        links = [name for name in folders if (Path(inside) / name).is_symlink()]
        for file in sorted([*files, *links]):
            name = (Path(inside) / file).relative_to(folder).as_posix()
            if not is_ours(name):
                raise ConfigError(
                    f"{folder}: holds {name}, which was not written by this command: must be a "
                    "new or an empty folder"
                )


def _swap(making: Path, folder: Path) -> None:
    """Put one folder in another's place; the old one stays where that fails."""
    if not folder.exists():
        making.rename(folder)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        folder.rename(old / "old")
        try:
            making.rename(folder)
        except OSError:
            (old / "old").rename(folder)
            raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask

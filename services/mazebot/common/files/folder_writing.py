"""Writes files and whole folders atomically."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from mazebot.common.config import ConfigError


def write_folder(
    folder: Path, files: Mapping[str, bytes], is_ours: Callable[[str], bool] = lambda _: False
) -> Path:
    """Write files, by their path in a folder, so that either all of them exist or none.

    An existing folder is replaced if `is_ours` is true for every file in it, i.e. an earlier call
    wrote them. Raises ConfigError if it contains anything else, or cannot be written.
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
        # mkdtemp's folders are accessible to their owner only.
        making.chmod(0o777 & ~_umask())
        _swap(making, folder)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from error
    finally:
        shutil.rmtree(making, ignore_errors=True)
    return folder


def write_file(file: Path, data: bytes) -> None:
    """Write a file atomically: on failure the previous one remains. What a link leads to is
    replaced, not the link; a device or a pipe is written to.

    Raises OSError if it cannot be written.
    """
    if file.exists() and not file.is_file():
        file.write_bytes(data)
        return
    file = Path(os.path.realpath(file))
    descriptor, name = tempfile.mkstemp(prefix=f".{file.name}-", dir=file.parent)
    making = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as new:
            new.write(data)
        # mkstemp's files are accessible to their owner only.
        making.chmod(0o666 & ~_umask())
        making.replace(file)
    finally:
        making.unlink(missing_ok=True)


def _refuse_foreign(folder: Path, is_ours: Callable[[str], bool]) -> None:
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise ConfigError(f"{folder}: must be a folder, or a path that does not exist")
    # Breadth first: the search ends at the first foreign file, however many there are.
    for inside, folders, files in os.walk(folder):
        folders.sort()
        links = [name for name in folders if (Path(inside) / name).is_symlink()]
        for file in sorted([*files, *links]):
            name = (Path(inside) / file).relative_to(folder).as_posix()
            if not is_ours(name):
                raise ConfigError(
                    f"{folder}: contains {name}, which was not written by this command: must be a "
                    "new or an empty folder"
                )


def _swap(making: Path, folder: Path) -> None:
    """Replace a folder by another; on failure the old one stays."""
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

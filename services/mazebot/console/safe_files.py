"""Files of a folder, opened so that nothing outside of it can be reached."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from mazebot.common.config import ConfigError

MAX_NAME_BYTES = 255
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
# A pipe must not block.
_FILE = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


class NoSuchFileError(Exception):
    """The path names no regular file inside the folder."""


def is_plain_name(name: str) -> bool:
    """Whether a text is the name of one visible entry of a folder."""
    if not name or name.startswith(".") or not name.isprintable() or "/" in name or "\\" in name:
        return False
    try:
        return len(name.encode()) <= MAX_NAME_BYTES
    except UnicodeEncodeError:
        return False


def open_inside(root: Path, names: Sequence[str]) -> int:
    """A descriptor of a regular file below `root`, which itself may be a link; no other link is
    followed, and no hidden file is opened. The caller closes it.

    Raises NoSuchFileError, or PermissionError.
    """
    if not names or not all(map(is_plain_name, names)):
        raise NoSuchFileError
    folder = -1
    try:
        folder = os.open(root, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        for name in names[:-1]:
            below = os.open(name, _FOLDER, dir_fd=folder)
            os.close(folder)
            folder = below
        file = os.open(names[-1], _FILE, dir_fd=folder)
    except PermissionError:
        raise
    except (OSError, ValueError) as error:
        raise NoSuchFileError from error
    finally:
        if folder >= 0:
            with suppress(OSError):
                os.close(folder)
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise NoSuchFileError
    return file


def is_real_folder(path: Path) -> bool:
    """Whether a path is a folder, and no link to one."""
    try:
        return stat.S_ISDIR(path.lstat().st_mode)
    except (OSError, ValueError):
        return False


def check_no_link(path: Path) -> None:
    """Raises ConfigError if a path is a link: what it leads to is not shown."""
    if path.is_symlink():
        raise ConfigError(f"{path}: is a symbolic link, which is not followed")

"""Removes from the image what no service needs at run time, while it is built: shells, package
managers, every other program of the system, and the bits that let a program run as another user.
What is left is Python, its libraries, and the programs named here.
"""

from __future__ import annotations

import os
import shutil
import stat
import sys
from pathlib import Path

PROGRAMS = frozenset({"tini", "ldconfig"})
"""The recorder's init, and what Python finds libraries with."""
FOLDERS = ("usr/bin", "usr/sbin", "usr/local/bin", "usr/local/sbin")
OTHERS = (
    "usr/lib/apt", "usr/lib/dpkg", "usr/share/perl5", "usr/share/bash-completion",
    "usr/lib/x86_64-linux-gnu/perl-base", "usr/lib/aarch64-linux-gnu/perl-base", "usr/share/doc",
    "usr/share/man", "usr/share/locale", "usr/share/debconf", "usr/share/python-wheels",
    "usr/lib/python3/dist-packages", "var/cache", "var/lib/apt", "var/lib/dpkg/info", "etc/apt",
)  # fmt: skip
UNUSED = ("ensurepip", "idlelib", "site-packages", "dist-packages", "test")
"""Of Python's own library: the services have an environment of their own."""


def main(root: Path) -> None:
    """Do it."""
    python = Path(sys.executable).resolve()
    for folder in FOLDERS:
        for path in (root / folder).iterdir():
            if path.name not in PROGRAMS and path.resolve() != python:
                _remove(path)
    library = Path(os.__file__).parent
    for path in (*(library / name for name in UNUSED), *(root / name for name in OTHERS)):
        _remove(path)
    for folder, below, names in os.walk(root):
        if Path(folder) == root:
            below[:] = [name for name in below if name not in ("dev", "proc", "sys")]
        for name in names:
            path = Path(folder, name)
            mode = path.lstat().st_mode
            if stat.S_ISREG(mode) and mode & (stat.S_ISUID | stat.S_ISGID):
                path.chmod(stat.S_IMODE(mode) & 0o777)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif path.exists() or path.is_symlink():
        path.unlink()


if __name__ == "__main__":
    main(Path("/"))

"""Runs a command as the user who owns the mounted folder, with no capability left.

    as_owner.py REFERENCE FOLDER[:FOLDER...] COMMAND...

The container that writes recordings cannot know, before it starts, which user has cloned the
repository: Docker may be run by root or by any member of the group `docker`. So it starts as root,
with the capabilities CHOWN, SETGID and SETUID only, reads the owner of a file of the clone
(REFERENCE), gives each FOLDER (a pattern such as `/handout/*` stands for all that it matches) to
that owner if Docker had to create it (then root owns it), and switches to the owner permanently
before any code of the service is loaded. If the owner is root, the
capabilities are dropped too, and `no-new-privileges` keeps them from being regained.
"""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path
from typing import NoReturn

_CAPABILITY_VERSION_3 = 0x20080522


def main(arguments: list[str]) -> NoReturn:
    """Switch to the owner, then execute the command."""
    if len(arguments) < 3:
        _fail("usage: as_owner.py REFERENCE FOLDER[:FOLDER...] COMMAND...")
    reference, patterns, command = Path(arguments[0]), arguments[1].split(":"), arguments[2:]
    try:
        if os.geteuid() == 0:
            owner = reference.stat()
            for pattern in patterns:
                # A folder that is not there is told with its name.
                found = sorted(Path("/").glob(pattern.lstrip("/")))
                for folder in found or [Path(pattern)]:
                    if folder.stat().st_uid == 0:
                        os.chown(folder, owner.st_uid, owner.st_gid)
            os.setgroups([])
            os.setresgid(owner.st_gid, owner.st_gid, owner.st_gid)
            os.setresuid(owner.st_uid, owner.st_uid, owner.st_uid)
            _drop_capabilities()
        os.execvp(command[0], command)
    except OSError as error:
        _fail(f"{error.filename or 'as_owner.py'}: {error.strerror}")


def _drop_capabilities() -> None:
    """Empty the effective, permitted and inheritable sets.

    Raises OSError if the kernel refuses.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    header = (ctypes.c_uint32 * 2)(_CAPABILITY_VERSION_3, 0)
    if libc.capset(header, (ctypes.c_uint32 * 6)()) != 0:
        raise OSError(ctypes.get_errno(), "cannot give up capabilities")


def _fail(message: str) -> NoReturn:
    sys.stderr.write(f"error: {message}\n")
    raise SystemExit(2)


if __name__ == "__main__":
    main(sys.argv[1:])

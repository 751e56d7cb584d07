"""Runs a command as the person whose folder is mounted, with no capability left.

    as_owner.py REFERENCE FOLDER COMMAND...

The container that writes recordings cannot know, before it starts, who has cloned the
repository: Docker may be driven by root or by anyone of the group `docker`. So it starts as root,
with no capability but CHOWN, SETGID and SETUID, learns the owner from a file of the clone
(REFERENCE), gives FOLDER to that owner where Docker had to make it (then root owns it), and becomes
the owner for good before anything of the service is loaded. Where the owner is root, the
capabilities go all the same, and `no-new-privileges` keeps them from coming back.
"""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path
from typing import NoReturn

_CAPABILITY_VERSION_3 = 0x20080522


def main(arguments: list[str]) -> NoReturn:
    """Become the owner, then the command."""
    if len(arguments) < 3:
        _fail("usage: as_owner.py REFERENCE FOLDER COMMAND...")
    reference, folder, command = Path(arguments[0]), Path(arguments[1]), arguments[2:]
    try:
        if os.geteuid() == 0:
            owner = reference.stat()
            if folder.stat().st_uid != owner.st_uid and folder.stat().st_uid == 0:
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

    Raises OSError where the kernel refuses.
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

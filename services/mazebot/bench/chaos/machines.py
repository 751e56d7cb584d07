"""Machines that change while services run on them, as far as the services see: by a library of some
lines that is loaded before all others. Debian's libfaketime 0.9.10 could set clocks too, but makes
Python 3.11's `time.sleep` fail where the monotonic clock is left alone
(https://github.com/wolfcw/libfaketime/issues/426).
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import time
from pathlib import Path
from typing import NamedTuple

from mazebot.common.config import ConfigError

_SOURCE = Path(__file__).with_name("machine.c")
_NEAR_S = 60.0
_TRIED_BYTES = 20_000
SHOW = f"""
import os, tempfile, time
with tempfile.TemporaryFile(buffering=0) as file:
    begin_s = time.monotonic()
    file.write(bytes({_TRIED_BYTES}))
print(time.time(), time.monotonic() - begin_s)
"""
"""A program that prints what its clock says, s since 1970, and how long writing a file takes, s."""


class Machine(NamedTuple):
    """How it differs from the one that there is."""

    added_s: int = 0
    """To the wall clock."""
    disk_bytes_s: int = 0
    """Of what is written to files; 0: as fast as the disk is."""


def compiler() -> str:
    """The C compiler of this machine. Raises ConfigError where there is none."""
    found = shutil.which("cc")
    if found is None:
        raise ConfigError("needs a C compiler (cc)")
    return found


def compile_library(folder: Path) -> Path:
    """Make the library in a folder. Raises ConfigError where that fails."""
    made = folder / "machine.so"
    command = [compiler(), "-shared", "-fPIC", "-O2", "-o", str(made), str(_SOURCE), "-ldl"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    if done.returncode:
        said = done.stderr.strip().splitlines()
        raise ConfigError(f"{_SOURCE.name}: {said[-1] if said else done.returncode}")
    return made


def variables(library: str, file: str) -> dict[str, str]:
    """With which a program's machine follows a file."""
    return {"LD_PRELOAD": library, "MACHINE_FILE": file}


def set_machine(file: Path, machine: Machine) -> None:
    """Change the machine that follows a file. It is changed in its place: it is mapped."""
    with file.open("r+b" if file.exists() else "wb") as opened:
        opened.write(struct.pack("=qq", *machine))


def check(shown: str, machine: Machine, who: str) -> None:
    """Raises ConfigError where what a program prints by `SHOW` is not of such a machine."""
    wall_s, write_s = map(float, shown.split())
    if abs(wall_s - time.time() - machine.added_s) > _NEAR_S:
        raise ConfigError(f"{who}: the clock cannot be set here")
    if machine.disk_bytes_s and write_s < _TRIED_BYTES / machine.disk_bytes_s:
        raise ConfigError(f"{who}: the disk cannot be made slow here")

"""Wall clocks of services that can be set while they run: by a library of a few lines that is
loaded before all others, since Debian's libfaketime 0.9.10 makes Python 3.11's `time.sleep` fail
where the monotonic clock is left alone (https://github.com/wolfcw/libfaketime/issues/426).
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import time
from pathlib import Path

from mazebot.common.config import ConfigError

_SOURCE = Path(__file__).with_name("clock.c")
_NEAR_S = 60.0
SHOW = "import time; print(time.time())"
"""A program that shows what its clock says, s since 1970."""


def compiler() -> str:
    """The C compiler of this machine. Raises ConfigError where there is none."""
    found = shutil.which("cc")
    if found is None:
        raise ConfigError("needs a C compiler (cc)")
    return found


def compile_library(folder: Path) -> Path:
    """Make the library in a folder. Raises ConfigError where that fails."""
    made = folder / "clock.so"
    command = [compiler(), "-shared", "-fPIC", "-O2", "-o", str(made), str(_SOURCE), "-ldl"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    if done.returncode:
        said = done.stderr.strip().splitlines()
        raise ConfigError(f"{_SOURCE.name}: {said[-1] if said else done.returncode}")
    return made


def variables(library: str, file: str) -> dict[str, str]:
    """With which a program's clock follows a file."""
    return {"LD_PRELOAD": library, "WALL_CLOCK_FILE": file}


def set_clock(file: Path, added_s: int) -> None:
    """Set the clocks that follow a file. It is changed in its place: it is mapped."""
    with file.open("r+b" if file.exists() else "wb") as opened:
        opened.write(struct.pack("=q", added_s))


def check(shown_s: float, added_s: int, who: str) -> None:
    """Raises ConfigError where a clock does not show what it was set to."""
    if abs(shown_s - time.time() - added_s) > _NEAR_S:
        raise ConfigError(f"{who}: the clock cannot be set here")

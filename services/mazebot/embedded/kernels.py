"""Compiles the kernels of the list in advance. `make env` and the image's build run it."""

from __future__ import annotations

import sys

from rich.console import Console

from mazebot.embedded.compile_progress import CompileProgress
from mazebot.embedded.compiling import Compiling


def compile_all() -> bool:
    """Compile all of them side by side, and show progress; whether each could be, else print which
    could not.
    """
    compiling = Compiling(CompileProgress(Console(stderr=True)))
    try:
        compiling.compile_all()
    finally:
        compiling.close()
    if compiling.failed:
        sys.stderr.write(f"error: not compiled: {', '.join(sorted(compiling.failed))}\n")
    return not compiling.failed


if __name__ == "__main__":
    sys.exit(not compile_all())

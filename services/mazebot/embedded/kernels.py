"""Compiles the kernels of the list in advance. `make env` and the image's build run it."""

from __future__ import annotations

from rich.console import Console

from mazebot.embedded.compile_progress import CompileProgress
from mazebot.embedded.compiling import Compiling


def main() -> None:
    """Compile all of them side by side."""
    compiling = Compiling(CompileProgress(Console(stderr=True)))
    try:
        compiling.compile_all()
    finally:
        compiling.close()


if __name__ == "__main__":
    main()

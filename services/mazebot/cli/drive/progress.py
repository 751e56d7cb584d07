"""A progress line: overwritten where standard output is a terminal, else told by `patience`."""

from __future__ import annotations

import shutil
import sys
from typing import Self

from mazebot.cli.parsing.patience import doing

_ERASE_LINE = "\r\x1b[K"


class ProgressLine:
    """Prints lines, and below them a progress line that is overwritten."""

    def __init__(self, wanted: bool = True) -> None:
        """`wanted`: False prints nothing."""
        self._wanted = wanted
        self._updates = wanted and sys.stdout.isatty()
        self._shown = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.show("")

    def say(self, text: str) -> None:
        """Print a permanent line."""
        shown = self._shown
        self.show("")
        if self._wanted:
            sys.stdout.write(f"{text}\n")
            sys.stdout.flush()
        self.show(shown)

    def show(self, text: str) -> None:
        """Replace the progress line; "": none. It is cut to the terminal's width."""
        doing("" if self._updates else text)
        if not self._updates or text == self._shown:
            return
        self._shown = text
        cut = text[: max(shutil.get_terminal_size().columns - 1, 20)]
        sys.stdout.write(f"{_ERASE_LINE}{cut}")
        sys.stdout.flush()

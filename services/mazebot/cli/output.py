"""What a command reads and prints to: closed, full, or for the letters of ASCII alone."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterable
from typing import Any, Literal, TextIO, cast

_STDIN, _STDOUT, _STDERR = 0, 1, 2


class OutputError(OSError):
    """Standard output cannot be written; the text is one line."""


class _Output:
    """A stream of a command."""

    def __init__(self, stream: TextIO, is_needed: bool) -> None:
        self._stream = stream
        self._is_needed = is_needed

    def write(self, text: str) -> int:
        """See TextIO. Raises OutputError, or BrokenPipeError where nobody reads on."""
        with self._telling():
            return self._stream.write(text)
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """See TextIO."""
        self.write("".join(lines))

    def flush(self) -> None:
        """See TextIO. Raises as `write`."""
        with self._telling():
            self._stream.flush()

    @contextlib.contextmanager
    def _telling(self) -> Any:
        try:
            yield
        except BrokenPipeError:
            if self._is_needed:
                raise
        except OSError as error:
            if self._is_needed:
                reason = error.strerror or str(error)
                raise OutputError(f"standard output: cannot be written: {reason}") from error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def open_output() -> None:
    """Have `sys.stdout` and `sys.stderr` take any text. Where the first cannot be written, printing
    raises OutputError; where the second cannot, there is nobody to tell. A `sys.stdin` that was
    closed is empty.
    """
    # In this order the files get the numbers of the streams that were closed.
    sys.stdin = sys.stdin or _opened(_STDIN, os.O_RDONLY, "r")
    out = sys.stdout or _opened(_STDOUT, os.O_RDONLY, "w")
    err = sys.stderr or _opened(_STDERR, os.O_WRONLY, "w")
    if isinstance(out, io.TextIOWrapper):
        out.reconfigure(errors="replace")
    sys.stdout, sys.stderr = cast("Any", (_Output(out, True), _Output(err, False)))


def _opened(number: int, access: int, mode: Literal["r", "w"]) -> TextIO:
    """A stream that was closed: what is opened next must not get its number, and what is printed.
    Of the null device opened to read, writing to it fails as before.
    """
    fd = os.open(os.devnull, access)
    if fd != number:
        os.dup2(fd, number)
        os.close(fd)
    return open(number, mode, encoding="utf-8", closefd=False)


def finish_output() -> None:
    """Write what waits to be written. Raises as `_Output.write`."""
    try:
        sys.stdout.flush()
    finally:
        sys.stderr.flush()


def give_up_output() -> None:
    """Standard output cannot be written: let what still waits go nowhere."""
    with contextlib.suppress(OSError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, _STDOUT)
        os.close(null)

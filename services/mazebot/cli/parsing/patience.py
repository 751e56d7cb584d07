"""What a command shows before its first output, where that takes long."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO, cast

_SHOW_AFTER_S = 0.1
"""A command that prints something sooner shows nothing else. Python takes 0.3 s before that."""
_PERIOD_S = 1.0
_ERASE_LINE = "\r\x1b[K"


def say_first(text: str, as_json: bool = False) -> None:
    """Print a command's first line, before it loads what it needs. With `as_json` programs read
    what it prints: they get the result alone.
    """
    if not as_json:
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()


@contextmanager
def patience(name: str) -> Iterator[None]:
    """Until the first output of a command, show on standard error that it works, and for how long,
    if that is a terminal.
    """
    if not sys.stderr.isatty():
        yield
        return
    out, err = sys.stdout, sys.stderr
    line = _Line(name, err)
    sys.stdout, sys.stderr = cast("Any", (_Watched(out, line), _Watched(err, line)))
    try:
        yield
    finally:
        line.end()
        sys.stdout, sys.stderr = out, err


class _Line:
    """A line that says that a command works, overwritten every second."""

    def __init__(self, name: str, stream: TextIO) -> None:
        self._name = name
        self._stream = stream
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._shown = False
        self._begin_s = time.monotonic()
        threading.Thread(target=self._show, name="patience", daemon=True).start()

    def _show(self) -> None:
        wait_s = _SHOW_AFTER_S
        while not self._ended.wait(wait_s):
            wait_s = _PERIOD_S
            elapsed_s = time.monotonic() - self._begin_s
            text = f"{self._name}: working" + (f", {elapsed_s:.0f} s" if elapsed_s >= 1.0 else "")
            with self._lock:
                if not self._ended.is_set():
                    self._shown = True
                    self._stream.write(f"{_ERASE_LINE}{text}")
                    self._stream.flush()

    def end(self) -> None:
        """Erase it; the command goes on where it began."""
        with self._lock:
            self._ended.set()
            if self._shown:
                self._shown = False
                self._stream.write(_ERASE_LINE)
                self._stream.flush()


class _Watched:
    """A stream whose first output ends a line."""

    def __init__(self, stream: TextIO, line: _Line) -> None:
        self._stream = stream
        self._line = line

    def write(self, text: str) -> int:
        """See TextIO."""
        self._line.end()
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

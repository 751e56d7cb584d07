"""What a command shows while it says nothing else."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO, cast

_SHOW_AFTER_S = 0.1
_LINE_AFTER_S = 0.3
"""A command that prints something sooner shows nothing else: on a terminal, where it is erased
again, and elsewhere.
"""
_SILENCE_S = 1.5
"""After this time without output it is shown again that the command works."""
_PERIOD_S = 1.0
_LINE_PERIOD_S = 1.5
_ERASE_LINE = "\r\x1b[K"
_WORKING = "working"


def say_first(text: str, as_json: bool = False) -> None:
    """Print a command's first line, before it loads what it needs. With `as_json` programs read
    what it prints: they get the result alone.
    """
    if not as_json:
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()


@contextmanager
def patience(name: str) -> Iterator[None]:
    """While a command prints nothing, show on standard error that it works, and for how long: on a
    terminal a line that is overwritten, elsewhere a line now and then.
    """
    unwanted = os.environ.get("MAZEBOT_PROGRESS") == "false" and not sys.stderr.isatty()
    if unwanted or "_MAZEBOT_COMPLETE" in os.environ:
        # A program reads it, or a shell asks, below what a person is typing.
        yield
        return
    out, err = sys.stdout, sys.stderr
    line = _Line(name, err)
    _LINES.append(line)
    sys.stdout, sys.stderr = cast("Any", (_Watched(out, line), _Watched(err, line)))
    try:
        yield
    finally:
        line.end()
        _LINES.remove(line)
        sys.stdout, sys.stderr = out, err


def doing(text: str) -> None:
    """What is shown instead of `working` from now on; "": nothing special."""
    for line in _LINES:
        line.text = text or _WORKING


def wait_quietly() -> None:
    """From now on the command waits for others, and says something when there is something to
    say.
    """
    for line in _LINES:
        line.end()


class _Line:
    """A line that says that a command works."""

    def __init__(self, name: str, stream: TextIO) -> None:
        self.text = _WORKING
        self._name = name
        self._stream = stream
        self._is_terminal = stream.isatty()
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._shown = False
        self._at_line_start = True
        self._begin_s = time.monotonic()
        self._due_s = self._begin_s + (_SHOW_AFTER_S if self._is_terminal else _LINE_AFTER_S)
        threading.Thread(target=self._run, name="patience", daemon=True).start()

    def _run(self) -> None:
        while not self._ended.wait(max(self._due_s - time.monotonic(), 0.0)):
            with self._lock:
                now_s = time.monotonic()
                if self._ended.is_set() or now_s < self._due_s:
                    continue
                self._due_s = now_s + (_PERIOD_S if self._is_terminal else _LINE_PERIOD_S)
                if self._at_line_start and not self._show(now_s - self._begin_s):
                    return

    def _show(self, elapsed_s: float) -> bool:
        """Whether somebody still reads it."""
        text = f"{self._name}: {self.text}" + (f", {elapsed_s:.0f} s" if elapsed_s >= 1.0 else "")
        try:
            self._stream.write(f"{_ERASE_LINE}{text}" if self._is_terminal else f"{text}\n")
            self._stream.flush()
        except (OSError, ValueError):
            return False
        self._shown = self._is_terminal
        return True

    def write(self, stream: TextIO, text: str) -> int:
        """Print what the command says; it goes on where it stopped."""
        with self._lock:
            if self._ended.is_set():
                return stream.write(text)
            self._erase()
            self._due_s = time.monotonic() + _SILENCE_S
            if text:
                self._at_line_start = text.endswith(("\n", _ERASE_LINE))
            return stream.write(text)

    def end(self) -> None:
        """Show nothing more."""
        with self._lock:
            self._ended.set()
            self._erase()

    def _erase(self) -> None:
        if self._shown:
            self._shown = False
            self._stream.write(_ERASE_LINE)
            self._stream.flush()


_LINES: list[_Line] = []
"""That of the command of this process, if it runs one."""


class _Watched:
    """A stream of a command, whose output is no silence."""

    def __init__(self, stream: TextIO, line: _Line) -> None:
        self._stream = stream
        self._line = line

    def write(self, text: str) -> int:
        """See TextIO."""
        return self._line.write(self._stream, text)

    def writelines(self, lines: Iterable[str]) -> None:
        """See TextIO."""
        self.write("".join(lines))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

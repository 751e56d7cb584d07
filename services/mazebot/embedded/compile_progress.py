"""Tells how much of compiling is done."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

_TEXT = "compiling kernels, once: {} of {}"
_LINE_PERIOD_S = 1.5


class CompileProgress:
    """On a terminal a bar while kernels are waited for, elsewhere a line now and then."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._told_s = -math.inf
        self._has_bar = False

    @contextmanager
    def waiting(self) -> Iterator[Callable[[int, int], None]]:
        """A function to call with how many kernels are compiled, of how many."""
        if not self._console.is_terminal:
            yield self._tell
            return
        if self._has_bar:
            # Another thread waits, too.
            yield lambda done, total: None
            return
        self._has_bar = True
        try:
            with self._bar() as show:
                yield show
        finally:
            self._has_bar = False

    @contextmanager
    def _bar(self) -> Iterator[Callable[[int, int], None]]:
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, console=self._console, transient=True) as progress:
            task = progress.add_task("")

            def show(done: int, total: int) -> None:
                text = _TEXT.format(done, total)
                progress.update(task, description=text, completed=done, total=total)

            yield show

    def _tell(self, done: int, total: int) -> None:
        now_s = time.monotonic()
        if now_s - self._told_s >= _LINE_PERIOD_S:
            self._told_s = now_s
            self._console.print(_TEXT.format(done, total), highlight=False)

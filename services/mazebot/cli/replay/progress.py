"""The progress line of a replay."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from mazebot.cli.parsing.patience import doing

_PERIOD_S = 0.1


@contextmanager
def shown(start_ns: int, end_ns: int) -> Iterator[Callable[[int], bool]]:
    """A function that shows the simulation time it is given, on standard error: a bar on a
    terminal, else the line of `patience`.
    """
    console = Console(stderr=True)
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.1f}/{task.total:.1f} s"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    all_s = (end_ns - start_ns) * 1e-9
    with progress:
        task = progress.add_task("replay", total=all_s)
        shown_s = 0.0

        def watch(now_ns: int) -> bool:
            nonlocal shown_s
            now_s = time.monotonic()
            if now_s - shown_s >= _PERIOD_S:
                shown_s = now_s
                done_s = (now_ns - start_ns) * 1e-9
                progress.update(task, completed=done_s)
                doing(f"{done_s:.1f} of {all_s:.1f} s replayed")
            return True

        yield watch
    doing("")

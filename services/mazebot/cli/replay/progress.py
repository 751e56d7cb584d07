"""The progress line of a replay."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

_PERIOD_S = 0.1
_LINE_PERIOD_S = 2.0


@contextmanager
def shown(start_ns: int, end_ns: int, lines: bool = False) -> Iterator[Callable[[int], bool]]:
    """A function that shows the simulation time it is given, on standard error: a bar on a
    terminal, else with `lines` a line now and then.
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
    with progress:
        task = progress.add_task("replay", total=(end_ns - start_ns) * 1e-9)
        shown_s, line_s = 0.0, time.monotonic()

        def watch(now_ns: int) -> bool:
            nonlocal shown_s, line_s
            now_s = time.monotonic()
            if now_s - shown_s >= _PERIOD_S:
                shown_s = now_s
                progress.update(task, completed=(now_ns - start_ns) * 1e-9)
            if lines and now_s - line_s >= _LINE_PERIOD_S and not console.is_terminal:
                line_s = now_s
                done_s, all_s = ((ns - start_ns) * 1e-9 for ns in (now_ns, end_ns))
                sys.stderr.write(f"replay: {done_s:.1f} of {all_s:.1f} s\n")
                sys.stderr.flush()
            return True

        yield watch

"""How the benchmarks end that start other processes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from mazebot.common.stop_signals import exit_code_of, interrupt_on_stop


def run(main: Callable[[Sequence[str]], int]) -> NoReturn:
    """Run `main` with the arguments of the command line; a stop signal ends what it has
    started, too, and says no more.
    """
    stops: list[int] = []
    interrupt_on_stop(stops)
    try:
        code = main(sys.argv[1:])
    except KeyboardInterrupt:
        code = exit_code_of(stops)
    sys.exit(code)

"""How the benchmarks end that start other processes."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

_INTERRUPTED = 130
"""As shells have it."""


def run(main: Callable[[Sequence[str]], int]) -> NoReturn:
    """Run `main` with the arguments of the command line; Ctrl-C and SIGTERM end what it has
    started, too, and say no more.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        code = main(sys.argv[1:])
    except KeyboardInterrupt:
        code = _INTERRUPTED
    sys.exit(code)

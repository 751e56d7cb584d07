"""Compiles kernels for another process: `python -m mazebot.embedded.compiler`.

Reads names of modules, one a line, and compiles what the list has of each. Prints the name of each
kernel once it is on the disk, and WHOLE or FAILED after a module. Ends with its standard input.
"""

from __future__ import annotations

import logging
import signal
import sys

from mazebot.common.stop_signals import stop_signals
from mazebot.embedded.kernel_list import Listed, listed

WHOLE, FAILED = "/whole", "/failed"


def main() -> None:
    """Serve until the input ends."""
    # Ctrl-C and the end of the terminal are for the process that started this one, which closes
    # the input.
    for number in stop_signals():
        if number is not signal.SIGTERM:
            signal.signal(number, signal.SIG_IGN)
    logging.disable(logging.WARNING)
    rows: dict[str, list[Listed]] = {}
    for one in listed():
        rows.setdefault(one.module, []).append(one)
    for line in sys.stdin:
        _answer(_compiled(rows[line.strip()]))


def _compiled(rows: list[Listed]) -> str:
    try:
        for one in rows:
            one.compile()
            _answer(one.name)
    except Exception as error:
        sys.stderr.write(f"{one.module}.{one.name}: {error}\n")
        return FAILED
    return WHOLE


def _answer(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()

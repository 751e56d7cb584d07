"""Compiles kernels for another process: `python -m mazebot.embedded.compiler`.

Reads names of modules, one a line, and compiles what the list has of each. Prints the name of each
kernel once it is on the disk, and an empty line after a module. Ends with its standard input.
"""

from __future__ import annotations

import logging
import signal
import sys

from mazebot.embedded.kernel_list import Listed, listed


def main() -> None:
    """Serve until the input ends."""
    # Ctrl-C is for the process that started this one, which closes the input.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.disable(logging.WARNING)
    rows: dict[str, list[Listed]] = {}
    for one in listed():
        rows.setdefault(one.module, []).append(one)
    for line in sys.stdin:
        for one in rows[line.strip()]:
            one.compile()
            print(one.name, flush=True)  # noqa: T201 - the answer
        print(flush=True)  # noqa: T201


if __name__ == "__main__":
    main()

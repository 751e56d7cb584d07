"""The command `mazebot`: seen to work before it has loaded what it needs."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from typing import NoReturn

from mazebot.cli.output import OutputError, finish_output, give_up_output, open_output
from mazebot.cli.parsing.patience import patience
from mazebot.common.stop_signals import INTERRUPTED, exit_code_of, interrupt_on_stop

GROUPS = ("topic", "recordings", "world", "map", "markers", "sim", "keys", "security")
_NOT_WRITTEN = 2


def named(arguments: Sequence[str]) -> str:
    """The command with its group, as `mazebot map build`."""
    words = [word for word in arguments[1:3] if word.isalpha()]
    return " ".join(["mazebot", *words[: 2 if words[:1] and words[0] in GROUPS else 1]])


def main() -> NoReturn:
    """Run the command."""
    # The threads of NumPy's, SciPy's and OpenCV's OpenBLAS wait for work in a loop: 0.2 s of
    # processor time in each process that starts. No matrix here is large enough for them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    open_output()
    try:
        code = _run()
        finish_output()
    except (BrokenPipeError, OutputError) as error:
        give_up_output()
        code = 0
        if isinstance(error, OutputError):
            sys.stderr.write(f"error: {error}\n")
            code = _NOT_WRITTEN
    _end(code)


def _run() -> str | int | None:
    """Run the command and return its exit code."""
    stops: list[int] = []
    # As Ctrl-C: a goal is canceled, a file is closed.
    for number, before in interrupt_on_stop(stops).items():
        # A shell has its background jobs ignore Ctrl-C.
        if before is signal.SIG_IGN:
            signal.signal(number, before)
    code = _interruptible()
    return exit_code_of(stops) if code == INTERRUPTED else code


def _interruptible() -> str | int | None:
    try:
        with patience(named(sys.argv)):
            from mazebot.cli import app  # noqa: PLC0415 - loads every command

            app.main()
    except KeyboardInterrupt:
        # While it was loaded.
        return INTERRUPTED
    except SystemExit as ended:
        return ended.code


def _end(code: str | int | None) -> NoReturn:
    """End the process. Zenoh's threads may still run: one that meets an interpreter which is being
    taken down ends the process with a signal, in place of its exit code.
    """
    if "zenoh" not in sys.modules or not isinstance(code, int):
        sys.exit(code)
    os._exit(code)


if __name__ == "__main__":
    main()

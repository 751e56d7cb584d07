"""The signals that stop a command which has something to close."""

from __future__ import annotations

import contextlib
import os
import signal
import stat
import threading
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], object]

# Windows has no SIGHUP.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
_OUTPUTS = (1, 2)
_SIGNALED = 128
INTERRUPTED = _SIGNALED + signal.SIGINT
"""Exit code of a command that Ctrl-C has stopped, as shells have it."""


def stop_signals() -> tuple[signal.Signals, ...]:
    """Ctrl-C, SIGTERM and the end of the terminal; not the last one where it is ignored, as by
    `nohup`.
    """
    there = [signal.Signals[name] for name in _NAMES if name in signal.Signals.__members__]
    return tuple(
        one for one in there if one.name != "SIGHUP" or signal.getsignal(one) is not signal.SIG_IGN
    )


def on_stop(handler: Handler) -> dict[signal.Signals, Any]:
    """Have a function called on each stop signal; returns what was called before. What is written
    after the end of the terminal goes nowhere, and is no error.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        _leave_ended_terminal()
        handler(number, frame)

    return {number: signal.signal(number, handle) for number in stop_signals()}


def interrupt_on_stop(stops: list[int]) -> dict[signal.Signals, Any]:
    """Have each stop signal raise KeyboardInterrupt, as Ctrl-C does, and put its number into a
    list; returns as `on_stop`.
    """

    def stop(number: int, frame: FrameType | None) -> None:
        stops.append(number)
        signal.default_int_handler(number, frame)

    return on_stop(stop)


def exit_code_of(stops: Sequence[int]) -> int:
    """Exit code of a command after stop signals, as shells have it: 128 and the first one's
    number; without any, that of Ctrl-C.
    """
    return _SIGNALED + (stops[0] if stops else signal.SIGINT)


@contextlib.contextmanager
def stopped_by(handler: Handler) -> Iterator[None]:
    """As `on_stop`, while the context lasts."""
    before = on_stop(handler)
    try:
        yield
    finally:
        for number, one in before.items():
            signal.signal(number, one)


@contextlib.contextmanager
def interrupt_held_back() -> Iterator[None]:
    """What is done in this context is done as a whole: Ctrl-C interrupts it only at its end, the
    second time at once. Only where Ctrl-C raises KeyboardInterrupt, in the main thread.
    """
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    came = False

    def remember(number: int, frame: FrameType | None) -> None:
        nonlocal came
        if came:
            signal.default_int_handler(number, frame)
        came = True

    signal.signal(signal.SIGINT, remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if came:
            raise KeyboardInterrupt


def _leave_ended_terminal() -> None:
    """Put the null device in the place of a terminal that is no longer there."""
    for fd in _OUTPUTS:
        with contextlib.suppress(OSError):
            # One that has ended is still a device, but answers as a terminal no more.
            if stat.S_ISCHR(os.fstat(fd).st_mode) and not os.isatty(fd):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, fd)
                os.close(null)

"""Waiting for a signal to stop."""

from __future__ import annotations

import signal
from collections.abc import Iterable

from mazebot.common.stop_signals import stop_signals

STOPS = stop_signals()


def stop_came(timeout_s: float, others: Iterable[signal.Signals] = ()) -> bool:
    """Wait for a stop signal, and whether one came; `others` end the wait, too. The calling thread
    must have blocked them all.
    """
    came = signal.sigtimedwait({*STOPS, *others}, timeout_s)
    # Where the process was frozen meanwhile (`kill -STOP`, `docker pause`, a machine that slept),
    # Python may return what no signal was.
    return came is not None and came.si_signo in STOPS

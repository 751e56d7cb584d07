"""Watchdog of the router, in a process outside it, because the router works in Zenoh's threads.

Once a second it queries the router's token, like any client. If there is no response for too long,
it ends the router and itself: its supervisor (Docker, by `restart`) restarts both.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from typing import NoReturn

import zenoh

from mazebot.common.bus.health import open_client, token_stands
from mazebot.common.config import ConfigError, fail
from mazebot.common.settings.load import load
from mazebot.router.config import RouterConfig

EXIT_NO_RESPONSE = 70
PERIOD_S = 1.0
START_TICKS = 30
"""Periods within which a router that was just started must first respond."""
STOP_S = 3.0
STOPS = {signal.SIGTERM, signal.SIGINT}
# Not read through BusConfig, whose import takes 30 MB of memory.
_PREFIX = "MAZEBOT_BUS_PREFIX"


class ResponseTimer:
    """Counts the guard's own ticks since the last response: time while paused does not count."""

    def __init__(self, patience_ticks: int) -> None:
        self._patience_ticks = patience_ticks
        self._left = max(START_TICKS, patience_ticks)

    def responded(self) -> None:
        """The router has responded."""
        self._left = self._patience_ticks

    def tick(self) -> bool:
        """One more period is over; return whether the router has timed out."""
        self._left -= 1
        return self._left < 0


def main(arguments: list[str]) -> NoReturn:
    """Run the router until it receives a stop signal or no longer responds; the exit code is the
    router's, or 70.
    """
    try:
        config = load(RouterConfig, "router", arguments)
    except ConfigError as error:
        fail(str(error))
    signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    router = subprocess.Popen([sys.executable, "-m", "mazebot.router.process", *arguments])
    timer = ResponseTimer(round(config.silence_s / PERIOD_S))
    asking = threading.Thread(target=_ask, args=(reachable(config.listen), timer), daemon=True)
    asking.start()
    while signal.sigtimedwait(STOPS, PERIOD_S) is None:
        code = router.poll()
        if code is not None:
            _end(code if code >= 0 else 128 - code)
        if timer.tick():
            sys.stderr.write(f"error: router: no response for {config.silence_s:g} s; exiting\n")
            router.kill()
            router.wait()
            _end(EXIT_NO_RESPONSE)
    router.terminate()
    try:
        _end(router.wait(STOP_S))
    except subprocess.TimeoutExpired:
        router.kill()
        _end(0)


def reachable(listen: str) -> str:
    """The endpoint by which this machine reaches `listen`, which may be a wildcard address."""
    return re.sub(r"/(0\.0\.0\.0|\[::\]):", "/127.0.0.1:", listen)


def _ask(endpoint: str, timer: ResponseTimer) -> None:
    """Query the router periodically. A call that never returns counts as no response, too."""
    session: zenoh.Session | None = None
    while True:
        try:
            session = session or open_client(endpoint)
            if token_stands(session, "router", os.environ.get(_PREFIX, "")):
                timer.responded()
        except zenoh.ZError:
            session = None
        time.sleep(PERIOD_S)


def _end(code: int) -> NoReturn:
    sys.stdout.flush()
    sys.stderr.flush()
    # Zenoh's threads have nothing left to do.
    os._exit(code)

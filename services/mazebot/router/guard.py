"""Watchdog of the router, in a process outside it, because the router works in Zenoh's threads.

Once a second it queries the router's token, like any client. If there is no response for too long,
it ends the router and itself: its supervisor (Docker, by `restart`) restarts both.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import NoReturn

import zenoh

from mazebot.common.bus.health import open_client, root_of_environment, token_stands
from mazebot.common.config import ConfigError, fail
from mazebot.common.files.key_file import Key, KeyFileError, file_of, read_key
from mazebot.common.settings.load import load
from mazebot.router.config import RouterConfig
from mazebot.router.stopping import STOPS, stop_came

EXIT_NO_RESPONSE = 70
PERIOD_S = 1.0
START_TICKS = 30
"""Periods within which a router that was just started must first respond."""
_STARVED_S = 0.2
"""Time that the router's threads wait for a processor in a period, from which on it is starved."""
_STARVED_TICK = 0.2
STOP_S = 3.0


class ResponseTimer:
    """Counts the guard's own ticks since the last response: time while paused does not count."""

    def __init__(self, patience_ticks: int) -> None:
        self._patience_ticks = patience_ticks
        self._left = float(max(START_TICKS, patience_ticks))

    def responded(self) -> None:
        """The router has responded."""
        self._left = self._patience_ticks

    def tick(self, starved: bool = False) -> bool:
        """One more period is over; return whether the router has timed out. `starved`: in that
        period it has waited for a processor, which does not say that it hangs.
        """
        self._left -= _STARVED_TICK if starved else 1.0
        return self._left < 0


class Starvation:
    """Whether a process lacks a processor, by the time that the kernel counts."""

    def __init__(self, pid: int) -> None:
        self._tasks = Path(f"/proc/{pid}/task")
        self._waited_ns = self._read_ns()

    def look(self) -> bool:
        """Whether its threads have waited for more than `_STARVED_S` since the last call."""
        waited_ns, self._waited_ns = self._waited_ns, self._read_ns()
        return self._waited_ns - waited_ns > _STARVED_S * 1e9

    def _read_ns(self) -> int:
        waited_ns = 0
        # A kernel without these figures, or a thread that has just ended.
        with contextlib.suppress(OSError, ValueError, IndexError):
            for task in self._tasks.iterdir():
                waited_ns += int((task / "schedstat").read_text().split()[1])
        return waited_ns


def main(arguments: list[str]) -> NoReturn:
    """Run the router until it receives a stop signal or no longer responds; the exit code is the
    router's, or 70.
    """
    try:
        config = load(RouterConfig, "router", arguments)
    except ConfigError as error:
        fail(str(error))
    # The end of the router wakes the loop below at once.
    signal.pthread_sigmask(signal.SIG_BLOCK, {*STOPS, signal.SIGCHLD})
    router = subprocess.Popen([sys.executable, "-m", "mazebot.router.process", *arguments])
    timer = ResponseTimer(round(config.silence_s / PERIOD_S))
    asking = threading.Thread(target=_ask, args=(config, timer), daemon=True)
    asking.start()
    starvation = Starvation(router.pid)
    while not stop_came(PERIOD_S, (signal.SIGCHLD,)):
        code = router.poll()
        if code is not None:
            _end(code if code >= 0 else 128 - code)
        if timer.tick(starvation.look()):
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


def _ask(config: RouterConfig, timer: ResponseTimer) -> None:
    """Query the router periodically. A call that never returns counts as no response, too."""
    endpoint, session = reachable(config.listen), None
    while True:
        try:
            session = session or open_client(endpoint, _own_key(config.keys_dir))
            if token_stands(session, "router", root_of_environment()):
                timer.responded()
            else:
                # It may have been opened with a key that the router has no more.
                session.close()  # type: ignore[no-untyped-call]
                session = None
        except (zenoh.ZError, KeyFileError):
            session = None
        time.sleep(PERIOD_S)


def _own_key(folder: Path | None) -> Key | None:
    """The router's key. Raises KeyFileError where there is none yet."""
    return None if folder is None else read_key(file_of(folder, "router"))


def _end(code: int) -> NoReturn:
    sys.stdout.flush()
    sys.stderr.flush()
    # Zenoh's threads have nothing left to do.
    os._exit(code)

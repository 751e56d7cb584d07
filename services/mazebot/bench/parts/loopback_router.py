"""A private router on the loopback interface."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import BusUnavailableError, open_session

_DEADLINE_S = 20.0


def free_port() -> int:
    """A free port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def running_router(port: int | None = None) -> Iterator[str]:
    """The endpoint of a router in its own process that accepts connections.

    Raises TimeoutError where it does not accept them.
    """
    endpoint = f"tcp/127.0.0.1:{port or free_port()}"
    command = [sys.executable, "-m", "mazebot.router", "--listen", endpoint]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        wait_for_router(endpoint)
        yield endpoint
    finally:
        process.terminate()
        process.wait(_DEADLINE_S)


def wait_for_router(endpoint: str) -> None:
    """Wait until a session can be opened. Raises TimeoutError where none can be."""
    deadline_s = time.monotonic() + _DEADLINE_S
    while time.monotonic() < deadline_s:
        try:
            session = open_session(BusConfig(connect=endpoint))
        except BusUnavailableError:
            continue
        session.close()  # type: ignore[no-untyped-call]
        return
    raise TimeoutError(f"no router at {endpoint}")

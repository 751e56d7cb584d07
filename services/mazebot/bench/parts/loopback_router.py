"""A private router on the loopback interface."""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import BusUnavailableError, open_session

_DEADLINE_S = 20.0
_FIRST_PORT, _PORTS = 18_000, 14_000
"""Below those that the system gives to outgoing connections, which would take one before its server
does.
"""
_tried = itertools.count(os.getpid() * 97)


def free_port() -> int:
    """A free port, another one each time. Processes begin at different ones."""
    for number in itertools.islice(_tried, _PORTS):
        port = _FIRST_PORT + number % _PORTS
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(f"no free port from {_FIRST_PORT} on")


@contextmanager
def running_router(
    port: int | None = None, keys_dir: Path | None = None, encrypts: bool = False
) -> Iterator[str]:
    """The endpoint of a router in its own process that accepts connections; with `keys_dir`, of
    those alone who have a key. `encrypts`: by TLS, which needs keys.

    Raises TimeoutError where it does not accept them.
    """
    endpoint = f"{'tls' if encrypts else 'tcp'}/127.0.0.1:{port or free_port()}"
    command = [sys.executable, "-m", "mazebot.router", "--listen", endpoint]
    key_file = None
    if keys_dir is not None:
        command += ["--keys-dir", str(keys_dir)]
        key_file = keys_dir / "router.key"
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        wait_for_router(endpoint, key_file)
        yield endpoint
    finally:
        process.terminate()
        process.wait(_DEADLINE_S)


def wait_for_router(endpoint: str, key_file: Path | None = None) -> None:
    """Wait until a session can be opened. Raises TimeoutError where none can be."""
    deadline_s = time.monotonic() + _DEADLINE_S
    while time.monotonic() < deadline_s:
        try:
            session = open_session(BusConfig(connect=endpoint, key_file=key_file))
        except BusUnavailableError:
            continue
        session.close()  # type: ignore[no-untyped-call]
        return
    raise TimeoutError(f"no router at {endpoint}")

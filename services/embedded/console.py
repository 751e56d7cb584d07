"""The console beside a run in this process."""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import uvicorn

from services.common.bus.pace import Pace
from services.common.config import ConfigError
from services.common.node.executive import Executive
from services.common.node.node import ClockNode
from services.console.config import ConsoleConfig
from services.console.live.routes import live_routes
from services.console.server import build_app
from services.embedded.memory_stack import MemoryStack, WatchedTransport

SERVED = "console: "
"""Before the address in the log message."""
_LOG = logging.getLogger("console")
_IDLE_S = 0.02
_CLOSE_S = 3.0
_HERE = ("127.0.0.1", "::1", "0.0.0.0", "::")
_MAX_MESSAGE_BYTES = 65_536


class ConsoleBeside:
    """A console for one run, on a thread of its own."""

    def __init__(self, config: ConsoleConfig) -> None:
        """Raises ConfigError where the port is in use or may not be bound."""
        self._config = config
        self._listener = _bound(config)
        self.transport = WatchedTransport()
        """Of the run."""

    def play(self, executive: Executive, until: Callable[[], bool]) -> None:
        """Run in real time, or at the speed that the console asks for, until `until()` holds."""
        stack = MemoryStack(self.transport, executive)
        with self._served(stack) as url:
            _LOG.info("%s%s (Ctrl-C ends the run)", SERVED, url)
            _run(executive, stack, until)

    @contextmanager
    def _served(self, stack: MemoryStack) -> Iterator[str]:
        app = build_app(self._config, live_routes(stack))
        server = uvicorn.Server(
            uvicorn.Config(
                app, log_config=None, log_level="warning", ws_max_size=_MAX_MESSAGE_BYTES,
                timeout_graceful_shutdown=1, lifespan="off",
            )
        )  # fmt: skip
        thread = threading.Thread(
            target=server.run, args=([self._listener],), name="console", daemon=True
        )
        thread.start()
        name = "localhost" if self._config.bind in _HERE else self._config.bind
        try:
            yield f"http://{name}:{self._listener.getsockname()[1]}"
        finally:
            stack.close()
            server.should_exit = True
            thread.join(_CLOSE_S)


def _bound(config: ConsoleConfig) -> socket.socket:
    family = socket.AF_INET6 if ":" in config.bind else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((config.bind, config.port))
    except OSError as error:
        listener.close()
        raise ConfigError(
            f"--console-port: {config.port}: cannot be used on {config.bind}: {error.strerror}"
        ) from error
    return listener


def _run(executive: Executive, stack: MemoryStack, until: Callable[[], bool]) -> None:
    (clock,) = (node for node in executive.nodes if isinstance(node, ClockNode))
    clock.speed = 1.0
    pace = Pace()
    while not until():
        next_ns = clock.next_step_ns()
        if next_ns is None:
            pace.rest()
            stack.serve(_IDLE_S)
        else:
            wait_s = pace.wait_s(time.monotonic(), next_ns, clock.speed)
            stack.serve(wait_s)
            if wait_s > 0.0 and pace.wait_s(time.monotonic(), next_ns, clock.speed) > 0.0:
                # Something has come earlier: perhaps another speed.
                continue
        executive.turn()

"""What serves a run in this process to people: the console, Foxglove, a bus for commands."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from mazebot.common.bus.pace import Pace
from mazebot.common.config import ConfigError
from mazebot.common.node.executive import Executive
from mazebot.common.node.node import ClockNode, Node
from mazebot.common.own_command import own_command
from mazebot.console.config import ConsoleConfig
from mazebot.console.live.routes import live_routes
from mazebot.console.server import build_app
from mazebot.console.serving import ConsoleServer
from mazebot.embedded.memory_robot import MemoryRobot
from mazebot.embedded.watched_transport import WatchedTransport

SERVED = "console: "
"""Before the address in the log message."""
_LOG = logging.getLogger("console")
_IDLE_S = 0.02


class BusBeside(Protocol):
    """A bus on which the user's tools find the run."""

    def carry(self, nodes: Sequence[Node], transport: WatchedTransport) -> None:
        """Put the run on it."""

    def close(self) -> None:
        """End it, whether or not a run is on it."""


class Beside:
    """A run in real time, and a console on a thread of its own."""

    def __init__(
        self, config: ConsoleConfig | None = None, open_bus: Callable[[], BusBeside] | None = None
    ) -> None:
        """Without a `config` there is no console.

        Raises ConfigError where a port is in use or may not be bound.
        """
        self.transport = WatchedTransport()
        """Of the run."""
        self.robot = MemoryRobot(self.transport)
        self._server: ConsoleServer | None = None
        if config is not None:
            routes = live_routes(self.robot, own_command("demo", "--console"))
            self._server = ConsoleServer(build_app(config, routes), config)
        try:
            self._bus = None if open_bus is None else open_bus()
        except ConfigError:
            if self._server is not None:
                self._server.stop()
            raise

    @property
    def url(self) -> str:
        """The console's address; "": there is none."""
        return "" if self._server is None else self._server.url

    def play(self, executive: Executive, until: Callable[[], bool]) -> None:
        """Run in real time, or at the speed that is asked for, until `until()` holds."""
        self.robot.begin(executive)
        if self._server is not None:
            self._server.start()
            _LOG.info("%s%s (Ctrl-C ends the run)", SERVED, self.url)
            if self._server.viewers_url:
                _LOG.info("%s is for those who may only look on", self._server.viewers_url)
        if self._bus is not None:
            self._bus.carry(executive.nodes, self.transport)
        _run(executive, self.robot, until)

    def close(self) -> None:
        """End the console, and the bus."""
        if self._bus is not None:
            self._bus.close()
        self.robot.close()
        if self._server is not None:
            self._server.stop()


def _run(executive: Executive, robot: MemoryRobot, until: Callable[[], bool]) -> None:
    (clock,) = (node for node in executive.nodes if isinstance(node, ClockNode))
    clock.speed = 1.0
    pace = Pace()
    while not until():
        next_ns = clock.next_step_ns()
        if next_ns is None:
            pace.rest()
            robot.serve(_IDLE_S)
        else:
            wait_s = pace.wait_s(time.monotonic(), next_ns, clock.speed)
            robot.serve(wait_s)
            if wait_s > 0.0 and pace.wait_s(time.monotonic(), next_ns, clock.speed) > 0.0:
                # Something has come earlier: perhaps another speed.
                continue
        executive.turn()

"""The service from its flags and environment to its end."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Sequence

from mazebot.common.bus.config import BusConfig
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.client.reconnecting import ReconnectingRobot
from mazebot.common.client.robot import Robot
from mazebot.common.config import ConfigError, fail
from mazebot.common.node.log import RosFormatter
from mazebot.common.settings.load import load
from mazebot.console.config import ConsoleConfig
from mazebot.console.live.routes import live_routes
from mazebot.console.server import build_app
from mazebot.console.serving import ConsoleServer


def main(arguments: Sequence[str]) -> None:
    """Serve until SIGTERM or SIGINT. A wrong setting ends it with one line and exit code 2."""
    log_to_stdout()
    try:
        config = load(ConsoleConfig, "console", arguments)
        bus_config = load(BusConfig, "bus", [])
        serve(config, bus_config)
    except ConfigError as error:
        fail(str(error))


def log_to_stdout() -> None:
    """Print what the console logs, in ROS style."""
    handler = logging.StreamHandler(sys.stdout)
    handler.setFormatter(RosFormatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])


def serve(
    config: ConsoleConfig, bus_config: BusConfig, opener: Callable[[str], object] | None = None
) -> None:
    """Serve until SIGTERM or SIGINT; `opener` is called with the address of the first page.

    Raises ConfigError if the address cannot be used.
    """
    robot: Robot | None = None
    if config.live:
        robot = ReconnectingRobot(lambda: ZenohRobot(bus_config, start_s=1.0))
    try:
        live = () if robot is None else live_routes(robot)
        server = ConsoleServer(build_app(config, live), config)
        log = logging.getLogger("console")
        log.info("%s shows %s", server.url, config.recordings_dir)
        if server.viewers_url:
            log.info("%s is for those who may only look on", server.viewers_url)
        if opener is not None:
            opener(server.url)
        server.run()
    finally:
        if robot is not None:
            robot.close()

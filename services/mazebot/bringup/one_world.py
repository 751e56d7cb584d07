"""Exits with an error if a stack is running another world than the one about to be requested.

    python -m mazebot.bringup.one_world

Docker Compose runs this before a demo. It exits at once if nothing is running yet, and leaves all
other errors of the request to the demo.
"""

from __future__ import annotations

import os
import sys
import threading

from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.health import is_alive
from mazebot.common.bus.session import BusUnavailableError, join
from mazebot.common.bus.subscriber import subscribed
from mazebot.common.messages.topics import WORLD
from mazebot.common.settings.load import load

WORLD_PATIENCE_S = 5.0
"""Time to wait for the world of a running stack; it is latched, and comes at once where there is
time.
"""


def world_runs(config: BusConfig) -> bool:
    """Whether a world is loaded already. In lockstep no service replies before bringup runs."""
    try:
        session, _ = join(config)
    except BusUnavailableError:
        return False
    received = threading.Event()
    with subscribed(session, WORLD, lambda *_: received.set(), config.keys):
        runs = received.wait(WORLD_PATIENCE_S)
    session.close()  # type: ignore[no-untyped-call]
    return runs


def main() -> None:
    """Request the world; the exit code is the result."""
    config = load(BusConfig, "bus", [])
    if not is_alive(config.connect, "worldgen", config.keys.own("")) or not world_runs(config):
        os._exit(0)
    # Slow to import, and not needed if a stack is only starting.
    from mazebot.bringup.config import BringupConfig  # noqa: PLC0415
    from mazebot.bringup.node import BringupNode  # noqa: PLC0415
    from mazebot.common.bus.serve import main as serve  # noqa: PLC0415

    sys.argv[1:] = ["--only-ask", "true"]
    serve(BringupConfig, BringupNode)


if __name__ == "__main__":
    main()

"""Exits with an error if a stack is running another world than the one about to be requested.

    python -m mazebot.bringup.one_world

Docker Compose runs this before a demo. It exits at once if nothing is running yet, and leaves all
other errors of the request to the demo.
"""

from __future__ import annotations

import os
import sys
import threading

from mazebot.common.bus.bus import BusConfig, BusUnavailableError, open_session, subscribed
from mazebot.common.bus.health import is_alive
from mazebot.common.messages.topics import WORLD

WORLD_PATIENCE_S = 1.0
"""Time to wait for the world of a running stack; it is latched."""


def world_runs(endpoint: str, prefix: str = "") -> bool:
    """Whether a world is loaded already. In lockstep no service replies before bringup runs."""
    try:
        session = open_session(BusConfig(connect=endpoint, prefix=prefix))
    except BusUnavailableError:
        return False
    received = threading.Event()
    with subscribed(session, WORLD, lambda *_: received.set(), prefix):
        runs = received.wait(WORLD_PATIENCE_S)
    session.close()  # type: ignore[no-untyped-call]
    return runs


def main() -> None:
    """Request the world; the exit code is the result."""
    endpoint = os.environ.get("MAZEBOT_BUS_CONNECT") or "tcp/127.0.0.1:7447"
    prefix = os.environ.get("MAZEBOT_BUS_PREFIX", "")
    if not is_alive(endpoint, "worldgen", prefix) or not world_runs(endpoint, prefix):
        os._exit(0)
    # Slow to import, and not needed if a stack is only starting.
    from mazebot.bringup.config import BringupConfig  # noqa: PLC0415
    from mazebot.bringup.node import BringupNode  # noqa: PLC0415
    from mazebot.common.bus.serve import main as serve  # noqa: PLC0415

    sys.argv[1:] = ["--only-ask", "true"]
    serve(BringupConfig, BringupNode)


if __name__ == "__main__":
    main()

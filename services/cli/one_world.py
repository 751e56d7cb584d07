"""Ends with an error where a stack runs another world than the one that is about to be asked for.

    python -m services.cli.one_world

Docker Compose runs this before a demo. It ends at once where nothing runs yet, and leaves every
other mistake in a request for the demo to tell.
"""

from __future__ import annotations

import os
import sys
import threading

from services.common.bus.bus import BusConfig, BusUnavailableError, open_session, subscribe
from services.common.bus.health import is_alive
from services.common.node.topics import WORLD

WORLD_PATIENCE_S = 1.0
"""In which the world of a running stack is heard of; it is latched."""


def world_runs(endpoint: str, prefix: str = "") -> bool:
    """Whether there is a world already. In lockstep nobody would answer before there is a tour."""
    try:
        session = open_session(BusConfig(connect=endpoint, prefix=prefix))
    except BusUnavailableError:
        return False
    heard = threading.Event()
    subscription = subscribe(session, WORLD, lambda *_: heard.set(), prefix)
    runs = heard.wait(WORLD_PATIENCE_S)
    del subscription
    session.close()  # type: ignore[no-untyped-call]
    return runs


def main() -> None:
    """Ask, and leave with the answer as the exit code."""
    endpoint = os.environ.get("MAZEBOT_BUS_CONNECT") or "tcp/127.0.0.1:7447"
    prefix = os.environ.get("MAZEBOT_BUS_PREFIX", "")
    if not is_alive(endpoint, "worldgen", prefix) or not world_runs(endpoint, prefix):
        os._exit(0)
    # Slow to load, and not needed where a stack is only starting.
    from services.bringup.config import BringupConfig  # noqa: PLC0415
    from services.bringup.node import BringupNode  # noqa: PLC0415
    from services.common.bus.serve import main as serve  # noqa: PLC0415

    sys.argv[1:] = ["--only-ask", "true"]
    serve(BringupConfig, BringupNode)


if __name__ == "__main__":
    main()

"""Ends with an error where a stack runs another world than the one that is about to be asked for.

    python -m services.cli.one_world

Docker Compose runs this before a demo. It ends at once where nothing runs yet, and leaves every
other mistake in a request for the demo to tell.
"""

from __future__ import annotations

import os
import sys

from services.common.health import is_alive


def main() -> None:
    """Ask, and leave with the answer as the exit code."""
    endpoint = os.environ.get("MAZEBOT_BUS_CONNECT") or "tcp/127.0.0.1:7447"
    if not is_alive(endpoint, "worldgen", os.environ.get("MAZEBOT_BUS_PREFIX", "")):
        os._exit(0)
    # Slow to load, and not needed where a stack is only starting.
    from services.bringup.config import BringupConfig  # noqa: PLC0415
    from services.bringup.node import BringupNode  # noqa: PLC0415
    from services.common.serve import main as serve  # noqa: PLC0415

    sys.argv[1:] = ["--only-ask", "true"]
    serve(BringupConfig, BringupNode)


if __name__ == "__main__":
    main()

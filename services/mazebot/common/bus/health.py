"""Health check of a service by its liveliness token:
`python -m mazebot.common.bus.health physics`.

Docker runs it in every container every few seconds, so it imports nothing but Zenoh.
"""

from __future__ import annotations

import json
import os
import sys
import threading

import zenoh

ALIVE_KEY = "mazebot/alive/"
"""Prefix of a service's name; the same as in `bus.py`, which is slow to load."""
PATIENCE_S = 2.5


def open_client(endpoint: str) -> zenoh.Session:
    """A client session. Raises ZError where no router accepts connections at the endpoint."""
    settings = zenoh.Config()
    options = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 1000,
        "connect/exit_on_failure": True,
        "scouting/multicast/enabled": False,
    }
    for key, value in options.items():
        settings.insert_json5(key, json.dumps(value))
    return zenoh.open(settings)


def token_stands(session: zenoh.Session, service: str, prefix: str = "") -> bool:
    """Whether the router knows the service's token."""
    replies = session.liveliness().get(f"{prefix}{ALIVE_KEY}{service}/*", timeout=1.0)
    return any(reply.ok is not None for reply in replies)


def is_alive(endpoint: str, service: str, prefix: str = "") -> bool:
    """Whether a router responds at `endpoint` and knows the service's token."""
    try:
        session = open_client(endpoint)
    except zenoh.ZError:
        return False
    return token_stands(session, service, prefix)


def main(arguments: list[str]) -> None:
    """End the process: 0 if the service is alive, 1 if it is not, 2 if no service is named."""
    if len(arguments) != 1:
        sys.stderr.write("usage: python -m mazebot.common.bus.health SERVICE\n")
        os._exit(2)
    # A router that hangs accepts the connection and never responds.
    watchdog = threading.Timer(PATIENCE_S, os._exit, (1,))
    watchdog.daemon = True
    watchdog.start()
    endpoint = os.environ.get("MAZEBOT_BUS_CONNECT") or "tcp/127.0.0.1:7447"
    alive = is_alive(endpoint, arguments[0], os.environ.get("MAZEBOT_BUS_PREFIX", ""))
    # The kernel closes everything that is left.
    os._exit(0 if alive else 1)


if __name__ == "__main__":
    main(sys.argv[1:])

"""Health check of a service by its liveliness token:
`python -m mazebot.common.bus.health physics`.

Docker runs it in every container every few seconds, so it imports little but Zenoh.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from pathlib import Path

import zenoh

from mazebot.common.files.key_file import Key, KeyFileError, read_key, sign_in
from mazebot.common.messages.own_keys import RMW_ZENOH, own_root

ALIVE_KEY = "mazebot/alive/"
"""Prefix of a service's name; the same as in `bus.py`, which is slow to load."""
PATIENCE_S = 2.5


def open_client(endpoint: str, key: Key | None = None) -> zenoh.Session:
    """A client session, signed in with a key. Raises ZError where no router accepts it at the
    endpoint.
    """
    settings = zenoh.Config()
    options: dict[str, object] = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 1000,
        "connect/exit_on_failure": True,
        "scouting/multicast/enabled": False,
    }
    if key:
        options |= sign_in(key, endpoint)
    for name, value in options.items():
        settings.insert_json5(name, json.dumps(value))
    return zenoh.open(settings)


def key_of_environment() -> Key | None:
    """The key that the environment names. Raises KeyFileError."""
    path = os.environ.get("MAZEBOT_BUS_KEY_FILE")
    return read_key(Path(path)) if path else None


def root_of_environment() -> str:
    """The beginning of the stack's own keys, by the environment."""
    domain = os.environ.get("MAZEBOT_BUS_DOMAIN_ID") or os.environ.get("ROS_DOMAIN_ID") or "0"
    names = [name for name in os.environ.get("MAZEBOT_BUS_PREFIX", "").split("/") if name]
    return own_root(
        os.environ.get("MAZEBOT_BUS_WIRE") or RMW_ZENOH,
        int(domain) if domain.isdecimal() else 0,
        "".join(f"{name}/" for name in names),
    )


def token_stands(
    session: zenoh.Session, service: str, root: str = own_root(RMW_ZENOH, 0, "")
) -> bool:
    """Whether the router knows the service's token; the stack's own keys begin with `root`."""
    replies = session.liveliness().get(f"{root}{ALIVE_KEY}{service}/*", timeout=1.0)
    return any(reply.ok is not None for reply in replies)


def is_alive(endpoint: str, service: str, root: str = own_root(RMW_ZENOH, 0, "")) -> bool:
    """Whether a router responds at `endpoint` and knows the service's token. It is asked with the
    key that the environment names.
    """
    try:
        session = open_client(endpoint, key_of_environment())
    except (zenoh.ZError, KeyFileError):
        return False
    return token_stands(session, service, root)


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
    alive = is_alive(endpoint, arguments[0], root_of_environment())
    # The kernel closes everything that is left.
    os._exit(0 if alive else 1)


if __name__ == "__main__":
    main(sys.argv[1:])

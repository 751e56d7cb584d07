"""The Zenoh router, to which every service connects."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path

import zenoh

from mazebot.common.bus.liveliness import alive_key
from mazebot.common.bus.session import close_links_at_once
from mazebot.common.config import ConfigError
from mazebot.router.config import RouterConfig

SETTINGS_FILE = Path(__file__).with_name("router.json5")
RECEIVING_THREADS = 8
"""Each thread forwards the messages of one connection; Zenoh's default of two is soon blocked by
slow readers.
"""


class Router:
    """An open router; it works in its own threads until it is closed."""

    def __init__(self, config: RouterConfig, prefix: str = "") -> None:
        """Open it, and declare its liveliness token. Port 0 means any free one.

        Raises ConfigError where it cannot listen.
        """
        # Read when the first session of a process is opened.
        os.environ["ZENOH_RUNTIME"] = f"(rx: (worker_threads: {RECEIVING_THREADS}))"
        settings = zenoh.Config.from_file(SETTINGS_FILE)
        self.endpoint = _with_port(config.listen)
        """What it listens on."""
        settings.insert_json5("listen/endpoints", json.dumps([self.endpoint]))
        settings.insert_json5("listen/exit_on_failure", "true")
        try:
            self._session = zenoh.open(settings)
        except zenoh.ZError as error:
            reason = "address in use" if "Address already in use" in str(error) else "cannot listen"
            raise ConfigError(f"router: listen: {config.listen}: {reason}") from error
        close_links_at_once(self._session)
        key = alive_key("router", str(self._session.zid()), prefix)
        self._token = self._session.liveliness().declare_token(key)

    @property
    def session(self) -> zenoh.Session:
        """The router's own session, for what runs in its process."""
        return self._session

    def close(self) -> None:
        """Close every connection."""
        self._token.undeclare()  # type: ignore[no-untyped-call]
        self._session.close()  # type: ignore[no-untyped-call]


def _with_port(listen: str) -> str:
    """The endpoint with a free port in place of port 0: Zenoh does not tell which one it takes."""
    protocol, _, address = listen.partition("/")
    host, _, port = address.rpartition(":")
    if protocol != "tcp" or port != "0":
        return listen
    with socket.socket() as probe:
        probe.bind(("", 0))
        return f"{protocol}/{host}:{probe.getsockname()[1]}"

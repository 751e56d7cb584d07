"""The Zenoh router: the one process that every service connects to."""

from __future__ import annotations

import json
import os

import zenoh

from services.common.bus.bus import alive_key, close_links_at_once
from services.common.config import ConfigError
from services.common.root import ROOT
from services.router.config import RouterConfig

SETTINGS_FILE = ROOT / "docker" / "router.json5"
RECEIVING_THREADS = 8
"""Each one forwards what one connection sends; Zenoh's own two are soon all held up by readers that
have to be waited for.
"""


class Router:
    """A router that is open; it works in threads of its own until it is closed."""

    def __init__(self, config: RouterConfig, prefix: str = "") -> None:
        """Open it, and declare the token by which it is known to be alive.

        Raises ConfigError where it cannot listen.
        """
        # Read when the first session of a process is opened.
        os.environ["ZENOH_RUNTIME"] = f"(rx: (worker_threads: {RECEIVING_THREADS}))"
        settings = zenoh.Config.from_file(SETTINGS_FILE)
        settings.insert_json5("listen/endpoints", json.dumps([config.listen]))
        settings.insert_json5("listen/exit_on_failure", "true")
        try:
            self._session = zenoh.open(settings)
        except zenoh.ZError as error:
            reason = "address in use" if "Address already in use" in str(error) else "cannot listen"
            raise ConfigError(f"router: listen: {config.listen}: {reason}") from error
        close_links_at_once(self._session)
        key = alive_key("router", str(self._session.zid()), prefix)
        self._token = self._session.liveliness().declare_token(key)

    def close(self) -> None:
        """Cut every connection."""
        self._token.undeclare()  # type: ignore[no-untyped-call]
        self._session.close()  # type: ignore[no-untyped-call]

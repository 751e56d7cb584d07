"""The router that a command opens on this machine, for the user's tools beside it."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from mazebot.cli.parsing.options import ROUTER
from mazebot.common.config import ConfigError

if TYPE_CHECKING:
    from mazebot.common.client.run_on_bus import RunOnBus
    from mazebot.common.messages.keys import Keys
    from mazebot.common.node.node import Node
    from mazebot.embedded.watched_transport import WatchedTransport

_CONNECT, _PORT = "MAZEBOT_BUS_CONNECT", "MAZEBOT_ROUTER_PORT"
_HERE = re.compile(r"tcp/(127\.0\.0\.1|localhost):(\d{1,5})")


def router_port(given: int | None) -> int:
    """The port of a router on this machine: the one given, or where the user's tools look for one.

    Raises ConfigError where the environment names none.
    """
    if given is not None:
        return given
    for name, pattern in ((_PORT, re.compile(r"()(\d{1,5})")), (_CONNECT, _HERE)):
        value = os.environ.get(name)
        if not value:
            continue
        found = pattern.fullmatch(value)
        if found is None or not int(found[2]) < 2**16:
            must = "a port" if name == _PORT else f"an endpoint of this machine, such as {ROUTER}"
            raise ConfigError(f"{name}: {value!r:.80}: must be {must}, or give --router-port")
        return int(found[2])
    return int(ROUTER.rpartition(":")[2])


def router_address(port: int) -> str:
    """The endpoint of a router on this machine."""
    return f"tcp/127.0.0.1:{port}"


def how_to_find(endpoint: str) -> str:
    """What the user's tools need to find a router there, after the endpoint in a line; empty: with
    the environment of this process they find it.
    """
    found = (os.environ.get(_CONNECT) or ROUTER).replace("localhost", "127.0.0.1")
    return "" if found == endpoint else f": export {_CONNECT}={endpoint}"


def taken(endpoint: str) -> ConfigError:
    """The error where something else listens at an endpoint."""
    return ConfigError(
        f"router: {endpoint}: address in use, perhaps by another stack: end it (docker compose "
        "down, mazebot down, Ctrl-C of a demo), or choose another port (--router-port)"
    )


class OwnRouter:
    """The router of a run in this process. See BusBeside."""

    def __init__(self, port: int, keys: Keys | None = None) -> None:
        """Listen on a port; 0: any free one. Raises ConfigError where it is taken."""
        # Zenoh takes long to import.
        from mazebot.common.messages.keys import DEFAULT_KEYS  # noqa: PLC0415
        from mazebot.router.config import RouterConfig  # noqa: PLC0415
        from mazebot.router.router import Router  # noqa: PLC0415

        self._keys = keys or DEFAULT_KEYS
        config = RouterConfig(listen=router_address(port))
        try:
            self._router = Router(config, self._keys)
        except ConfigError as error:
            raise (taken(config.listen) if "in use" in str(error) else error) from error
        self._run: RunOnBus | None = None

    @property
    def endpoint(self) -> str:
        """Where it listens."""
        return self._router.endpoint

    def carry(self, nodes: Sequence[Node], transport: WatchedTransport) -> None:
        """See BusBeside."""
        from mazebot.common.client.run_on_bus import RunOnBus  # noqa: PLC0415

        self._run = RunOnBus(self._router.session, nodes, transport, self._keys)
        hint = how_to_find(self.endpoint)
        log = logging.getLogger("router")
        log.info("listening on %s, for `mazebot goal` and all others%s", self.endpoint, hint)

    def close(self) -> None:
        """See BusBeside."""
        if self._run is not None:
            self._run.close()
        self._router.close()

"""How the command reaches a running stack."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.common.bus import BusConfig, BusUnavailableError, open_session
from services.common.config import ConfigError

if TYPE_CHECKING:
    import zenoh


def connect_to(endpoint: str) -> zenoh.Session:
    """Open a session with the stack's router.

    Raises ConfigError where there is none.
    """
    try:
        return open_session(BusConfig(connect=endpoint))
    except BusUnavailableError as error:
        raise ConfigError(
            f"{error}; is a stack running? (docker compose up demo-world-enhanced)"
        ) from error

"""Sessions with the Zenoh router."""

from __future__ import annotations

import json
from datetime import datetime
from typing import Any, cast

import zenoh

from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.linger import stop_lingering

WAIT_BEFORE_DROP_US = 10_000
"""As in services/mazebot/router/router.json5."""


class BusUnavailableError(ConnectionError):
    """No router responds at the endpoint."""


def open_session(config: BusConfig, timeout_s: float = 1.0) -> zenoh.Session:
    """Open a client session.

    The timeout is finite, to be called in a loop: an endless one inside Zenoh would block signals.
    Raises BusUnavailableError where no router responds within `timeout_s`.
    """
    settings = zenoh.Config()
    options = {
        "mode": "client",
        "connect/endpoints": [config.connect],
        "connect/timeout_ms": int(timeout_s * 1000),
        "connect/exit_on_failure": True,
        "connect/retry": {
            "period_init_ms": 100,
            "period_max_ms": 300,
            "period_increase_factor": 1.5,
        },
        "scouting/multicast/enabled": False,
        "timestamping/enabled": True,
        # In lockstep slow services are waited for; the end of a process is detected at once anyway.
        "transport/link/tx/lease": round(config.lockstep_timeout_s * 1e3)
        if config.lockstep
        else 2000,
        # Zenoh's default of 1 ms is too short for a busy machine to send its queue.
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": WAIT_BEFORE_DROP_US,
    }
    try:
        for key, value in options.items():
            settings.insert_json5(key, json.dumps(value))
        session = zenoh.open(settings)
    except zenoh.ZError as error:
        raise BusUnavailableError(f"no Zenoh router at {config.connect}") from error
    close_links_at_once(session)
    return session


def close_links_at_once(session: zenoh.Session) -> None:
    """Keep a closing connection from blocking the others, now and after each reconnect."""
    session.info.declare_link_events_listener(
        cast("Any", zenoh.handlers.Callback(lambda _: stop_lingering(), indirect=False)),
        history=True,
    )


def now_of(session: zenoh.Session) -> datetime:
    """The session's current time, with which it stamps messages."""
    return session.new_timestamp().get_time()

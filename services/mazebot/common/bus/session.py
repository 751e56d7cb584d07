"""Sessions with the Zenoh router."""

from __future__ import annotations

import json
import re
from datetime import datetime
from pathlib import Path
from typing import Any, cast

import zenoh

from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.connections import listens, stop_lingering
from mazebot.common.files.key_file import (
    TLS,
    Key,
    KeyFileError,
    operators_key,
    operators_key_here,
    read_key,
    sign_in,
)

WAIT_BEFORE_DROP_US = 10_000
"""As in services/mazebot/router/router.json5."""


TRY_S = 1.0
"""Wall time within which a router that is there lets a session in."""
PATIENCE_S = 5.0
"""Wall time for which a tool waits for a router that listens: on a busy machine it answers late."""


class BusUnavailableError(ConnectionError):
    """No router responds at the endpoint, or it refuses this process; the text is one line."""

    def __init__(self, text: str, listens: bool = False) -> None:
        super().__init__(text)
        self.listens = listens
        """Whether somebody listens there."""


def join(config: BusConfig) -> tuple[zenoh.Session, Key | None]:
    """Open a client session for a tool, which tries it once; return it with the key that it has
    signed in with.

    Without a key in the settings it is the operator's, of this user's stack or, as containers leave
    it, in ./keys; where the router does not want that one, none. Raises BusUnavailableError.
    """
    path = _key_path(config)
    here = operators_key_here(config.connect) if path is None else None
    paths = [path] if here is None else [here, None]
    refusals = []
    for timeout_s in (TRY_S, PATIENCE_S):
        for path in paths:
            try:
                return _open(config, path, timeout_s)
            except BusUnavailableError as error:
                if not error.listens:
                    raise
                refusals.append(error)
    # The key that was found is the one to be told of.
    raise refusals[0]


def open_session(config: BusConfig, timeout_s: float = TRY_S) -> zenoh.Session:
    """Open a client session.

    The timeout is finite, to be called in a loop: an endless one inside Zenoh would block signals.
    Raises BusUnavailableError where no router responds within `timeout_s`, or it refuses the key.
    """
    session, _ = _open(config, _key_path(config), timeout_s)
    return session


def _open(
    config: BusConfig, key_file: Path | None, timeout_s: float
) -> tuple[zenoh.Session, Key | None]:
    key = _read(key_file)
    settings = zenoh.Config()
    options: dict[str, object] = {
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
    if key:
        options |= sign_in(key, config.connect)
    try:
        for name, value in options.items():
            settings.insert_json5(name, json.dumps(value))
        session = zenoh.open(settings)
    except zenoh.ZError as error:
        raise _why_not(config.connect, key_file, key) from error
    close_links_at_once(session)
    return session, key


def key_of(config: BusConfig) -> Key | None:
    """The key with which sessions sign in, if they do. Raises BusUnavailableError where it is no
    key.
    """
    return _read(_key_path(config))


def _read(path: Path | None) -> Key | None:
    """Raises BusUnavailableError."""
    try:
        return read_key(path) if path else None
    except KeyFileError as error:
        raise BusUnavailableError(str(error)) from error


def _key_path(config: BusConfig) -> Path | None:
    return config.key_file or operators_key(config.connect)


def _why_not(endpoint: str, key_file: Path | None, key: Key | None) -> BusUnavailableError:
    """Why no session could be opened; Zenoh itself does not tell."""
    if not _listens(endpoint):
        return BusUnavailableError(f"no Zenoh router at {endpoint}")
    encrypts = endpoint.startswith(TLS)
    if key is None:
        why = (
            "asks for a key: set MAZEBOT_BUS_KEY_FILE, or start this in the clone whose containers "
            "run; see `mazebot keys`"
        )
    elif encrypts and key.certificate is None:
        why = f"asks for a certificate, which the key {key_file} has not"
    elif key.certificate is not None and not encrypts:
        why = f"refuses the key {key_file}, or encrypts: MAZEBOT_BUS_CONNECT={TLS}..."
    else:
        why = f"refuses the key {key_file}"
    return BusUnavailableError(f"the router at {endpoint} does not answer, or {why}", listens=True)


def _listens(endpoint: str) -> bool:
    found = re.fullmatch(r"(?:tcp|tls)/\[?(?P<host>.+?)\]?:(?P<port>\d+)", endpoint)
    return found is not None and listens(found["host"], int(found["port"]))


def close_links_at_once(session: zenoh.Session) -> None:
    """Keep a closing connection from blocking the others, now and after each reconnect."""
    session.info.declare_link_events_listener(
        cast("Any", zenoh.handlers.Callback(lambda _: stop_lingering(), indirect=False)),
        history=True,
    )


def now_of(session: zenoh.Session) -> datetime:
    """The session's current time, with which it stamps messages."""
    return session.new_timestamp().get_time()

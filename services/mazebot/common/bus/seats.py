"""The seats of lockstep: services that take turns, and the turns given to them."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import Any, cast

import zenoh

from mazebot.common.bus.bus import Bus
from mazebot.common.bus.liveliness import service_and_source, watch_tokens
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys

SEAT_PREFIX = "mazebot/seat/"
WAKE_PREFIX = "mazebot/wake/"


class SeatOnBus:
    """A service's seat in lockstep: each turn is given by a query."""

    def __init__(
        self,
        session: zenoh.Session,
        bus: Bus,
        on_turn: Callable[[bytes, Callable[[bytes], None]], None],
        keys: Keys = DEFAULT_KEYS,
    ) -> None:
        """`on_turn` gets each turn and a function to reply to it; it runs on Zenoh's thread."""
        self._session = session
        self._wake_key = keys.own(f"{WAKE_PREFIX}{bus.node_name}/{bus.source}")
        key = keys.own(f"{SEAT_PREFIX}{bus.node_name}/{bus.source}")

        def on_query(asked: zenoh.Query) -> None:
            def respond(data: bytes) -> None:
                with contextlib.suppress(zenoh.ZError), asked:
                    asked.reply(asked.key_expr, data, express=True)

            on_turn(asked.payload.to_bytes() if asked.payload is not None else b"", respond)

        handler = cast("Any", zenoh.handlers.Callback(on_query, indirect=False))
        self._queryable = session.declare_queryable(key, handler, complete=True)
        self._token = session.liveliness().declare_token(key)

    def call(self) -> None:
        """Announce that a message is pending for which the service steps at once."""
        self._session.put(self._wake_key, b"", express=True)


def watch_seats(
    session: zenoh.Session,
    on_seat: Callable[[str, str, bool], None],
    on_wake: Callable[[str, str], None],
    keys: Keys = DEFAULT_KEYS,
) -> list[Any]:
    """Call `on_seat` with each seat's service, source and whether it is alive, and `on_wake` on
    each call; keep a reference to the returned list. The callbacks run on Zenoh's thread: they must
    only store.
    """

    def on_call(sample: zenoh.Sample) -> None:
        on_wake(*service_and_source(sample.key_expr))

    return [
        watch_tokens(session, keys.own(f"{SEAT_PREFIX}*/*"), on_seat),
        session.declare_subscriber(
            keys.own(f"{WAKE_PREFIX}*/*"),
            cast("Any", zenoh.handlers.Callback(on_call, indirect=False)),
        ),
    ]


def give_turn(
    session: zenoh.Session,
    service: str,
    source: str,
    turn: bytes,
    timeout_s: float,
    keys: Keys = DEFAULT_KEYS,
    still_wanted: Callable[[], bool] = lambda: True,
) -> bytes | None:
    """The end of a service's turn; None on timeout, where nobody has that seat, or as soon as
    `still_wanted`, called every 50 ms, returns False.
    """
    ends: list[bytes] = []
    done = threading.Event()

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            ends.append(reply.ok.payload.to_bytes())
        done.set()

    session.get(
        keys.own(f"{SEAT_PREFIX}{service}/{source}"),
        cast("Any", zenoh.handlers.Callback(on_reply, done.set, indirect=False)),
        payload=turn,
        timeout=timeout_s,
        consolidation=zenoh.ConsolidationMode.NONE,
        congestion_control=zenoh.CongestionControl.BLOCK,
        express=True,
    )
    while not done.wait(0.05) and still_wanted():
        pass
    return ends[0] if ends else None

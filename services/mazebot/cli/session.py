"""Connects to a running stack. Zenoh takes long to load, so it is imported only then."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import World

if TYPE_CHECKING:
    import zenoh

    from mazebot.common.messages.topics import Query, Topic

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")


@contextmanager
def connected(endpoint: str) -> Iterator[zenoh.Session]:
    """A session with the stack's router while the context lasts.

    Raises ConfigError where no router responds.
    """
    from mazebot.common.bus.config import BusConfig  # noqa: PLC0415
    from mazebot.common.bus.session import BusUnavailableError, open_session  # noqa: PLC0415

    try:
        session = open_session(BusConfig(connect=endpoint))
    except BusUnavailableError as error:
        raise ConfigError(
            f"{error}; is a stack running? (docker compose up demo-world-enhanced)"
        ) from error
    try:
        yield session
    finally:
        session.close()  # type: ignore[no-untyped-call]


def ask(session: zenoh.Session, query: Query[Q, A], message: Q, timeout_s: float) -> A:
    """The reply to a query. Raises ConfigError where there is none."""
    from mazebot.common.bus import query as bus_query  # noqa: PLC0415
    from mazebot.common.messages.wire import WireError  # noqa: PLC0415

    try:
        return bus_query.ask(session, query, message, timeout_s)
    except (bus_query.QueryError, WireError) as error:
        raise ConfigError(str(error)) from error


def world_that_runs(session: zenoh.Session, timeout_s: float) -> World:
    """The world of the stack. Raises ConfigError where none is received."""
    from mazebot.common.messages.topics import WORLD  # noqa: PLC0415

    return first_message(session, WORLD, timeout_s, "no world")


def first_message(
    session: zenoh.Session, topic: Topic[M], timeout_s: float, missing: str = "no message"
) -> M:
    """The first message on a topic. Raises ConfigError where none is received, or a wrong one."""
    from mazebot.common.bus.subscriber import subscribed  # noqa: PLC0415
    from mazebot.common.messages import wire  # noqa: PLC0415

    come: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    try:
        with subscribed(session, topic, lambda payload, _: come.put(payload)):
            return wire.decode(topic, come.get(timeout=timeout_s))
    except queue.Empty:
        raise ConfigError(f"{topic.name}: {missing} within {timeout_s:g} s") from None
    except wire.WireError as error:
        raise ConfigError(f"{topic.name}: {error}") from error

"""A connection to the robot of a running stack, over Zenoh."""

from __future__ import annotations

import functools
import threading
import time
import uuid
from collections import deque
from typing import TYPE_CHECKING, Any, TypeVar

from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.query import QueryError, ask
from mazebot.common.bus.session import BusUnavailableError, open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.config import ConfigError
from mazebot.common.messages import wire
from mazebot.common.messages.topics import CLOCK, Query, Topic
from mazebot.common.node.node import Envelope

if TYPE_CHECKING:
    import zenoh

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

_MOST_KEPT = 1000


class ZenohConnection:
    """See Connection. Messages are taken in by Zenoh's threads and decoded by the caller's."""

    def __init__(
        self,
        endpoint: str,
        watch: tuple[Topic[Any], ...] = (),
        keep: tuple[Topic[Any], ...] = (),
    ) -> None:
        """Connect to the router at an endpoint such as `tcp/127.0.0.1:7447`.

        Args:
            endpoint: of the stack's router.
            watch: topics for `latest`.
            keep: topics for `taken`.

        Raises ConfigError where no router responds.
        """
        try:
            self._session = open_session(BusConfig(connect=endpoint))
        except BusUnavailableError as error:
            raise ConfigError(
                f"{error}; is a stack running? (docker compose up demo-world-enhanced)"
            ) from error
        self._source = uuid.uuid4().hex
        self._sequence = 0
        self._news = threading.Condition()
        self._latest: dict[str, bytes] = {}
        self._kept: dict[str, deque[bytes]] = {
            topic.name: deque(maxlen=_MOST_KEPT) for topic in keep
        }
        self._publishers: dict[str, Any] = {}
        topics = {topic.name: topic for topic in (CLOCK, *watch, *keep)}
        self._subscriptions = [
            subscribe(self._session, topic, functools.partial(self._take, name))
            for name, topic in topics.items()
        ]

    @property
    def session(self) -> zenoh.Session:
        """The session with the router."""
        return self._session

    def _take(self, name: str, data: bytes, _: Envelope) -> None:
        with self._news:
            self._latest[name] = data
            if name in self._kept:
                self._kept[name].append(data)
                self._news.notify_all()

    def ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """See Connection."""
        try:
            return ask(self._session, query, message, timeout_s)
        except (QueryError, wire.WireError) as error:
            raise ConfigError(str(error)) from error

    def put(self, topic: Topic[M], message: M) -> None:
        """See Connection."""
        try:
            wire.validate(topic, message)
        except wire.WireError as error:
            raise ValueError(f"{topic.name}: {error.reason}") from error
        if topic.name not in self._publishers:
            self._publishers[topic.name] = publish(self._session, topic)
        envelope = Envelope(self._source, self._sequence, self.now_ns(), "")
        self._sequence += 1
        self._publishers[topic.name].put(
            wire.encode(topic, message), attachment=pack_attachment(topic, envelope)
        )

    def latest(self, topic: Topic[M]) -> M | None:
        """See Connection."""
        with self._news:
            data = self._latest.get(topic.name)
        return None if data is None else _decoded(topic, data)

    def taken(self, topic: Topic[M]) -> list[M]:
        """See Connection."""
        with self._news:
            waiting = list(self._kept[topic.name])
            self._kept[topic.name].clear()
        found = (_decoded(topic, data) for data in waiting)
        return [message for message in found if message is not None]

    def let_pass(self, seconds: float) -> None:
        """See Connection."""
        end_ns = self.now_ns() + round(seconds * 1e9)
        # A simulation that stands still must not hold up the caller for ever.
        end_s = time.monotonic() + max(seconds, 0.1)
        with self._news:
            while not any(self._kept.values()):
                left_s = end_s - time.monotonic()
                if left_s <= 0.0 or self._now_ns() >= end_ns:
                    return
                self._news.wait(min(left_s, 0.02))

    def now_ns(self) -> int:
        """See Connection."""
        with self._news:
            return self._now_ns()

    def _now_ns(self) -> int:
        data = self._latest.get(CLOCK.name)
        clock = None if data is None else _decoded(CLOCK, data)
        return 0 if clock is None else clock.clock.sec * 1_000_000_000 + clock.clock.nanosec

    def close(self) -> None:
        """See Connection."""
        for subscription in self._subscriptions:
            subscription.undeclare()
        self._subscriptions.clear()
        self._publishers.clear()
        self._session.close()  # type: ignore[no-untyped-call]


def _decoded(topic: Topic[M], data: bytes) -> M | None:
    """A message; None where it cannot be read."""
    try:
        return wire.decode(topic, data)
    except wire.WireError:
        return None

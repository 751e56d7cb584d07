"""A stack on a Zenoh router, which may start later than the console, end, and start again."""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.query import QueryError, ask
from mazebot.common.bus.session import BusUnavailableError, open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages import wire
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.messages.topics import CLOCK, EDGE, SERVICES, Query, Topic
from mazebot.common.node.node import Envelope
from mazebot.console.live.stack import Receive, StackError

if TYPE_CHECKING:
    import zenoh

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

_LOOK_S = 0.5
"""How often it is looked whether the stack has come or gone, while somebody watches."""
_CONNECT_S = 1.0
_NO_STACK = "no stack is running"


@dataclass(eq=False)
class _Watch:
    topics: tuple[Topic[Any], ...]
    receive: Receive
    subscriptions: list[Any] = field(default_factory=list)


class ZenohStack:
    """See Stack. Connected only while somebody watches; messages are passed on as CDR bytes."""

    how_to_start = "docker compose up demo-world-enhanced"

    def __init__(self, config: BusConfig) -> None:
        self._config = config
        self._lock = threading.RLock()
        self._watches: list[_Watch] = []
        self._session: zenoh.Session | None = None
        self._services: frozenset[str] = frozenset()
        self._source = uuid.uuid4().hex
        self._sequence = 0
        self._publishers: dict[str, Any] = {}
        self._clock = b""
        self._own = _Watch((CLOCK,), self._follow)
        self._changed = threading.Event()
        self._closed = False
        self._keeper = threading.Thread(target=self._keep, name="console stack", daemon=True)
        self._keeper.start()

    def services(self) -> frozenset[str]:
        """See Stack."""
        return self._services

    def now_ns(self) -> int:
        """See Stack."""
        try:
            return ns_from_time(wire.decode(CLOCK, self._clock).clock) if self._clock else 0
        except wire.WireError:
            return 0

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive) -> Callable[[], None]:
        """See Stack."""
        watch = _Watch(tuple(topics), receive)
        with self._lock:
            self._watches.append(watch)
            if self._session is not None:
                self._subscribe(self._session, watch)
        self._changed.set()

        def end() -> None:
            with self._lock:
                if watch in self._watches:
                    self._watches.remove(watch)
                ended, watch.subscriptions = watch.subscriptions, []
                for subscription in ended:
                    subscription.undeclare()
            self._changed.set()

        return end

    def publish(self, topic: Topic[M], message: M) -> None:
        """See Stack."""
        if EDGE not in topic.owners:
            raise StackError(f"{topic.name}: only {' and '.join(topic.owners)} may write it")
        try:
            wire.validate(topic, message)
        except wire.WireError as error:
            raise StackError(f"{topic.name}: {error.reason}") from error
        now_ns = self.now_ns()
        with self._lock:
            if self._session is None or not self._services:
                raise StackError(_NO_STACK)
            envelope = Envelope(self._source, self._sequence, now_ns, "")
            self._sequence += 1
            try:
                if topic.name not in self._publishers:
                    self._publishers[topic.name] = publish(
                        self._session, topic, self._config.prefix
                    )
                self._publishers[topic.name].put(
                    wire.encode(topic, message), attachment=pack_attachment(topic, envelope)
                )
            except Exception as error:
                # Zenoh's own error where the session has just ended.
                raise StackError(_NO_STACK) from error

    def ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """See Stack."""
        session = self._session
        if session is None or not self._services:
            raise StackError(_NO_STACK)
        try:
            return ask(session, query, message, timeout_s, self._config.prefix, start_s=1.0)
        except (QueryError, wire.WireError) as error:
            raise StackError(str(error)) from error
        except Exception as error:
            # Zenoh's own error where the session is closed meanwhile.
            raise StackError(_NO_STACK) from error

    def close(self) -> None:
        """See Stack."""
        self._closed = True
        self._changed.set()
        self._keeper.join()

    def _keep(self) -> None:
        """Open, look after and close the session."""
        while not self._closed:
            if not self._watches:
                self._disconnect()
                self._changed.wait()
            self._changed.clear()
            if self._closed:
                break
            if self._watches:
                self._look()
                self._changed.wait(_LOOK_S)
        self._disconnect()

    def _look(self) -> None:
        session = self._session
        if session is None:
            session = self._connect()
            if session is None:
                return
        # The router has a token, too.
        found = frozenset(alive(session, self._config.prefix, _CONNECT_S)).intersection(SERVICES)
        gone = bool(self._services) and not found
        self._services = found
        if gone:
            # What a stack that starts later has latched comes with new subscriptions.
            self._disconnect()

    def _connect(self) -> zenoh.Session | None:
        try:
            session = open_session(self._config, _CONNECT_S)
        except BusUnavailableError:
            return None
        with self._lock:
            self._session = session
            for watch in (self._own, *self._watches):
                self._subscribe(session, watch)
        return session

    def _follow(self, _: Topic[Any], data: bytes, __: Envelope) -> None:
        self._clock = data

    def _subscribe(self, session: zenoh.Session, watch: _Watch) -> None:
        for topic in watch.topics:

            def receive(data: bytes, envelope: Envelope, topic: Topic[Any] = topic) -> None:
                watch.receive(topic, data, envelope)

            watch.subscriptions.append(subscribe(session, topic, receive, self._config.prefix))

    def _disconnect(self) -> None:
        with self._lock:
            session, self._session = self._session, None
            self._services = frozenset()
            self._publishers.clear()
            self._clock = b""
            for watch in (self._own, *self._watches):
                watch.subscriptions.clear()
        if session is not None:
            # Closing may hang where the router is lost.
            threading.Thread(target=session.close, name="closing", daemon=True).start()

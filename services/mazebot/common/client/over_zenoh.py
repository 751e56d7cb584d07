"""The robot of a running stack, over Zenoh."""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

import zenoh

from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import GraphNode, alive, graph_name, nodes_anywhere
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.query import NoReplyError, QueryError, ask
from mazebot.common.bus.session import BusUnavailableError, join
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.client.elsewhere import elsewhere
from mazebot.common.client.robot import (
    CLOSED,
    HOW_TO_START,
    NO_STACK,
    Receive,
    Robot,
    RobotError,
    UnreachableError,
    check_request,
    encoded,
    ignore,
)
from mazebot.common.files.key_file import Key
from mazebot.common.messages import wire
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.messages.topics import CLOCK, EDGE, SERVICES, Query, Topic
from mazebot.common.node.node import Envelope
from mazebot.common.settings.load import load

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")


@dataclass(eq=False)
class _Watch:
    topics: tuple[Topic[Any], ...]
    receive: Receive
    subscriptions: list[Any] = field(default_factory=list)

    def end(self) -> None:
        # An advanced subscriber that outlives its session can keep the process from ending:
        # https://github.com/eclipse-zenoh/zenoh-python/issues/624
        while self.subscriptions:
            self.subscriptions.pop().undeclare()


class ZenohRobot(Robot):
    """See Robot. Messages are passed on as CDR bytes, on Zenoh's threads."""

    def __init__(self, router: str | BusConfig, start_s: float = 5.0) -> None:
        """Connect to a stack.

        Args:
            router: its endpoint such as `tcp/127.0.0.1:7447`, with which the other settings are
                those of the environment; or all settings of the bus.
            start_s: wall time for which a query waits for a service that is starting.

        Raises RobotError where no router responds, ConfigError where a setting is wrong.
        """
        config = router
        if isinstance(config, str):
            config = load(BusConfig, "bus", [], {"connect": router})
        try:
            self._session, self._key = join(config)
        except BusUnavailableError as error:
            raise RobotError(f"{error}; is a stack running? ({HOW_TO_START})") from error
        self._config, self.keys, self._start_s = config, config.keys, start_s
        """The keys of the stack."""
        self._graph = GraphNode(self._session, graph_name(EDGE), self.keys)
        self._source, self._sequence = uuid.uuid4().hex, 0
        self._is_closed = False
        self._joining = threading.Lock()
        self._lock = threading.Lock()
        self._publishers: dict[str, Any] = {}
        self._latest: dict[str, bytes] = {}
        self._watches: list[_Watch] = []
        self.watch((CLOCK,))

    def ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """See Robot."""
        self._check_open()
        check_request(query, message)
        try:
            return self._ask(query, message, timeout_s)
        except NoReplyError as error:
            # Without the router, that tells why, or signs in with another key.
            if self._is_connected() or query.owner not in self.alive():
                raise RobotError(f"{error}{self.elsewhere(query.owner)}") from error
        try:
            return self._ask(query, message, timeout_s)
        except NoReplyError as error:
            raise RobotError(str(error)) from error

    def _ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """Raises NoReplyError, or RobotError for another reason."""

        def check() -> None:
            denial = self._denial("QUERY", query.name, self.keys.of_query(query))
            if denial:
                raise QueryError(denial)

        try:
            return ask(self._session, query, message, timeout_s, self.keys, self._start_s, check)
        except NoReplyError:
            raise
        except (QueryError, wire.WireError) as error:
            raise RobotError(str(error)) from error
        except zenoh.ZError as error:
            raise RobotError(CLOSED if self._is_closed else NO_STACK) from error

    def publish(self, topic: Topic[M], message: M) -> None:
        """See Robot."""
        self._check_open()
        data, now_ns = encoded(topic, message), self.now_ns()
        if not self._is_connected():
            # What is put now would go nowhere.
            self.alive()
        try:
            with self._lock:
                envelope = Envelope(self._source, self._sequence, now_ns, "")
                self._sequence += 1
                if topic.name not in self._publishers:
                    self._publishers[topic.name] = self._publisher(topic)
                self._publishers[topic.name].put(data, attachment=pack_attachment(topic, envelope))
        except zenoh.ZError as error:
            raise RobotError(CLOSED if self._is_closed else NO_STACK) from error

    def _publisher(self, topic: Topic[Any]) -> Any:
        """Raises RobotError where the router lets this process not publish the topic."""
        publisher = publish(self._session, topic, self.keys, graph=self._graph)
        # To whom it may not publish, the router tells of no reader. Advanced ones cannot tell.
        plain = isinstance(publisher, zenoh.Publisher)
        if not (plain and cast("Any", publisher.matching_status).matching):
            denial = self._denial("PUT", topic.name, self.keys.of_topic(topic))
            if denial:
                raise RobotError(denial)
        return publisher

    def _denial(self, verb: str, name: str, expression: str) -> str:
        """Why the router lets this process not do something, or an empty text."""
        if self._key is None:
            return ""
        # They load all tables.
        from mazebot.common.access.denial import denial  # noqa: PLC0415
        from mazebot.common.access.grants import Verb  # noqa: PLC0415

        return denial(self._key, Verb[verb], name, expression, self.keys)

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive = ignore) -> Callable[[], None]:
        """See Robot."""
        self._check_open()
        watch = _Watch(tuple(topics), receive)
        self._watches.append(watch)
        self._declare(watch)

        def end() -> None:
            watch.end()
            if watch in self._watches:
                self._watches.remove(watch)

        return end

    def _declare(self, watch: _Watch) -> None:
        def declare(topic: Topic[Any]) -> Any:
            def on_message(data: bytes, envelope: Envelope) -> None:
                self._latest[topic.name] = data
                watch.receive(topic, data, envelope)

            return subscribe(self._session, topic, on_message, self.keys, graph=self._graph)

        watch.subscriptions += [declare(topic) for topic in watch.topics]

    def latest(self, topic: Topic[M]) -> M | None:
        """See Robot."""
        data = self._latest.get(topic.name)
        try:
            return None if data is None else wire.decode(topic, data)
        except wire.WireError:
            return None

    def alive(self) -> Mapping[str, frozenset[str]]:
        """See Robot."""
        self._check_open()
        # The router has a token, too: where there is none, this session has lost it.
        found = alive(self._session, self.keys) or self._alive_anew()
        return {name: found[name] for name in SERVICES if name in found}

    def elsewhere(self, *services: str) -> str:
        """See Robot."""
        return elsewhere(nodes_anywhere(self._session), services, self.keys)

    def _alive_anew(self) -> Mapping[str, frozenset[str]]:
        """What a new session finds. Where the key was replaced, it takes this one's place: Zenoh
        would go on to sign in with the one from before. Raises UnreachableError.
        """
        with self._joining:
            try:
                session, key = join(self._config)
            except BusUnavailableError as error:
                raise UnreachableError(str(error)) from error
            if key != self._key:
                self._replace_session(session, key)
                return alive(session, self.keys)
            try:
                return alive(session, self.keys)
            finally:
                session.close()  # type: ignore[no-untyped-call]

    def _replace_session(self, session: zenoh.Session, key: Key | None) -> None:
        with self._lock:
            before, self._session, self._key = self._session, session, key
            self._graph = GraphNode(session, graph_name(EDGE), self.keys)
            self._publishers.clear()
        for watch in tuple(self._watches):
            watch.end()
            self._declare(watch)
        # It may hang, as the router does not let this session in any more.
        threading.Thread(target=before.close, name="closing", daemon=True).start()

    def _is_connected(self) -> bool:
        """Whether the session has its router; a lost one is sought by Zenoh."""
        return bool(list(cast("Any", self._session.info).routers_zid()))

    def _check_open(self) -> None:
        if self._is_closed:
            raise RobotError(CLOSED)

    def wait(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """See Robot."""
        self._check_open()
        super().wait(seconds, until)

    def now_ns(self) -> int:
        """See Robot."""
        clock = self.latest(CLOCK)
        return 0 if clock is None else ns_from_time(clock.clock)

    def close(self) -> None:
        """See Robot."""
        self._is_closed = True
        while self._watches:
            self._watches.pop().end()
        self._session.close()  # type: ignore[no-untyped-call]

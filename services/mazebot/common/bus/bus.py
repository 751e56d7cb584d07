"""The publishers, subscribers and queryables of one node, as declared in the topic table."""

from __future__ import annotations

import contextlib
import logging
import threading
import uuid
from collections import deque
from collections.abc import Callable, Container
from datetime import UTC, datetime
from typing import Any, TypeVar, cast

import zenoh

from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.liveliness import (
    GraphNode,
    alive,
    alive_key,
    graph_name,
    watch_endpoints,
    watch_sources,
)
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.ros.action_server import ActionServer
from mazebot.common.bus.ros.service_server import ServiceServer
from mazebot.common.bus.session import BusUnavailableError, now_of
from mazebot.common.bus.subscriber import Repeats, subscribe
from mazebot.common.messages import wire
from mazebot.common.messages.keys import DEFAULT_KEYS, Endpoint, Keys
from mazebot.common.messages.topics import (
    BY_NAME,
    SERVICES,
    Delivery,
    Query,
    Topic,
    asked_of,
    kept_by,
    owned_by,
    read_by,
)
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox
from mazebot.common.ros.actions import actions_of
from mazebot.common.ros.table import services_of

M = TypeVar("M")


class Bus:
    """The publishers, subscribers and queryables of one node, as declared in the topic table."""

    def __init__(
        self,
        session: zenoh.Session,
        node: Node,
        inbox: Inbox,
        keys: Keys = DEFAULT_KEYS,
        lossless: bool = False,
        subscribes: bool = True,
    ) -> None:
        """Declare them. `lossless` is for lockstep: no message is dropped for a slow reader.
        Without `subscribes` the inbox gets its messages elsewhere, and from here only queries.
        """
        self._inbox = inbox
        # A run in lockstep ends with the first service that is lost: nothing is kept for it.
        kept = () if lossless else kept_by(node.name)
        self._topics = (*read_by(node.name), *kept) if subscribes else ()
        self._keys = keys
        self._misfits: set[tuple[str, str]] = set()
        self._lossless = lossless
        self._lock = threading.RLock()
        self._extras: list[Callable[[zenoh.Session], Any]] = []
        self._announced = False
        self._closed = False
        self.node_name = node.name
        self.source = uuid.uuid4().hex
        self._alive_key = alive_key(node.name, self.source, keys)
        self._latched: dict[str, deque[tuple[bytes, bytes]]] = {
            topic.name: deque(maxlen=topic.depth)
            for topic in owned_by(node.name)
            if topic.delivery is Delivery.LATCHED
        }
        self._outbox: Outbox | None = None
        self._repeats = Repeats()
        self._node = node
        self._opened_at = now_of(session)
        # On the plain wire they have the keys of queries.
        self._actions = [
            ActionServer(action, node, inbox, keys, self._now_ns)
            for action in (actions_of(node.name) if keys.is_ros else ())
        ]
        self._declare(session)

    def _declare(self, session: zenoh.Session) -> None:
        self._session = session
        self.graph = GraphNode(session, graph_name(self.node_name), self._keys)
        """Its place in ROS 2's graph, on the current session."""
        self._subscribers = [
            subscribe(
                session,
                topic,
                self._receiver(topic, session),
                self._keys,
                self._rejecter(topic),
                self._receives_from,
                self.graph,
            )
            for topic in self._topics
        ]
        self._publishers: dict[str, Any] = {
            topic.name: publish(session, topic, self._keys, self._lossless, self.graph)
            for topic in owned_by(self.node_name)
        }
        self._queryables = [
            session.declare_queryable(
                self._keys.of_query(query),
                cast("Any", zenoh.handlers.Callback(self._asker(query), indirect=False)),
            )
            for query in asked_of(self.node_name)
        ]
        # On the plain wire a service has the key of the query of its name.
        self._services = (
            ServiceServer(
                session, self._node, self._inbox, self._keys, self.graph,
                services_of(self.node_name),
            )
            if self._keys.is_ros
            else None
        )  # fmt: skip
        self._action_parts = [each.declare(session, self.graph) for each in self._actions]
        self._kept = [declare(session) for declare in self._extras]
        self._token: zenoh.LivelinessToken | None = None

    def _receives_from(self) -> datetime:
        from_s = self._node.hears_from_s
        return self._opened_at if from_s is None else datetime.fromtimestamp(from_s, UTC)

    def keep(self, declare: Callable[[zenoh.Session], Any]) -> None:
        """Make an additional declaration, and repeat it on each new session."""
        with self._lock:
            self._extras.append(declare)
            self._kept.append(declare(self._session))

    def watch_sources(self) -> None:
        """Keep the inbox informed of which message sources leave, and which are back: services, and
        publishers in ROS 2's graph.
        """

        def declare(session: zenoh.Session) -> Any:
            def on_change(source: str, is_there: bool) -> None:
                if session is self._session:
                    (self._inbox.come_back if is_there else self._inbox.leave)(source)

            def on_publisher(endpoint: Endpoint, is_there: bool) -> None:
                on_change(endpoint.gid, is_there)
                if is_there:
                    self._warn_of_misfit(endpoint)

            watched = [watch_sources(session, on_change, self._keys)]
            if self._keys.is_ros:
                watched.append(
                    watch_endpoints(session, self._keys.publisher_tokens, on_publisher, self._keys)
                )
            return watched

        self.keep(declare)

    def _warn_of_misfit(self, endpoint: Endpoint) -> None:
        """Log once that a publisher has another type than the topic that this node reads."""
        topic = self._keys.topic_with(endpoint)
        if topic is None or topic not in self._topics:
            return
        misfit = endpoint.misfit(topic)
        if misfit and (endpoint.node, misfit) not in self._misfits:
            self._misfits.add((endpoint.node, misfit))
            logging.getLogger(self.node_name).warning(
                "%s of %s is not received: %s", topic.name, endpoint.node, misfit
            )

    def announce(self) -> None:
        """Declare the liveliness token: this node now accepts messages."""
        with self._lock:
            self._announced = True
            self._token = self._session.liveliness().declare_token(self._alive_key)

    def move_to(self, session: zenoh.Session) -> None:
        """Switch to another session, and close the current one.

        Latched messages are published again: the cache for late readers is lost with the old
        session. Raises BusUnavailableError where the new one has ended already.
        """
        with self._lock:
            # Closing may hang if the router is lost; messages still received there are ignored.
            threading.Thread(target=self._session.close, name="closing", daemon=True).start()
            try:
                self._declare(session)
                for name, messages in self._latched.items():
                    for payload, attachment in messages:
                        self._publishers[name].put(payload, attachment=attachment)
                if self._announced:
                    self.announce()
            except zenoh.ZError as error:
                raise BusUnavailableError(f"lost the router again: {error}") from error

    def send(self, topic: Topic[object], message: object, envelope: Envelope) -> None:
        """Publish a message."""
        payload, attachment = wire.encode(topic, message), pack_attachment(topic, envelope)
        with self._lock:
            if topic.name in self._latched:
                self._latched[topic.name].append((payload, attachment))
            self._publishers[topic.name].put(payload, attachment=attachment)
            for action in self._actions:
                action.observe(topic, message)

    def outbox(self, node: Node) -> Outbox:
        """The node's outbox on this bus."""
        self._outbox = Outbox(node, self.send, self.source)
        return self._outbox

    def _now_ns(self) -> int:
        """The simulation's time as of the node's latest step."""
        return 0 if self._outbox is None else self._outbox.now_ns

    def matched(self, among: Container[str]) -> bool:
        """Whether each publisher with a reader `among` these services matches a reader. Advanced
        publishers, which cache messages for late readers, cannot tell and are not checked.
        """
        with self._lock:
            return all(
                cast("Any", publisher.matching_status).matching
                for name, publisher in self._publishers.items()
                if isinstance(publisher, zenoh.Publisher)
                and any(reader in among for reader in BY_NAME[name].readers)
            )

    def has_reader(self, topic: Topic[M]) -> bool:
        """Whether a message would be received or cached. Advanced publishers, which cache messages
        for late readers, cannot tell: for them it is always so.
        """
        publisher = self._publishers[topic.name]
        if not isinstance(publisher, zenoh.Publisher):
            return True
        return bool(cast("Any", publisher.matching_status).matching)

    def is_mute(self) -> bool:
        """Whether a publisher matches no reader although one is alive, or no router is there: then
        its messages are lost. This queries the router, and may block until it replies.
        """
        try:
            # A session that its router refuses may go on believing that it has readers.
            if not list(cast("Any", self._session.info).routers_zid()):
                return not self._closed
            if self.matched(SERVICES):
                return False
            return not self.matched(alive(self._session, self._keys).keys() - {self.node_name})
        except zenoh.ZError:
            # The session has ended, by `close` or on error.
            return not self._closed

    def _receiver(
        self, topic: Topic[M], session: zenoh.Session
    ) -> Callable[[bytes, Envelope], None]:
        def receive(payload: bytes, envelope: Envelope) -> None:
            if session is not self._session or self._repeats.is_repeated(topic, envelope):
                return
            self._inbox.deliver(topic, payload, envelope)

        return receive

    def _rejecter(self, topic: Topic[M]) -> Callable[[str], None]:
        return lambda reason: self._inbox.reject(topic, reason)

    def _asker(self, query: Query[Any, Any]) -> Callable[[zenoh.Query], None]:
        def ask(asked: zenoh.Query) -> None:
            def respond(answer: Any) -> None:
                with contextlib.suppress(zenoh.ZError), asked:
                    asked.reply(asked.key_expr, wire.encode_json(answer))

            try:
                data = asked.payload.to_bytes() if asked.payload is not None else b""
                message = wire.decode_json(query.request, data)
            except wire.WireError as error:
                with asked:
                    asked.reply_err(f"{query.name}: {error}")
                return
            if not self._inbox.ask(query, message, respond):
                with asked:
                    asked.reply_err(f"{query.name}: {self.node_name} has too many pending requests")

        return ask

    def withdraw(self) -> None:
        """Withdraw the token: this node accepts no more messages."""
        with self._lock:
            self._closed = True
            if self._token is not None:
                self._token.undeclare()  # type: ignore[no-untyped-call]
                self._token = None
            self.graph.close()

    def close(self) -> None:
        """Withdraw the token, then close the session with all its declarations."""
        with self._lock:
            self.withdraw()
            self._session.close()  # type: ignore[no-untyped-call]

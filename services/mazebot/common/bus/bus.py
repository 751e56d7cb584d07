"""The Zenoh session of one process: publishers, subscribers and queries of a node."""

from __future__ import annotations

import contextlib
import json
import struct
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Container, Iterator
from datetime import UTC, datetime
from typing import Any, TypeVar, cast

import zenoh
from pydantic import Field, field_validator

from mazebot.common.bus.linger import stop_lingering
from mazebot.common.config import ServiceConfig
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.documents import MIN_SPEED, Document
from mazebot.common.messages.topics import (
    BY_NAME,
    CLOCK,
    CMD_VEL,
    SERVICES,
    Delivery,
    Query,
    Topic,
    asked_of,
    owned_by,
    read_by,
)
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

LOSSLESS_PRIORITY = zenoh.Priority.INTERACTIVE_HIGH
"""As in services/mazebot/router/router.json5."""
_NO_ENVELOPE = Envelope("", 0, 0, "")

ALIVE_PREFIX = "mazebot/alive/"
SEAT_PREFIX = "mazebot/seat/"
WAKE_PREFIX = "mazebot/wake/"
WAIT_BEFORE_DROP_US = 10_000
"""As in services/mazebot/router/router.json5."""

RESENT = 100
"""Messages of an EVERY topic that a publisher caches for readers that have missed them."""
HEARTBEAT_S = 1.0
"""Period of sending the last sequence number, by which a reader detects that it missed messages."""

# rmw_zenoh's attachment (sequence number, source time, gid with its length), followed by the
# world's hash and the topic's name.
_ATTACHMENT = struct.Struct("<qqB16s16s")


PACES = {"real_time": 1.0, "fast": 0.0, "lockstep": 0.0}
"""Simulated seconds a second; 0: as fast as possible."""
MAX_SPEED = 1000.0


class BusConfig(ServiceConfig):
    """The connection to the other services."""

    connect: str = Field("tcp/127.0.0.1:7447", description="Zenoh endpoint of the router")
    prefix: str = Field("", description="prefix of every key, to run several stacks on one router")
    pace: str = Field(
        "real_time",
        description="real_time; simulated seconds a second, as 0.5; fast: as fast as possible; "
        "lockstep: services step in turn, and a run is repeatable; the same for all services",
    )
    lockstep_timeout_s: float = Field(
        10.0, gt=0.0, le=15.0, description="wall time within which a service must end its turn"
    )

    @field_validator("pace")
    @classmethod
    def _is_a_pace(cls, pace: str) -> str:
        if pace in PACES:
            return pace
        try:
            speed = float(pace)
        except ValueError:
            speed = -1.0
        if not MIN_SPEED <= speed <= MAX_SPEED:
            raise ValueError(
                f"must be {', '.join(PACES)}, or a factor from {MIN_SPEED:g} to {MAX_SPEED:g}"
            )
        return pace

    @property
    def lockstep(self) -> bool:
        """Whether the services run in lockstep."""
        return self.pace == "lockstep"

    @property
    def speed(self) -> float:
        """Initial speed in simulated seconds a second; 0: as fast as possible."""
        return PACES[self.pace] if self.pace in PACES else float(self.pace)


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


def pack_attachment(topic: Topic[M], envelope: Envelope) -> bytes:
    """The attachment of a message of a topic."""
    fixed = _ATTACHMENT.pack(
        envelope.sequence,
        envelope.sent_ns,
        16,
        bytes.fromhex(envelope.source),
        envelope.world_hash.encode("ascii"),
    )
    return fixed + topic.name.encode()


def unpack_attachment(topic: Topic[M], data: bytes) -> Envelope:
    """The envelope in the attachment of a message received on a topic.

    Raises ValueError where it is invalid, or names another topic: after a reconnect Zenoh may
    deliver a message under a wrong key.
    """
    fixed, name = data[: _ATTACHMENT.size], data[_ATTACHMENT.size :]
    try:
        sequence, sent_ns, length, source, world = _ATTACHMENT.unpack(fixed)
        world_hash = world.rstrip(b"\0").decode("ascii")
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError("attachment of another kind") from error
    if length != 16 or sequence < 0 or not name:
        raise ValueError("attachment of another kind")
    if name != topic.name.encode():
        raise ValueError("of another topic")
    return Envelope(source.hex(), sequence, sent_ns, world_hash)


class Bus:
    """The publishers, subscribers and queryables of one node, as declared in the topic table."""

    def __init__(
        self,
        session: zenoh.Session,
        node: Node,
        inbox: Inbox,
        prefix: str = "",
        lossless: bool = False,
    ) -> None:
        """Declare them. `lossless` is for lockstep: no message is dropped for a slow reader."""
        self._inbox = inbox
        self._prefix = prefix
        self._lossless = lossless
        self._lock = threading.RLock()
        self._extras: list[Callable[[zenoh.Session], Any]] = []
        self._announced = False
        self._closed = False
        self.node_name = node.name
        self.source = uuid.uuid4().hex
        self._alive_key = alive_key(node.name, self.source, prefix)
        self._latched: dict[str, deque[tuple[bytes, bytes]]] = {
            topic.name: deque(maxlen=topic.depth)
            for topic in owned_by(node.name)
            if topic.delivery is Delivery.LATCHED
        }
        self._heard: dict[tuple[str, str], int] = {}
        self._node = node
        self._begun = now_of(session)
        self._declare(session)

    def _declare(self, session: zenoh.Session) -> None:
        self._session = session
        self._subscribers = [
            subscribe(
                session,
                topic,
                self._receiver(topic, session),
                self._prefix,
                self._rejecter(topic),
                self._hears_from,
            )
            for topic in read_by(self.node_name)
        ]
        self._publishers: dict[str, Any] = {
            topic.name: publish(session, topic, self._prefix, self._lossless)
            for topic in owned_by(self.node_name)
        }
        self._queryables = [
            session.declare_queryable(
                wire.key_from_topic(query, self._prefix),
                cast("Any", zenoh.handlers.Callback(self._asker(query), indirect=False)),
            )
            for query in asked_of(self.node_name)
        ]
        self._kept = [declare(session) for declare in self._extras]
        self._token: zenoh.LivelinessToken | None = None

    def _hears_from(self) -> datetime:
        from_s = self._node.hears_from_s
        return self._begun if from_s is None else datetime.fromtimestamp(from_s, UTC)

    def keep(self, declare: Callable[[zenoh.Session], Any]) -> None:
        """Make an additional declaration, and repeat it on each new session."""
        with self._lock:
            self._extras.append(declare)
            self._kept.append(declare(self._session))

    def watch_sources(self) -> None:
        """Keep the inbox informed of which message sources leave, and which are back."""

        def declare(session: zenoh.Session) -> Any:
            def on_change(source: str, is_there: bool) -> None:
                if session is self._session:
                    (self._inbox.come_back if is_there else self._inbox.leave)(source)

            return watch_sources(session, on_change, self._prefix)

        self.keep(declare)

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
                raise BusUnavailableError("the router was lost again") from error

    def send(self, topic: Topic[object], message: object, envelope: Envelope) -> None:
        """Publish a message."""
        payload, attachment = wire.encode(topic, message), pack_attachment(topic, envelope)
        with self._lock:
            if topic.name in self._latched:
                self._latched[topic.name].append((payload, attachment))
            self._publishers[topic.name].put(payload, attachment=attachment)

    def outbox(self, node: Node) -> Outbox:
        """The node's outbox on this bus."""
        return Outbox(node, self.send, self.source)

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

    def is_mute(self) -> bool:
        """Whether a publisher matches no reader although one is alive: then its messages are lost.
        This queries the router, and may block until it replies.
        """
        try:
            if self.matched(SERVICES):
                return False
            return not self.matched(alive(self._session, self._prefix) - {self.node_name})
        except zenoh.ZError:
            # The session has ended, by `close` or on error.
            return not self._closed

    def _receiver(
        self, topic: Topic[M], session: zenoh.Session
    ) -> Callable[[bytes, Envelope], None]:
        def receive(payload: bytes, envelope: Envelope) -> None:
            if session is not self._session or self._is_repeated(topic, envelope):
                return
            self._inbox.deliver(topic, payload, envelope)

        return receive

    def _is_repeated(self, topic: Topic[M], envelope: Envelope) -> bool:
        """Whether a latched message is a duplicate: it is sent again when its publisher or a reader
        opens a new session.
        """
        if topic.delivery is not Delivery.LATCHED or not envelope.source:
            return False
        key = topic.name, envelope.source
        repeated = envelope.sequence <= self._heard.get(key, -1)
        if not repeated:
            self._heard[key] = envelope.sequence
        return repeated

    def _rejecter(self, topic: Topic[M]) -> Callable[[str], None]:
        return lambda reason: self._inbox.reject(topic, reason)

    def _asker(self, query: Query[Any, Any]) -> Callable[[zenoh.Query], None]:
        def ask(asked: zenoh.Query) -> None:
            def respond(answer: Any) -> None:
                with contextlib.suppress(zenoh.ZError), asked:
                    asked.reply(asked.key_expr, wire.encode_document(answer))

            try:
                data = asked.payload.to_bytes() if asked.payload is not None else b""
                message = wire.decode_document(query.request, data)
            except wire.WireError as error:
                with asked:
                    asked.reply_err(f"{query.name}: {error}")
                return
            if not self._inbox.ask(query, message, respond):
                with asked:
                    asked.reply_err(f"{query.name}: {self.node_name} has too many requests")

        return ask

    def close(self) -> None:
        """Withdraw the token, then close the session with all its declarations."""
        with self._lock:
            self._closed = True
            if self._token is not None:
                self._token.undeclare()  # type: ignore[no-untyped-call]
            self._session.close()  # type: ignore[no-untyped-call]


def alive_key(service: str, source: str, prefix: str = "") -> str:
    """The key of a service's liveliness token, which names the service and its message source."""
    return f"{prefix}{ALIVE_PREFIX}{service}/{source}"


def service_and_source(key: object) -> tuple[str, str]:
    """The service and the source at the end of a token's or a seat's key."""
    service, _, source = str(key).rpartition("/")
    return service.rsplit("/", 1)[-1], source


def _ignore(_: str) -> None:
    pass


def subscribe(
    session: zenoh.Session,
    topic: Topic[M],
    receive: Callable[[bytes, Envelope], None],
    prefix: str = "",
    reject: Callable[[str], None] = _ignore,
    since: Callable[[], datetime] | None = None,
) -> Any:
    """Subscribe with the topic's delivery; keep a reference to the returned object.

    Messages of EVERY topics that were sent before `since` (None: now) are ignored: a service that
    has just started must not act on an old goal.

    `receive` gets each message, with an empty envelope if the sender attached none, as hand-written
    scripts do; `reject` gets a short reason for each message with an invalid attachment. Both run
    on Zenoh's thread: they must only store.
    """
    begin = now_of(session)
    since = since or (lambda: begin)

    def on_sample(sample: zenoh.Sample) -> None:
        envelope = _NO_ENVELOPE
        if sample.attachment is not None:
            if topic.delivery is Delivery.EVERY and _was_sent_before(since(), sample):
                return
            try:
                envelope = unpack_attachment(topic, sample.attachment.to_bytes())
            except ValueError as error:
                reject(str(error))
                return
        receive(sample.payload.to_bytes(), envelope)

    key = wire.key_from_topic(topic, prefix)
    handler = cast("Any", zenoh.handlers.Callback(on_sample, indirect=False))
    if topic.delivery is Delivery.LATEST:
        return session.declare_subscriber(key, handler)
    latched = topic.delivery is Delivery.LATCHED
    return zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        handler,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=topic.depth)
        if latched
        else None,
        recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )


def now_of(session: zenoh.Session) -> datetime:
    """The session's current time, with which it stamps messages."""
    return session.new_timestamp().get_time()


def _was_sent_before(begin: datetime, sample: zenoh.Sample) -> bool:
    stamp = sample.timestamp
    return stamp is not None and stamp.get_time() < begin


def publish(
    session: zenoh.Session, topic: Topic[M], prefix: str = "", lossless: bool = False
) -> Any:
    """Declare a publisher with the topic's delivery, or one that never drops (`lossless`).

    Reliable messages block until the router has them. The router itself drops messages for slow
    readers; they are sent again as far as they are cached here. Lossless messages block in the
    router, too; services/mazebot/router/router.json5 recognises them by their priority.
    """
    key = wire.key_from_topic(topic, prefix)
    encoding = zenoh.Encoding.APPLICATION_CDR.with_schema(wire.type_name(topic))
    latest, latched = (topic.delivery is kind for kind in (Delivery.LATEST, Delivery.LATCHED))
    control = zenoh.CongestionControl
    priority = LOSSLESS_PRIORITY if lossless else _priority(topic)
    if latest or (lossless and not latched):
        return session.declare_publisher(
            key,
            encoding=encoding,
            congestion_control=control.BLOCK if lossless else control.DROP,
            express=lossless or topic.name in _AT_ONCE,
            priority=priority,
        )
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        encoding=encoding,
        congestion_control=control.BLOCK,
        priority=priority,
        cache=zenoh.ext.CacheConfig(
            max_samples=topic.depth if latched else RESENT,
            # A reader that is too slow for the replies would block all messages from here; it
            # detects dropped ones at the next heartbeat, and requests them again.
            replies_config=zenoh.ext.RepliesConfig(
                congestion_control=control.BLOCK if lossless or topic.large else control.DROP
            ),
        ),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(
            heartbeat=HEARTBEAT_S, sporadic_heartbeat=None
        ),
        publisher_detection=latched,
    )


_AT_ONCE = {CLOCK.name, CMD_VEL.name}
"""Express topics: they flush the batch. The clock is the last message of each instant; to send each
message by itself costs sender, router and readers several times as much.
"""


def _priority(topic: Topic[M]) -> zenoh.Priority:
    """Each priority has its own queue: small messages never wait behind an image."""
    if topic.name == CMD_VEL.name:
        return zenoh.Priority.REAL_TIME
    return zenoh.Priority.DATA_LOW if topic.type is msg.Image else zenoh.Priority.DATA


class SeatOnBus:
    """A service's seat in lockstep: each turn is given by a query."""

    def __init__(
        self,
        session: zenoh.Session,
        bus: Bus,
        on_turn: Callable[[bytes, Callable[[bytes], None]], None],
        prefix: str = "",
    ) -> None:
        """`on_turn` gets each turn and a function to reply to it; it runs on Zenoh's thread."""
        self._session = session
        self._wake_key = f"{prefix}{WAKE_PREFIX}{bus.node_name}/{bus.source}"
        key = f"{prefix}{SEAT_PREFIX}{bus.node_name}/{bus.source}"

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
    prefix: str = "",
) -> list[Any]:
    """Call `on_seat` with each seat's service, source and whether it is alive, and `on_wake` on
    each call; keep a reference to the returned list. The callbacks run on Zenoh's thread: they must
    only store.
    """

    def on_call(sample: zenoh.Sample) -> None:
        on_wake(*service_and_source(sample.key_expr))

    return [
        _watch_tokens(session, f"{prefix}{SEAT_PREFIX}*/*", on_seat),
        session.declare_subscriber(
            f"{prefix}{WAKE_PREFIX}*/*",
            cast("Any", zenoh.handlers.Callback(on_call, indirect=False)),
        ),
    ]


def _watch_tokens(
    session: zenoh.Session, keys: str, on_change: Callable[[str, str, bool], None]
) -> Any:
    """Call `on_change` with the service and source of each liveliness token, and whether it is
    present: now, and on every change.
    """

    def on_token(sample: zenoh.Sample) -> None:
        on_change(*service_and_source(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

    return session.liveliness().declare_subscriber(
        keys, cast("Any", zenoh.handlers.Callback(on_token, indirect=False)), history=True
    )


def give_turn(
    session: zenoh.Session,
    service: str,
    source: str,
    turn: bytes,
    timeout_s: float,
    prefix: str = "",
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
        f"{prefix}{SEAT_PREFIX}{service}/{source}",
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


@contextlib.contextmanager
def subscribed(
    session: zenoh.Session,
    topic: Topic[M],
    receive: Callable[[bytes, Envelope], None],
    prefix: str = "",
) -> Iterator[None]:
    """Subscribe while the context lasts; see subscribe.

    An advanced subscriber that outlives its session can keep the process from ending:
    https://github.com/eclipse-zenoh/zenoh-python/issues/624
    """
    subscription = subscribe(session, topic, receive, prefix)
    try:
        yield
    finally:
        subscription.undeclare()


class NoAnswerError(ConnectionError):
    """A query without a reply, or refused; the text is one line."""


def ask(
    session: zenoh.Session,
    query: Query[Q, A],
    message: Q,
    timeout_s: float,
    prefix: str = "",
    start_s: float = 5.0,
) -> A:
    """Send a query to a running stack, and wait for the reply.

    A service that is starting is waited for, up to `start_s`: Zenoh gives an empty reply if no
    queryable exists, or if it has gone. Raises NoAnswerError on timeout or where the query was
    refused.
    """
    key = wire.key_from_topic(query, prefix)
    payload = wire.encode_document(cast("Document", message))
    begin_s = time.monotonic()
    end_s = begin_s + timeout_s
    while (left_s := end_s - time.monotonic()) > 0.0:
        for reply in session.get(key, payload=payload, timeout=left_s):
            if reply.ok is not None:
                data = reply.ok.payload.to_bytes()
                return cast("A", wire.decode_document(cast("Any", query.response), data))
            said = reply.err.payload.to_string() if reply.err is not None else ""
            if said != "Timeout":
                raise NoAnswerError(said)
        if start_s < time.monotonic() - begin_s < timeout_s:
            raise NoAnswerError(f"{query.name}: {query.owner} is not there to answer")
        time.sleep(0.02)
    raise NoAnswerError(f"{query.name}: no answer from {query.owner} within {timeout_s:g} s")


def alive(session: zenoh.Session, prefix: str = "", timeout_s: float = 1.0) -> set[str]:
    """Names of the services with a liveliness token."""
    names = set()
    for reply in session.liveliness().get(alive_key("*", "*", prefix), timeout=timeout_s):
        if reply.ok is not None:
            names.add(service_and_source(reply.ok.key_expr)[0])
    return names


def watch_sources(
    session: zenoh.Session, on_change: Callable[[str, bool], None], prefix: str = ""
) -> Any:
    """Call `on_change` with the source of each service and whether it is present: now, and on every
    change. Keep a reference to the returned object. It runs on Zenoh's thread: it must only store.
    """
    return _watch_tokens(
        session,
        alive_key("*", "*", prefix),
        lambda _, source, is_there: on_change(source, is_there),
    )


def topic_named(name: str) -> Topic[object] | None:
    """The topic of a name with or without its slash."""
    return BY_NAME.get("/" + name.removeprefix("/"))

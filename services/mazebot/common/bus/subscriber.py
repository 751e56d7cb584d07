"""Subscribers with the delivery that the topic table gives."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Iterator
from datetime import datetime
from typing import Any, TypeVar, cast

import zenoh

from mazebot.common.bus.attachment import unpack_attachment
from mazebot.common.bus.liveliness import GraphNode
from mazebot.common.bus.publisher import RESENT
from mazebot.common.bus.session import now_of
from mazebot.common.messages import wire
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys, types_of
from mazebot.common.messages.topics import Delivery, Topic
from mazebot.common.node.node import Envelope

M = TypeVar("M")

_NO_ENVELOPE = Envelope("", 0, 0, "")
MAX_SOURCES = 4096
"""Publishers, each of one topic, that are remembered, the most recent ones."""
_REMEMBERED = 2 * RESENT
"""Of the last RESENT messages, those that have come are among so many received last: fewer than
RESENT were sent after them, and no more than RESENT before them can have come later.
"""


def _ignore(_: str) -> None:
    pass


class Subscription:
    """A subscriber, with those of the other types that its topic takes, and their tokens."""

    def __init__(self, ends: list[Callable[[], None]]) -> None:
        self._ends = ends

    def undeclare(self) -> None:
        """End it."""
        while self._ends:
            self._ends.pop()()


def subscribe(
    session: zenoh.Session,
    topic: Topic[M],
    receive: Callable[[bytes, Envelope], None],
    keys: Keys = DEFAULT_KEYS,
    reject: Callable[[str], None] = _ignore,
    since: Callable[[], datetime] | None = None,
    graph: GraphNode | None = None,
) -> Subscription:
    """Subscribe with the topic's delivery; keep a reference to the returned object. With `graph`,
    as a subscriber of that node.

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
        payload = sample.payload.to_bytes()
        receive(wire.of_own_type(topic, payload) if topic.also else payload, envelope)

    ends: list[Callable[[], None]] = []
    # On the plain wire all types have the same key.
    for key, type_name in {keys.of_topic(topic, kind): kind for kind in types_of(topic)}.items():
        subscriber = subscribe_samples(session, key, topic.delivery, topic.depth, on_sample)
        ends.append(subscriber.undeclare)
        if graph is not None:
            ends.append(graph.subscribes(topic, type_name))
    return Subscription(ends)


def subscribe_samples(
    session: zenoh.Session,
    key: str,
    delivery: Delivery,
    depth: int,
    on_sample: Callable[[zenoh.Sample], None],
    of_others: bool = False,
) -> Any:
    """Subscribe to a key, whatever comes on it; keep the returned object. `of_others`: without what
    this session itself publishes.
    """
    handler = cast("Any", zenoh.handlers.Callback(on_sample, indirect=False))
    origin = zenoh.Locality.REMOTE if of_others else zenoh.Locality.ANY
    if delivery is Delivery.LATEST:
        return session.declare_subscriber(key, handler, allowed_origin=origin)
    latched = delivery is Delivery.LATCHED
    return zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        handler,
        allowed_origin=origin,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=depth)
        if latched
        else None,
        recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )


def _was_sent_before(begin: datetime, sample: zenoh.Sample) -> bool:
    stamp = sample.timestamp
    return stamp is not None and stamp.get_time() < begin


@contextlib.contextmanager
def subscribed(
    session: zenoh.Session,
    topic: Topic[M],
    receive: Callable[[bytes, Envelope], None],
    keys: Keys = DEFAULT_KEYS,
) -> Iterator[None]:
    """Subscribe while the context lasts; see subscribe.

    An advanced subscriber that outlives its session can keep the process from ending:
    https://github.com/eclipse-zenoh/zenoh-python/issues/624
    """
    subscription = subscribe(session, topic, receive, keys)
    try:
        yield
    finally:
        subscription.undeclare()


class Repeats:
    """What has been received from each publisher, on whatever session: a publisher sends again what
    it caches when it opens a new session, or when a reader does. Any thread may call.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._received: dict[tuple[str, str], deque[int]] = {}
        """By topic and source, the sequence numbers received last."""

    def is_repeated(self, topic: Topic[Any], envelope: Envelope) -> bool:
        """Whether a message has come before, or is latched and older than one that has; else it is
        remembered. One that was lost on the way and comes late is not repeated.
        """
        if topic.delivery is Delivery.LATEST or not envelope.source:
            return False
        key, sequence = (topic.name, envelope.source), envelope.sequence
        with self._lock:
            received = self._received.get(key, deque(maxlen=_REMEMBERED))
            latched = topic.delivery is Delivery.LATCHED
            if received and (sequence <= received[-1] if latched else sequence in received):
                return True
            received.append(sequence)
            # The most recent publisher comes last.
            self._received.pop(key, None)
            self._received[key] = received
            while len(self._received) > MAX_SOURCES:
                del self._received[next(iter(self._received))]
        return False

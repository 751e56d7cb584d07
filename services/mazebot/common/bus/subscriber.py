"""Subscribers with the delivery that the topic table gives."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from datetime import datetime
from typing import Any, TypeVar, cast

import zenoh

from mazebot.common.bus.attachment import unpack_attachment
from mazebot.common.bus.liveliness import GraphNode
from mazebot.common.bus.session import now_of
from mazebot.common.messages import wire
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys, types_of
from mazebot.common.messages.topics import Delivery, Topic
from mazebot.common.node.node import Envelope

M = TypeVar("M")

_NO_ENVELOPE = Envelope("", 0, 0, "")


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

"""Subscribers with the delivery that the topic table gives."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from datetime import datetime
from typing import Any, TypeVar, cast

import zenoh

from mazebot.common.bus.attachment import unpack_attachment
from mazebot.common.bus.session import now_of
from mazebot.common.messages import wire
from mazebot.common.messages.topics import Delivery, Topic
from mazebot.common.node.node import Envelope

M = TypeVar("M")

_NO_ENVELOPE = Envelope("", 0, 0, "")


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


def _was_sent_before(begin: datetime, sample: zenoh.Sample) -> bool:
    stamp = sample.timestamp
    return stamp is not None and stamp.get_time() < begin


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

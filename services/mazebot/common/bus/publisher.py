"""Publishers with the delivery that the topic table gives."""

from __future__ import annotations

from typing import Any, TypeVar

import zenoh

from mazebot.common.bus.liveliness import GraphNode
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys
from mazebot.common.messages.topics import CLOCK, CMD_VEL, Delivery, Topic

M = TypeVar("M")

LOSSLESS_PRIORITY = zenoh.Priority.INTERACTIVE_HIGH
"""As in services/mazebot/router/router.json5."""
RESENT = 100
"""Messages of an EVERY topic that a publisher caches for readers that have missed them."""
HEARTBEAT_S = 1.0
"""Period of sending the last sequence number, by which a reader detects that it missed messages."""


def publish(
    session: zenoh.Session,
    topic: Topic[M],
    keys: Keys = DEFAULT_KEYS,
    lossless: bool = False,
    graph: GraphNode | None = None,
    type_name: str | None = None,
) -> Any:
    """Declare a publisher with the topic's delivery, or one that never drops (`lossless`); with
    `graph`, as one of that node; with `type_name`, of another type that the topic takes.

    Reliable messages block until the router has them. The router itself drops messages for slow
    readers; they are sent again as far as they are cached here. Lossless messages block in the
    router, too; services/mazebot/router/router.json5 recognises them by their priority.
    """
    key = keys.of_topic(topic, type_name)
    if graph is not None:
        graph.publishes(topic)
    encoding = zenoh.Encoding.APPLICATION_CDR.with_schema(type_name or wire.type_name(topic))
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

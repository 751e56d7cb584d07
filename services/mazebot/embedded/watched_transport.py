"""The messages of a run in this process, for those who watch from outside of its services."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from mazebot.common.client.robot import Receive
from mazebot.common.messages import wire
from mazebot.common.messages.topics import DIAGNOSTICS, ROSOUT, Delivery, Topic
from mazebot.common.node.executive import MemoryTransport
from mazebot.common.node.node import Envelope, Inbox

_KEPT: dict[Topic[Any], int] = {DIAGNOSTICS: 1, ROSOUT: 200}
"""Messages that are kept of topics that are not latched on the bus."""


class WatchedTransport(MemoryTransport):
    """Passes each message on to the nodes and to the watches, as Zenoh does for subscribers outside
    of the stack; keeps the newest of each topic and what is latched.
    """

    def __init__(self) -> None:
        super().__init__()
        self.latest: dict[str, Any] = {}
        """The newest message of each topic, by the topic's name."""
        # Who receives a message may publish one at once, or end the watch.
        self._lock = threading.RLock()
        self._watches: tuple[tuple[frozenset[str], Receive], ...] = ()
        self._latched: dict[tuple[str, str], deque[tuple[Topic[Any], object, Envelope]]] = {}

    def send(self, topic: Topic[object], message: object, envelope: Envelope) -> None:
        """Publish a message."""
        self._send(topic, message, envelope)

    def watch(
        self, topics: Iterable[Topic[Any]], receive: Receive, with_latched: bool = True
    ) -> Callable[[], None]:
        """See Robot. `with_latched`: begin with the latched messages."""
        watch = frozenset(topic.name for topic in topics), receive
        with self._lock:
            kept = self._latched.items() if with_latched else ()
            for latched in [one for (name, _), all_ in kept for one in all_ if name in watch[0]]:
                receive(*latched)
            self._watches = (*self._watches, watch)

        def end() -> None:
            with self._lock:
                self._watches = tuple(one for one in self._watches if one is not watch)

        return end

    @property
    def inboxes(self) -> Mapping[str, Inbox]:
        """The inbox of each node, by the node's name."""
        return self._inboxes

    def take_in(self, topic: Topic[Any], data: bytes, envelope: Envelope) -> None:
        """Pass on a serialized message from outside the process. Any thread may call it."""
        try:
            message = wire.decode(topic, data)
            wire.validate(topic, message)
        except wire.WireError:
            # Its readers count it as rejected; nobody else gets it.
            super()._send(topic, data, envelope)
        else:
            self._send(topic, message, envelope)

    @property
    def is_watched(self) -> bool:
        """Whether any topic is watched now."""
        return bool(self._watches)

    def _is_read(self, topic: Topic[Any]) -> bool:
        """Whoever watches may begin at any time."""
        return True

    def _send(self, topic: Topic[object], message: object, envelope: Envelope) -> None:
        with self._lock:
            self.latest[topic.name] = message
            # /diagnostics too: a page that opens while the simulation is paused shows the states;
            # and, as in ROS 2, /rosout: a page that opens shows what was said before.
            kept = _KEPT.get(topic, topic.depth if topic.delivery is Delivery.LATCHED else 0)
            if kept:
                # The lines of all sources stay in their order.
                key = topic.name, "" if topic is ROSOUT else envelope.source
                if key not in self._latched:
                    self._latched[key] = deque(maxlen=kept)
                self._latched[key].append((topic, message, envelope))
            for names, receive in self._watches:
                if topic.name in names:
                    receive(topic, message, envelope)
        super()._send(topic, message, envelope)

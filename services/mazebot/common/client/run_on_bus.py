"""A run in one process, on the bus: others see and drive it like a stack of services."""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol

import zenoh

from mazebot.common.bus.bus import Bus
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages import wire
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys
from mazebot.common.messages.topics import EDGE, TOPICS, Delivery, Topic, owned_by
from mazebot.common.node.edge_client import EdgeClient
from mazebot.common.node.node import Envelope, Inbox, Node

_LOG = logging.getLogger("bus")
MAX_WAITING = 1000
"""Messages that wait to be published; beyond it those of LATEST topics are dropped."""

Receive = Callable[[Topic[Any], Any, Envelope], None]


class Run(Protocol):
    """The messages of a run in this process."""

    @property
    def inboxes(self) -> Mapping[str, Inbox]:
        """The inbox of each node, by the node's name."""

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive) -> Callable[[], None]:
        """Pass on each message of some topics, beginning with the latched ones; call the returned
        function to end it.
        """

    def take_in(self, topic: Topic[Any], data: bytes, envelope: Envelope) -> None:
        """Pass on a serialized message from outside the process. Any thread may call it."""


class RunOnBus:
    """Publishes what the nodes of a run send, answers the queries to them, and passes on what the
    user's tools publish. Nothing else from the bus reaches the run: without such input it is the
    same as without a bus.
    """

    def __init__(
        self, session: zenoh.Session, nodes: Iterable[Node], run: Run, keys: Keys = DEFAULT_KEYS
    ) -> None:
        """Put a run on the bus; until `close()`."""
        self._run = run
        # Among the messages of a run, the source is the node's name.
        self._buses = {
            node.name: Bus(session, node, run.inboxes[node.name], keys, subscribes=False)
            for node in nodes
        }
        user = EdgeClient()
        # What a console in this process publishes.
        self._buses[EDGE] = Bus(session, user, Inbox(user), keys, subscribes=False)
        self._own = {bus.source for bus in self._buses.values()}
        self._waiting: queue.SimpleQueue[tuple[Topic[Any], Any, Envelope] | None] = (
            queue.SimpleQueue()
        )
        self._subscriptions = [
            subscribe(
                session,
                topic,
                self._receiver(topic),
                keys,
                self._rejecter(topic),
                graph=self._reader_of(topic).graph,
            )
            for topic in owned_by(EDGE)
        ]
        self._publishing = threading.Thread(target=self._publish, name="run_on_bus", daemon=True)
        self._publishing.start()
        self._end_watch = run.watch(TOPICS, self._put)
        for name, bus in self._buses.items():
            if name != EDGE:
                bus.announce()

    def close(self) -> None:
        """Withdraw the run, after all that it has sent; the session stays open."""
        self._end_watch()
        self._waiting.put(None)
        self._publishing.join()
        for subscription in self._subscriptions:
            subscription.undeclare()
        for bus in self._buses.values():
            bus.withdraw()

    def _reader_of(self, topic: Topic[Any]) -> Bus:
        """The node that is in ROS 2's graph as the reader of a topic."""
        return next(
            (self._buses[name] for name in topic.readers if name in self._buses), self._buses[EDGE]
        )

    def _receiver(self, topic: Topic[Any]) -> Callable[[bytes, Envelope], None]:
        def receive(data: bytes, envelope: Envelope) -> None:
            if envelope.source not in self._own:
                self._run.take_in(topic, data, envelope)

        return receive

    def _rejecter(self, topic: Topic[Any]) -> Callable[[str], None]:
        def reject(reason: str) -> None:
            for reader in topic.readers:
                if reader in self._run.inboxes:
                    self._run.inboxes[reader].reject(topic, reason)

        return reject

    def _put(self, topic: Topic[Any], message: Any, envelope: Envelope) -> None:
        """Queue a message: serializing takes too long for the thread of the run."""
        if envelope.source not in self._buses:
            # It has come from the bus.
            return
        if topic.delivery is not Delivery.LATEST or self._waiting.qsize() < MAX_WAITING:
            self._waiting.put((topic, message, envelope))

    def _publish(self) -> None:
        # The session may end first, where the process does.
        with contextlib.suppress(zenoh.ZError):
            while (waiting := self._waiting.get()) is not None:
                topic, message, envelope = waiting
                bus = self._buses[envelope.source]
                try:
                    if bus.has_reader(topic):
                        bus.send(topic, message, envelope._replace(source=bus.source))
                except wire.WireError as error:
                    _LOG.warning("%s of %s is not sent: %s", topic.name, bus.node_name, error)

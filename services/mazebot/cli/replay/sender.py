"""Publishes recorded messages on the bus, as the services that sent them."""

from __future__ import annotations

import queue
import time
import uuid
from collections.abc import Callable, Collection, Iterable
from typing import Any, cast

import zenoh

from mazebot.cli.replay.comparison import Comparison
from mazebot.cli.replay.in_process import NOT_COMPARED
from mazebot.cli.replay.reading.replayed import Replayed
from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.liveliness import GraphNode, alive_key, graph_name
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys
from mazebot.common.messages.topics import BY_NAME, EDGE, ROSOUT, Topic, owned_by
from mazebot.common.node.node import Envelope

MATCH_S = 5.0
"""Wall time within which readers that are alive are found."""


class Sender:
    """Publishers of all topics of some services, each with a source of its own."""

    def __init__(
        self,
        session: zenoh.Session,
        services: Iterable[str],
        lossless: bool,
        keys: Keys = DEFAULT_KEYS,
    ) -> None:
        self._session = session
        self.sources = {service: uuid.uuid4().hex for service in (*services, EDGE)}
        self._sequences: dict[tuple[str, str], int] = {}
        self._nodes = {
            service: GraphNode(session, graph_name(service), keys) for service in self.sources
        }
        self._publishers: dict[tuple[str, str], Any] = {
            (service, topic.name): publish(session, topic, keys, lossless, node)
            for service, node in self._nodes.items()
            for topic in owned_by(service)
        }
        self._tokens = [
            session.liveliness().declare_token(alive_key(service, source, keys))
            for service, source in self.sources.items()
            if service != EDGE
        ]
        self.sent = 0

    def send(self, message: Replayed) -> int:
        """Publish a message; return its sequence number."""
        key = message.service, message.topic.name
        # A service that was restarted counts from 0 again, under another source.
        sequence = max(message.envelope.sequence, self._sequences.get(key, -1) + 1)
        self._sequences[key] = sequence
        envelope = Envelope(
            self.sources[message.service],
            sequence,
            message.time_ns,
            message.envelope.world_hash,
        )
        self._publishers[key].put(message.data, attachment=pack_attachment(message.topic, envelope))
        self.sent += 1
        return sequence

    def matched(self, readers: Collection[str]) -> bool:
        """Whether each publisher with one of these readers has found it, as far as it can tell."""
        return all(
            cast("Any", publisher.matching_status).matching
            for (_, name), publisher in self._publishers.items()
            if isinstance(publisher, zenoh.Publisher)
            and any(reader in readers for reader in BY_NAME[name].readers)
        )

    def close(self) -> None:
        """Withdraw the tokens."""
        for token in self._tokens:
            token.undeclare()  # type: ignore[no-untyped-call]
        for node in self._nodes.values():
            node.close()


class Listener:
    """Receives the messages of the services that take the place of recorded ones."""

    def __init__(self, session: zenoh.Session, services: Iterable[str], keys: Keys) -> None:
        self._received: queue.SimpleQueue[tuple[Topic[Any], bytes, int]] = queue.SimpleQueue()
        self.counts: dict[str, int] = {}
        """Messages received, by topic."""
        self.newest_ns: dict[str, int] = {}
        """By source, the latest time at which it sent something."""
        self.own: set[str] = set()
        """Sources of the replay itself."""
        topics = {topic.name: topic for service in services for topic in owned_by(service)}
        # All of them: a service whose messages have no subscriber reopens its session.
        self._subscribers = [
            subscribe(session, topic, self._receiver(topic), keys) for topic in topics.values()
        ]

    def _receiver(self, topic: Topic[Any]) -> Callable[[bytes, Envelope], None]:
        def receive(data: bytes, envelope: Envelope) -> None:
            source, sent_ns = envelope.source, envelope.sent_ns
            if source in self.own:
                return
            if topic is not ROSOUT:
                # A log message may come in the middle of a step.
                self.newest_ns[source] = max(sent_ns, self.newest_ns.get(source, 0))
            if topic.name not in NOT_COMPARED:
                self._received.put((topic, data, sent_ns))

        return receive

    def hand_to(self, comparison: Comparison) -> None:
        """Compare the messages received since the last call."""
        while not self._received.empty():
            topic, data, sent_ns = self._received.get()
            self.counts[topic.name] = self.counts.get(topic.name, 0) + 1
            comparison.take_replayed(topic, sent_ns, data)

    def close(self) -> None:
        """Stop receiving."""
        for subscriber in self._subscribers:
            subscriber.undeclare()


def wait_until(is_so: Callable[[], bool], timeout_s: float) -> bool:
    """Wait until a condition holds; false where it does not within the time."""
    end_s = time.monotonic() + timeout_s
    while not is_so():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.02)
    return True

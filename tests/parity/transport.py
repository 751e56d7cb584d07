"""A transport through CDR and a real router, and a record of what a transport carries."""

from __future__ import annotations

import time
from typing import Any

from mazebot.common.bus.bus import Bus
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive
from mazebot.common.bus.session import open_session
from mazebot.common.messages import wire
from mazebot.common.messages.topics import Topic, owned_by
from mazebot.common.node.executive import MemoryTransport
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox

DEADLINE_S = 20.0

Record = list[tuple[str, int, str, bytes]]
"""Topic, simulation time, world and CDR bytes of each message, in the order in which they were
sent.
"""


def _note(record: Record, topic: Topic[object], message: object, envelope: Envelope) -> None:
    data = wire.encode(topic, message)
    record.append((topic.name, envelope.sent_ns, envelope.world_hash, data))


class RecordedMemoryTransport(MemoryTransport):
    """The transport of one process, with a record."""

    def __init__(self) -> None:
        super().__init__()
        self.record: Record = []

    def _is_read(self, topic: Topic[Any]) -> bool:
        """By the record."""
        return True

    def _send(self, topic: Topic[object], message: object, envelope: Envelope) -> None:
        _note(self.record, topic, message, envelope)
        super()._send(topic, message, envelope)


class ZenohTransport:
    """A session for each node, all on one router; a step ends when what it sent has arrived."""

    def __init__(self, endpoint: str) -> None:
        self._config = BusConfig(connect=endpoint)
        self._inboxes: dict[str, Inbox] = {}
        self._buses: list[Bus] = []
        self.record: Record = []

    def connect(self, node: Node) -> tuple[Inbox, Outbox]:
        """The boxes of a node on a session of its own."""
        session = open_session(self._config, timeout_s=5.0)
        inbox = Inbox(node)
        bus = Bus(session, node, inbox, lossless=True)
        bus.announce()
        # An answer from the router says that it has taken in what was declared before.
        alive(session)
        self._inboxes[node.name] = inbox
        self._buses.append(bus)

        def send(topic: Topic[object], message: object, envelope: Envelope) -> None:
            _note(self.record, topic, message, envelope)
            bus.send(topic, message, envelope)

        return inbox, Outbox(node, send, bus.source)

    def settle(self, node: Node, outbox: Outbox) -> None:
        """Wait until each reader has what the node has sent. Raises TimeoutError where one never
        does.
        """
        deadline_s = time.monotonic() + DEADLINE_S
        (bus,) = (bus for bus in self._buses if bus.node_name == node.name)
        for topic in owned_by(node.name):
            last = outbox.sent(topic) - 1
            for reader in topic.readers:
                if last < 0 or reader not in self._inboxes:
                    continue
                seen = self._inboxes[reader].counts[topic.name].last_sequence
                while seen.get(bus.source, -1) < last:
                    if time.monotonic() > deadline_s:
                        raise TimeoutError(f"{reader} never got {topic.name} #{last}")
                    time.sleep(0)

    def wait_until_matched(self) -> None:
        """Wait until each publisher knows of its readers."""
        deadline_s = time.monotonic() + DEADLINE_S
        for bus in self._buses:
            while not bus.matched(self._inboxes):
                if time.monotonic() > deadline_s:
                    raise TimeoutError(f"{bus.node_name}: a publisher never met its readers")
                time.sleep(0.01)

    def close(self) -> None:
        """Close every session."""
        for bus in self._buses:
            bus.close()

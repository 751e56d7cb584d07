"""What nodes of DDS publish, published on the bus."""

from __future__ import annotations

import contextlib
import itertools
import time
from typing import Any

import zenoh

from mazebot.common.bus.attachment import pack_ros_attachment
from mazebot.common.bus.liveliness import GraphNode
from mazebot.common.bus.publisher import publish
from mazebot.common.messages.keys import PUBLISHER, Keys, qos_of
from mazebot.common.messages.topics import Delivery, Topic
from mazebot.common.messages.type_hash import hash_of
from mazebot.ros2_bridge.dds import DEPTH, Close, Dds, Writer, class_of, qos


class FromDds:
    """Subscribers of one participant of DDS. All but `close` works on its thread."""

    def __init__(self, session: zenoh.Session, keys: Keys, dds: Dds) -> None:
        self._session, self._keys, self._dds = session, keys, dds
        self._closes: list[Close] = []
        self._writers: dict[bytes, _WriterOnBus] = {}

    def hear(self, topic: Topic[Any], type_name: str) -> None:
        """Carry a topic, under its own type or another that it takes."""
        latched = topic.delivery is Delivery.LATCHED
        profile = qos(DEPTH, latched, reliable=topic.delivery is not Delivery.LATEST)

        def receive(data: bytes, writer: Writer) -> None:
            on_bus = self._writers.get(writer.gid)
            if on_bus is None:
                on_bus = self._writers[writer.gid] = _WriterOnBus(
                    self._session, self._keys, topic, type_name, writer.node
                )
            on_bus.put(data)

        def ended(gid: bytes) -> None:
            on_bus = self._writers.pop(gid, None)
            if on_bus is not None:
                on_bus.close()

        def declare() -> None:
            name = self._keys.whole_name(topic.name)
            close = self._dds.subscriber(
                self._dds.own_node, name, class_of(type_name), profile, receive, ended
            )
            self._closes.append(close)

        self._dds.later(declare)

    def close(self) -> None:
        """End all. Not on the thread of DDS."""
        self._dds.done(self._end)

    def _end(self) -> None:
        while self._closes:
            self._closes.pop()()
        while self._writers:
            self._writers.popitem()[1].close()


class _WriterOnBus:
    """A publisher of DDS as one of the bus: when it ends, its token goes, by which the robot that
    it has driven stops.
    """

    def __init__(
        self, session: zenoh.Session, keys: Keys, topic: Topic[Any], type_name: str, node: str
    ) -> None:
        self._graph = GraphNode(session, node.rpartition("/")[2], keys)
        self._publisher = publish(session, topic, keys, type_name=type_name)
        self._gid, _ = self._graph.has(
            PUBLISHER, topic.name, type_name, hash_of(type_name), qos_of(topic)
        )
        self._numbers = itertools.count()

    def put(self, data: bytes) -> None:
        """Publish a message in CDR."""
        attachment = pack_ros_attachment(next(self._numbers), time.time_ns(), self._gid)
        # Without a router, nobody is there to hear it.
        with contextlib.suppress(zenoh.ZError):
            self._publisher.put(data, attachment=attachment)

    def close(self) -> None:
        """Withdraw it."""
        self._graph.close()
        self._publisher.undeclare()

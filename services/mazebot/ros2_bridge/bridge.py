"""Carries topics, services and actions between the bus and nodes of ROS 2 that speak DDS.

On the bus it is a client of its own: it takes what is in ROS 2's graph there, as far as it is
allowed, and offers it on the other side under the same names. Payloads are the same bytes on both.
"""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, cast

import zenoh

from mazebot.common.bus.attachment import pack_ros_attachment
from mazebot.common.bus.liveliness import GraphNode, watch_endpoints
from mazebot.common.bus.subscriber import subscribe_samples
from mazebot.common.messages import wire
from mazebot.common.messages.keys import (
    CLIENT,
    LATCHED_QOS,
    PUBLISHER,
    RELIABLE_QOS,
    SERVICE,
    SUBSCRIBER,
    Endpoint,
    Keys,
    qos_of,
    types_of,
)
from mazebot.common.messages.topics import BY_NAME, TOPICS, Delivery, Topic
from mazebot.common.messages.type_hash import hash_of
from mazebot.common.ros.actions import ACTIONS
from mazebot.common.ros.interfaces import interfaces
from mazebot.common.ros.table import ROS_SERVICES
from mazebot.ros2_bridge.config import NAME, Ros2BridgeConfig, is_allowed
from mazebot.ros2_bridge.dds import DEPTH, Close, Dds, Respond, Values, class_of, qos
from mazebot.ros2_bridge.from_dds import FromDds

LONGEST_CALL_S = 30 * 24 * 3600.0
"""A request for the result of a goal is answered when it has ended."""
_SERVICE_TYPES = {
    **{service.name: service.type for service in ROS_SERVICES},
    **{name: kind for action in ACTIONS for name, kind in action.services.items()},
}
_ACTION_TOPICS = {name: kind for action in ACTIONS for name, kind in action.topics.items()}


@dataclass
class _Carried:
    """What is offered to DDS under one name, and those on the bus who have it."""

    close: Close
    gids: set[str] = field(default_factory=set)


class Bridge:
    """One session's bridge. It works on the thread of `dds`."""

    def __init__(
        self, session: zenoh.Session, keys: Keys, config: Ros2BridgeConfig, dds: Dds, others: Dds
    ) -> None:
        """`others`: as `dds`, for topics under other types than their own: one participant of DDS
        has a topic with one type.
        """
        self._session, self._keys, self._config, self._dds = session, keys, config, dds
        self._log = logging.getLogger(NAME)
        self._types = interfaces(keys.distro)
        self._carried: dict[tuple[str, str], _Carried] = {}
        self._told: set[str] = set()
        self._graph = GraphNode(session, NAME, keys)
        self._heard = [FromDds(session, keys, each) for each in (dds, others)]
        for topic in TOPICS:
            if is_allowed(topic.name, config.from_ros):
                own, *other_types = types_of(topic)
                self._heard[0].hear(topic, own)
                for type_name in other_types:
                    self._heard[1].hear(topic, type_name)
        self._tokens = watch_endpoints(
            session, keys.domain_tokens, self._on_change, keys, of_others=True
        )

    def close(self) -> None:
        """Withdraw all from both sides. Not on the thread of DDS."""
        self._tokens.undeclare()
        for heard in self._heard:
            heard.close()
        self._dds.done(self._end)
        self._graph.close()

    def _end(self) -> None:
        while self._carried:
            self._carried.popitem()[1].close()

    def _on_change(self, endpoint: Endpoint, is_there: bool) -> None:
        self._dds.later(lambda: self._change(endpoint, is_there))

    def _change(self, endpoint: Endpoint, is_there: bool) -> None:
        """Offer what has come to the bus, and withdraw what has gone."""
        name = self._keys.name_in_stack(endpoint.name)
        if name is None:
            return
        place = endpoint.kind, name
        carried = self._carried.get(place)
        if is_there:
            if carried is None:
                close = self._offer(endpoint, name)
                if close is None:
                    return
                carried = self._carried[place] = _Carried(close)
            carried.gids.add(endpoint.gid)
        elif carried is not None:
            carried.gids.discard(endpoint.gid)
            if not carried.gids:
                del self._carried[place]
                carried.close()

    def _offer(self, endpoint: Endpoint, name: str) -> Close | None:
        """None: it is none of those that are carried."""
        if endpoint.kind == PUBLISHER:
            if name in BY_NAME and is_allowed(name, self._config.to_ros):
                topic = BY_NAME[name]
                if endpoint.type_name == types_of(topic)[0]:
                    return self._tell_topic(endpoint, topic)
            elif name in _ACTION_TOPICS and is_allowed(name, self._config.services):
                return self._tell_part_of_action(endpoint, name)
        elif endpoint.kind == SERVICE and name in _SERVICE_TYPES:
            if is_allowed(name, self._config.services):
                return self._serve(endpoint, name)
        return None

    def _fits(self, endpoint: Endpoint, type_hash: str) -> bool:
        """Whether a type is that of the bridge; if not, it is told once."""
        if endpoint.type_hash == type_hash:
            return True
        if endpoint.name not in self._told:
            self._told.add(endpoint.name)
            self._log.warning(
                "%s is not carried: %s of another distribution than %s", endpoint.name,
                endpoint.type_name, self._keys.distro,
            )  # fmt: skip
        return False

    def _tell_topic(self, endpoint: Endpoint, topic: Topic[Any]) -> Close | None:
        """Publish for DDS what is published on the bus."""
        if not self._fits(endpoint, hash_of(endpoint.type_name)):
            return None
        # It stands for all publishers on the bus, each of which has a last message.
        depth = max(topic.depth * len(topic.owners), DEPTH)
        key = self._keys.of_topic(topic)
        node = self._dds.own_node
        return self._tell(node, endpoint, key, qos_of(topic), topic.delivery, topic.depth, depth)

    def _tell_part_of_action(self, endpoint: Endpoint, name: str) -> Close | None:
        """Publish for DDS feedback, or the status of the goals."""
        type_name = _ACTION_TOPICS[name]
        type_hash = self._types.hash_of(type_name)
        if not self._fits(endpoint, type_hash):
            return None
        key = self._keys.typed(name, type_name, type_hash)
        if name.endswith("/status"):
            return self._tell(endpoint.node, endpoint, key, LATCHED_QOS, Delivery.LATCHED, 1, 1)
        return self._tell(endpoint.node, endpoint, key, RELIABLE_QOS, Delivery.LATEST, 1, DEPTH)

    def _tell(
        self,
        node: str,
        endpoint: Endpoint,
        key: str,
        qos_on_bus: str,
        delivery: Delivery,
        depth: int,
        depth_offered: int,
    ) -> Close:
        """Publish for DDS what comes on a key, while somebody there hears it. What is latched is
        then kept up to date, for those who come later.
        """
        latched = delivery is Delivery.LATCHED
        ends: list[Close] = []

        def on_readers(put: Callable[[bytes], None], count: int) -> None:
            def on_sample(sample: zenoh.Sample) -> None:
                put(sample.payload.to_bytes())

            if count and not ends:
                subscriber = subscribe_samples(
                    self._session, key, delivery, depth, on_sample, of_others=True
                )
                name = self._keys.name_in_stack(endpoint.name) or endpoint.name
                held = self._graph.has(
                    SUBSCRIBER, name, endpoint.type_name, endpoint.type_hash, qos_on_bus
                )
                ends.extend((subscriber.undeclare, held.withdraw))
            elif not count and not latched:
                end()

        def end() -> None:
            while ends:
                ends.pop()()

        kind = class_of(endpoint.type_name)
        close = self._dds.publisher(
            node, endpoint.name, kind, qos(depth_offered, latched), on_readers
        )

        def withdraw() -> None:
            end()
            close()

        return withdraw

    def _serve(self, endpoint: Endpoint, name: str) -> Close | None:
        """Pass requests of DDS on to a service on the bus."""
        type_name = _SERVICE_TYPES[name]
        type_hash = self._types.hash_of(type_name)
        if not self._fits(endpoint, type_hash):
            return None
        key = self._keys.typed(name, type_name, type_hash)
        gid, withdraw = self._graph.has(CLIENT, name, type_name, type_hash, RELIABLE_QOS)
        numbers = itertools.count(1)

        def handle(request: Values, respond: Respond) -> None:
            def on_reply(reply: zenoh.Reply) -> None:
                if reply.ok is not None:
                    respond(reply.ok.payload.to_bytes())
                elif reply.err is not None:
                    self._log.warning("%s", reply.err.payload.to_string())

            attachment = pack_ros_attachment(next(numbers), time.time_ns(), gid)
            try:
                self._session.get(
                    key,
                    cast("Any", zenoh.handlers.Callback(on_reply, indirect=False)),
                    payload=self._types.encode(f"{type_name}_Request", request),
                    encoding=zenoh.Encoding.APPLICATION_CDR,
                    attachment=attachment,
                    timeout=LONGEST_CALL_S,
                )
            except (zenoh.ZError, wire.WireError) as error:
                self._log.warning("%s: %s", endpoint.name, error)

        close = self._dds.service(endpoint.node, endpoint.name, class_of(type_name), handle)

        def end() -> None:
            withdraw()
            close()

        return end

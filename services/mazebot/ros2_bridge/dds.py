"""The side of DDS: nodes, publishers, subscribers and services of one ROS domain, with messages as
CDR bytes. Nothing else knows rclpy.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import logging
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_services_default,
)
from rclpy.serialization import deserialize_message
from rclpy.type_support import check_is_valid_srv_type
from rclpy.waitable import NumberOfEntities, Waitable

DEPTH = 10
"""Of a history, where nothing else is told: as in ROS 2."""
_PATIENCE_S = 5.0
"""Within which the thread that spins comes to its next work."""

Respond = Callable[[bytes], None]
Values = dict[str, Any]
"""The fields of a message, and of those in it."""
Close = Callable[[], None]

_PROFILES = """<?xml version="1.0" encoding="UTF-8" ?>
<profiles xmlns="http://www.eprosima.com">
  <transport_descriptors><transport_descriptor>
    <transport_id>udp</transport_id><type>UDPv4</type>
    <sendBufferSize>1048576</sendBufferSize><receiveBufferSize>1048576</receiveBufferSize>
    <maxInitialPeersRange>100</maxInitialPeersRange>{interfaces}
  </transport_descriptor></transport_descriptors>
  <participant profile_name="bridge" is_default_profile="true"><rtps>
    <useBuiltinTransports>false</useBuiltinTransports>
    <userTransports><transport_id>udp</transport_id></userTransports>
    <builtin>{peers}</builtin>
    <propertiesPolicy><properties><property>
      <name>fastdds.ignore_local_endpoints</name><value>true</value>
    </property></properties></propertiesPolicy>
  </rtps></participant>
</profiles>
"""
"""UDP alone: shared memory is not shared with those outside a container, who would wait for it in
vain, and rmw's own LOCALHOST has it. Without local endpoints the bridge does not hear itself: a
message would go round for ever.
"""
_LOOPBACK = {
    "interfaces": "<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>",
    "peers": "<initialPeersList><locator><udpv4><address>127.0.0.1</address></udpv4></locator>"
    "</initialPeersList>",
}
_SUBNET = {"interfaces": "", "peers": ""}


def prepare_environment(discovery: str, folder: Path) -> None:
    """Set the variables that Fast DDS and rmw read when the first node is made; `folder` is to stay
    until then.
    """
    profiles = folder / "profiles.xml"
    profiles.write_text(_PROFILES.format(**(_SUBNET if discovery == "subnet" else _LOOPBACK)))
    os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = str(profiles)
    # As the profile has it.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"


@functools.cache
def class_of(type_name: str) -> Any:
    """The class of a message, of a service, or of a part of an action, such as
    `nav2_msgs/action/Spin_SendGoal`. Raises LookupError where it is not installed.
    """
    package, kind, name = type_name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
        if kind != "action":
            return getattr(module, name)
        action, _, part = name.rpartition("_")
        parts = getattr(module, action).Impl
        return getattr(parts, part if part == "FeedbackMessage" else f"{part}Service")
    except (ImportError, AttributeError) as error:
        raise LookupError(f"{type_name}: not installed") from error


def qos(depth: int, latched: bool = False, reliable: bool = True) -> QoSProfile:
    """The quality of service with a depth of history; `latched` is transient local."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def values_of(message: Any) -> Values:
    """The values of a message of rclpy, whose own serialization leaves stray bytes at the end."""
    return {name: _plain(getattr(message, name)) for name in message.get_fields_and_field_types()}


def _plain(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return values_of(value)
    if isinstance(value, bytes):
        # A `byte`.
        return value[0]
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return value


@dataclass(frozen=True)
class Writer:
    """A publisher of another node."""

    gid: bytes
    node: str


class _Service(Waitable[Any]):  # type: ignore[misc]
    """A service whose requests are answered later, on any thread; rclpy's own answers within its
    callback, which would hold a thread for each goal that waits for its result.
    """

    def __init__(
        self, node: Node, kind: Any, name: str, handle: Callable[[Values, Respond], None]
    ) -> None:
        check_is_valid_srv_type(kind)
        super().__init__(node.default_callback_group)
        self._kind, self._handle = kind, handle
        with node.handle:
            self._service = rclpy_implementation.Service(
                node.handle, kind, name, qos_profile_services_default.get_c_qos_profile()
            )
        self._index = 0
        self._node = node
        node.add_waitable(self)

    def __enter__(self) -> None:
        self._service.__enter__()

    def __exit__(self, *error: Any) -> None:
        self._service.__exit__(*error)

    def get_num_entities(self) -> NumberOfEntities:
        """One service."""
        return NumberOfEntities(num_services=1)

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Wait for a request."""
        self._index = wait_set.add_service(self._service)

    def is_ready(self, wait_set: Any) -> bool:
        """Whether there is a request."""
        ready: bool = wait_set.is_ready("service", self._index)
        return ready

    def take_data(self) -> Any:
        """The request and its header."""
        return self._service.service_take_request(self._kind.Request)

    async def execute(self, taken: Any) -> None:
        """Hand a request on."""
        request, header = taken
        if header is None:
            return

        def respond(data: bytes) -> None:
            response = deserialize_message(data, self._kind.Response)
            # It may have ended since.
            with contextlib.suppress(rclpy_implementation.InvalidHandle), self._service:
                self._service.service_send_response(response, header.request_id)

        self._handle(values_of(request), respond)

    def close(self) -> None:
        """End it."""
        self._node.remove_waitable(self)
        self._service.destroy_when_not_in_use()


class Dds:
    """Nodes in one domain. All but publishing and responding is to be done by `later`."""

    def __init__(self, domain_id: int, own_node: str) -> None:
        self.own_node = own_node
        """The full name of the node that has what belongs to no other."""
        self._log = logging.getLogger(own_node.rpartition("/")[2])
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=domain_id)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._nodes: dict[str, Node] = {}
        self._used: dict[str, int] = {}

    def later(self, work: Callable[[], None]) -> None:
        """Do work on the thread that spins; what fails is told, and the rest goes on. Any thread
        may call.
        """

        def attempt() -> None:
            try:
                work()
            except Exception:
                self._log.exception("DDS")

        self._executor.create_task(attempt)

    def done(self, work: Callable[[], None]) -> None:
        """Do work on the thread that spins, which is not this one, and wait for it."""
        ended = threading.Event()

        def attempt() -> None:
            try:
                work()
            finally:
                ended.set()

        self.later(attempt)
        ended.wait(_PATIENCE_S)

    def spin(self) -> None:
        """Work until `stop`."""
        self._executor.spin()

    def stop(self) -> None:
        """End all. Any thread may call."""
        self._executor.shutdown(timeout_sec=1.0)
        self._context.try_shutdown()

    def publisher(
        self,
        node: str,
        name: str,
        kind: Any,
        profile: QoSProfile,
        on_readers: Callable[[Callable[[bytes], None], int], None],
    ) -> Close:
        """A publisher. `on_readers` gets what publishes a message, and the number of its
        subscribers, whenever that has changed.
        """
        owner = self._take(node)
        made: Any = None

        def on_matched(status: Any) -> None:
            on_readers(made.publish, status.current_count)

        made = owner.create_publisher(
            kind, name, profile, event_callbacks=PublisherEventCallbacks(matched=on_matched)
        )

        def close() -> None:
            owner.destroy_publisher(made)
            self._give_back(node)

        return close

    def service(
        self, node: str, name: str, kind: Any, handle: Callable[[Values, Respond], None]
    ) -> Close:
        """A service; `handle` gets each request, and what responds to it."""
        made = _Service(self._take(node), kind, name, handle)

        def close() -> None:
            made.close()
            self._give_back(node)

        return close

    def subscriber(
        self,
        node: str,
        name: str,
        kind: Any,
        profile: QoSProfile,
        receive: Callable[[bytes, Writer], None],
        ended: Callable[[bytes], None],
    ) -> Close:
        """A subscriber; `receive` gets each message and its publisher, `ended` the gid of each
        publisher that is gone.
        """
        owner = self._take(node)
        known: dict[bytes, Writer] = {}

        def on_message(data: bytes, info: Any) -> None:
            gid = _gid(info["publisher_gid"]["data"])
            writer = known.get(gid)
            if writer is None:
                nodes = dict(self._writers(owner, name))
                writer = known[gid] = Writer(gid, nodes.get(gid, "unknown"))
            receive(data, writer)

        def on_matched(_: Any) -> None:
            there = {gid for gid, _ in self._writers(owner, name)}
            for gid in [gid for gid in known if gid not in there]:
                del known[gid]
                ended(gid)

        made = owner.create_subscription(
            kind, name, on_message, profile, raw=True,
            event_callbacks=SubscriptionEventCallbacks(matched=on_matched),
        )  # fmt: skip

        def close() -> None:
            owner.destroy_subscription(made)
            self._give_back(node)

        return close

    def _writers(self, owner: Node, name: str) -> list[tuple[bytes, str]]:
        return [
            (_gid(each.endpoint_gid), f"{each.node_namespace.rstrip('/')}/{each.node_name}")
            for each in owner.get_publishers_info_by_topic(name)
        ]

    def _take(self, node: str) -> Node:
        """The node of a full name, made where it is not there."""
        made = self._nodes.get(node)
        if made is None:
            namespace, _, short = node.rpartition("/")
            made = self._nodes[node] = Node(
                short, context=self._context, namespace=namespace or "/",
                use_global_arguments=False, enable_rosout=False, start_parameter_services=False,
                enable_logger_service=False,
            )  # fmt: skip
            self._executor.add_node(made)
        self._used[node] = self._used.get(node, 0) + 1
        return made

    def _give_back(self, node: str) -> None:
        self._used[node] -= 1
        if not self._used[node]:
            del self._used[node]
            made = self._nodes.pop(node)
            self._executor.remove_node(made)
            made.destroy_node()


def _gid(data: Any) -> bytes:
    """The 16 bytes of a publisher's identity."""
    return bytes(data)[:16]

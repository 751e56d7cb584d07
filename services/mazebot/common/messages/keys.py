"""Topic to Zenoh key expression and back, and the liveliness tokens of ROS 2's graph: as rmw_zenoh
has them (Jazzy and newer), or plain. Nothing else knows how a key is made.

rmw_zenoh's layout is described in its docs/design.md.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeVar

import xxhash

from mazebot.common.messages import wire
from mazebot.common.messages.own_keys import RMW_ZENOH, own_root
from mazebot.common.messages.topics import BY_NAME, Delivery, Query, Topic
from mazebot.common.messages.type_hash import hash_of

M = TypeVar("M")

Kind = Literal["MP", "MS", "SS", "SC"]
"""An endpoint of rmw_zenoh: a publisher, a subscriber, a service or a client of one."""
PUBLISHER: Kind = "MP"
SUBSCRIBER: Kind = "MS"
SERVICE: Kind = "SS"
CLIENT: Kind = "SC"
RELIABLE_QOS = "::,10:,:,:,,"
"""The quality of service of services, and of topics with nothing but a history of 10."""
LATCHED_QOS = ":1:,1:,:,:,,"

_GRAPH, _NODE = "@ros2_lv", "NN"
ALL_TOKENS = f"{_GRAPH}/**"
"""The tokens of ROS 2's graph in all domains."""
NODE_TOKENS = f"{_GRAPH}/*/*/*/*/{_NODE}/*/*/*"
"""Those of nodes."""
_RESENT = 100
_DDS_TYPE = re.compile(r"(\w+)::(msg|srv|action)::dds_::(\w+)_")


@dataclass(frozen=True)
class Keys:
    """The keys of one stack."""

    wire: str = RMW_ZENOH
    domain_id: int = 0
    """ROS domain; the plain wire has none."""
    prefix: str = ""
    """ROS namespace with a slash at its end, such as `bot1/`."""
    distro: str = "jazzy"
    """The distribution of ROS 2 whose services and actions are spoken."""

    @property
    def is_ros(self) -> bool:
        """Whether nodes of ROS 2 with rmw_zenoh read these keys."""
        return self.wire == RMW_ZENOH

    def own(self, name: str) -> str:
        """The key of what only Mazebot knows."""
        return own_root(self.wire, self.domain_id, self.prefix) + name

    def of_query(self, query: Query[Any, Any]) -> str:
        """The key of a query: its name without the slash."""
        return self.own(query.name.removeprefix("/"))

    def of_topic(self, topic: Topic[M], type_name: str | None = None) -> str:
        """The key of a topic: `DOMAIN/NAME/TYPE/HASH`, or on the plain wire the name without its
        slash, as in zenoh-bridge-ros2dds. `type_name`: another type than the topic's own.
        """
        if not self.is_ros:
            return self.prefix + topic.name.removeprefix("/")
        kind = type_name or wire.type_name(topic)
        return self.typed(topic.name, kind, hash_of(kind))

    def typed(self, name: str, type_name: str, type_hash: str) -> str:
        """The key of a topic or a service with a type on the wire of rmw_zenoh."""
        whole = self.prefix + name.removeprefix("/")
        return f"{self.domain_id}/{whole}/{_dds_type(type_name)}/{type_hash}"

    def topic_of(self, key: str) -> Topic[Any] | None:
        """The topic with a key, if it is that of a type which the topic takes."""
        name = key
        if self.is_ros:
            domain, _, rest = key.partition("/")
            name = "/".join(rest.split("/")[:-2])
            if domain != str(self.domain_id):
                return None
        topic = BY_NAME.get("/" + name.removeprefix(self.prefix))
        if topic is None or not name.startswith(self.prefix):
            return None
        return topic if key in [self.of_topic(topic, kind) for kind in types_of(topic)] else None

    def node_token(self, session: str, number: int, node: str) -> str:
        """The token of a node, which has a number in its session."""
        place = f"{_GRAPH}/{self.domain_id}/{session}/{number}/{number}"
        return f"{place}/{_NODE}/%/{self._namespace}/{node}"

    def endpoint_token(
        self, session: str, node_number: int, number: int, node: str, kind: Kind, topic: Topic[M],
        type_name: str | None = None,
    ) -> str:  # fmt: skip
        """The token of a node's publisher or subscriber, which has a number in its session."""
        type_name = type_name or wire.type_name(topic)
        return self.typed_token(
            session, node_number, number, node, kind, topic.name, type_name, hash_of(type_name),
            qos_of(topic),
        )  # fmt: skip

    def typed_token(
        self, session: str, node_number: int, number: int, node: str, kind: Kind, name: str,
        type_name: str, type_hash: str, qos: str,
    ) -> str:  # fmt: skip
        """The token of a node's endpoint, which has a number in its session."""
        whole = f"%{self.prefix}{name.removeprefix('/')}".replace("/", "%")
        place = f"{_GRAPH}/{self.domain_id}/{session}/{node_number}/{number}"
        return (
            f"{place}/{kind}/%/{self._namespace}/{node}/{whole}/{_dds_type(type_name)}/"
            f"{type_hash}/{qos}"
        )

    @property
    def publisher_tokens(self) -> str:
        """The key expression of the tokens of all publishers."""
        return f"{_GRAPH}/{self.domain_id}/*/*/*/{PUBLISHER}/**"

    @property
    def domain_tokens(self) -> str:
        """The key expression of all tokens in this domain."""
        return f"{_GRAPH}/{self.domain_id}/**"

    def endpoint(self, token: str) -> Endpoint | None:
        """What the token of an endpoint in this domain says; None: it is no such token."""
        # Newer versions have parts of their own behind the quality of service.
        parts = token.split("/", 13)
        if len(parts) < 13 or parts[:2] != [_GRAPH, str(self.domain_id)]:
            return None
        _, _, _, _, _, kind, _, namespace, node, name, dds_type, hash_, *_ = parts
        if kind not in (PUBLISHER, SUBSCRIBER, SERVICE, CLIENT):
            return None
        found = _DDS_TYPE.fullmatch(dds_type)
        return Endpoint(
            kind,
            f"{namespace.replace('%', '/').rstrip('/')}/{node}",
            name.replace("%", "/"),
            "/".join(found.groups()) if found else dds_type,
            hash_,
            gid_of(token),
        )

    def topic_with(self, endpoint: Endpoint) -> Topic[Any] | None:
        """The topic that has the name of an endpoint, whatever its type."""
        return BY_NAME.get(self.name_in_stack(endpoint.name) or "")

    def name_in_stack(self, name: str) -> str | None:
        """A topic or service without the stack's namespace; None: it is not in it."""
        start = f"/{self.prefix}"
        return f"/{name.removeprefix(start)}" if name.startswith(start) else None

    def whole_name(self, name: str) -> str:
        """A topic or service with the stack's namespace."""
        return f"/{self.prefix}{name.removeprefix('/')}"

    @property
    def _namespace(self) -> str:
        return f"/{self.prefix}".rstrip("/").replace("/", "%") or "%"


class GraphPlace(NamedTuple):
    """Where a node is in ROS 2's graph."""

    domain: str
    name: str
    """With its namespace."""


def node_in(token: str) -> GraphPlace | None:
    """The node whose token it is, in any domain; None: it is no node's."""
    parts = token.split("/")
    if len(parts) != 9 or parts[5] != _NODE:
        return None
    return GraphPlace(parts[1], f"{parts[7].replace('%', '/').rstrip('/')}/{parts[8]}")


@dataclass(frozen=True)
class Endpoint:
    """A publisher, a subscriber, a service or a client in ROS 2's graph."""

    kind: Kind
    node: str
    """With its namespace."""
    name: str
    """Of the topic or service, with its namespace."""
    type_name: str
    type_hash: str
    gid: str
    """As in the attachments of its messages, in hexadecimal digits."""

    def misfit(self, topic: Topic[M]) -> str:
        """Why its messages are not those of a topic of the same name; empty: they are."""
        if self.type_name not in types_of(topic):
            return f"{self.type_name}: must be {' or '.join(types_of(topic))}"
        wanted = hash_of(self.type_name)
        if self.type_hash == wanted:
            return ""
        return f"{self.type_name} with the hash {self.type_hash}: must be {wanted}"


DEFAULT_KEYS = Keys()


def types_of(topic: Topic[M]) -> tuple[str, ...]:
    """The ROS types that a topic takes, its own first."""
    return (wire.type_name(topic), *(kind.__msgtype__ for kind in topic.also))


def gid_of(token: str) -> str:
    """The identity of an endpoint by its token, in hexadecimal digits: XXH3 of 128 bits, the lower
    half first, both little endian.
    """
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little").hex()


@functools.cache
def _dds_type(type_name: str) -> str:
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def qos_of(topic: Topic[M]) -> str:
    """The quality of service in a token: reliability, durability, depth of the history; numbers are
    those of rmw/types.h, and what is rmw's default is empty.
    """
    best_effort = "2" if topic.delivery is Delivery.LATEST else ""
    transient_local = "1" if topic.delivery is Delivery.LATCHED else ""
    depth = _RESENT if topic.delivery is Delivery.EVERY else topic.depth
    return f"{best_effort}:{transient_local}:,{depth}:,:,:,,"

"""Liveliness tokens: of services that are alive, and of nodes in ROS 2's graph."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar, cast

import zenoh

from mazebot.common.messages.keys import (
    DEFAULT_KEYS,
    NODE_TOKENS,
    PUBLISHER,
    SUBSCRIBER,
    Endpoint,
    GraphPlace,
    Keys,
    Kind,
    gid_of,
    node_in,
)
from mazebot.common.messages.topics import EDGE, Topic

M = TypeVar("M")

ALIVE_PREFIX = "mazebot/alive/"
_ROUTER_S = 20.0
"""Longer than the lease after which a connection to a router that hangs is closed."""
_NUMBERS = itertools.count()
"""Of nodes and endpoints: unique in each session, because they are in this process."""


def alive_key(service: str, source: str, keys: Keys = DEFAULT_KEYS) -> str:
    """The key of a service's liveliness token, which names the service and its message source."""
    return keys.own(f"{ALIVE_PREFIX}{service}/{source}")


def service_and_source(key: object) -> tuple[str, str]:
    """The service and the source at the end of a token's or a seat's key."""
    service, _, source = str(key).rpartition("/")
    return service.rsplit("/", 1)[-1], source


def watch_tokens(
    session: zenoh.Session, keys: str, on_change: Callable[[str, str, bool], None]
) -> Any:
    """Call `on_change` with the service and source of each liveliness token, and whether it is
    present: now, and on every change.
    """

    def on_token(sample: zenoh.Sample) -> None:
        on_change(*service_and_source(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

    return session.liveliness().declare_subscriber(
        keys, cast("Any", zenoh.handlers.Callback(on_token, indirect=False)), history=True
    )


def alive(
    session: zenoh.Session, keys: Keys = DEFAULT_KEYS, timeout_s: float = _ROUTER_S
) -> Mapping[str, frozenset[str]]:
    """The services with a liveliness token, the router among them, each with the message sources
    of its processes.

    A router that is slow is waited for: it alone knows who is there. One that hangs loses its
    connections, which ends the wait.
    """
    found: dict[str, set[str]] = defaultdict(set)
    for reply in session.liveliness().get(alive_key("*", "*", keys), timeout=timeout_s):
        if reply.ok is not None:
            service, source = service_and_source(reply.ok.key_expr)
            found[service].add(source)
    return {service: frozenset(sources) for service, sources in found.items()}


def nodes_anywhere(session: zenoh.Session, timeout_s: float = 1.0) -> list[GraphPlace]:
    """The nodes of ROS 2's graph in all domains; none where the router does not tell."""
    try:
        replies = session.liveliness().get(NODE_TOKENS, timeout=timeout_s)
        tokens = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
    except zenoh.ZError:
        return []
    return [node for node in map(node_in, tokens) if node is not None]


def watch_sources(
    session: zenoh.Session, on_change: Callable[[str, bool], None], keys: Keys = DEFAULT_KEYS
) -> Any:
    """Call `on_change` with the source of each service and whether it is present: now, and on every
    change. Keep a reference to the returned object. It runs on Zenoh's thread: it must only store.
    """
    return watch_tokens(
        session,
        alive_key("*", "*", keys),
        lambda _, source, is_there: on_change(source, is_there),
    )


def graph_name(service: str) -> str:
    """The name of a service's node. That of the user's tools is hidden, as with ROS 2's own."""
    return f"_mazebot_{service}" if service == EDGE else service


class Held(NamedTuple):
    """An endpoint whose token stands."""

    gid: bytes
    """Its identity in attachments."""
    withdraw: Callable[[], None]


class GraphNode:
    """A node and its publishers and subscribers in ROS 2's graph; on the plain wire there is none.

    A ROS publisher of Lyrical or newer sends images to a subscriber only if it finds its token.
    """

    def __init__(self, session: zenoh.Session, name: str, keys: Keys = DEFAULT_KEYS) -> None:
        """Declare its token."""
        self._session, self._name, self._keys = session, name, keys
        self._number = next(_NUMBERS)
        self._tokens: set[zenoh.LivelinessToken] = set()
        if keys.is_ros:
            self._declare(keys.node_token(str(session.zid()), self._number, name))

    def publishes(self, topic: Topic[M]) -> Callable[[], None]:
        """Declare the token of a publisher; the returned function withdraws it."""
        return self._endpoint(PUBLISHER, topic, None)

    def subscribes(self, topic: Topic[M], type_name: str | None = None) -> Callable[[], None]:
        """Declare the token of a subscriber of a topic, or of another type that the topic takes;
        the returned function withdraws it.
        """
        return self._endpoint(SUBSCRIBER, topic, type_name)

    def _endpoint(self, kind: Kind, topic: Topic[M], type_name: str | None) -> Callable[[], None]:
        if not self._keys.is_ros:
            return lambda: None
        session, number = str(self._session.zid()), next(_NUMBERS)
        return self._declare(
            self._keys.endpoint_token(
                session, self._number, number, self._name, kind, topic, type_name
            )
        )

    def has(self, kind: Kind, name: str, type_name: str, type_hash: str, qos: str) -> Held:
        """Declare the token of an endpoint by its type: of a service, of a topic of an action."""
        session, number = str(self._session.zid()), next(_NUMBERS)
        token = self._keys.typed_token(
            session, self._number, number, self._name, kind, name, type_name, type_hash, qos
        )
        return Held(bytes.fromhex(gid_of(token)), self._declare(token))

    def _declare(self, key: str) -> Callable[[], None]:
        token = self._session.liveliness().declare_token(key)
        self._tokens.add(token)

        def withdraw() -> None:
            if token in self._tokens:
                self._tokens.discard(token)
                token.undeclare()  # type: ignore[no-untyped-call]

        return withdraw

    def close(self) -> None:
        """Withdraw the node with all that it has."""
        while self._tokens:
            self._tokens.pop().undeclare()  # type: ignore[no-untyped-call]


def watch_endpoints(
    session: zenoh.Session,
    tokens: str,
    on_change: Callable[[Endpoint, bool], None],
    keys: Keys = DEFAULT_KEYS,
    of_others: bool = False,
) -> Any:
    """Call `on_change` with each endpoint in ROS 2's graph, and whether it is present: now, and on
    every change. Keep a reference to the returned object. It runs on Zenoh's thread: it must only
    store. `tokens`: the key expression of their tokens; `of_others`: without those of this session.
    """
    own = str(session.zid())

    def on_token(sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        endpoint = keys.endpoint(token)
        if endpoint is not None and not (of_others and own in token.split("/", 4)):
            on_change(endpoint, sample.kind == zenoh.SampleKind.PUT)

    return session.liveliness().declare_subscriber(
        tokens,
        cast("Any", zenoh.handlers.Callback(on_token, indirect=False)),
        history=True,
    )

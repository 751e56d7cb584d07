"""What each role may do on the bus, from the tables of topics, queries, services and actions."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

from mazebot.common.bus.handover import HELD_PREFIX
from mazebot.common.bus.liveliness import ALIVE_PREFIX
from mazebot.common.bus.seats import SEAT_PREFIX, WAKE_PREFIX
from mazebot.common.messages.keys import Keys, types_of
from mazebot.common.messages.topics import (
    CLOCK,
    EDGE,
    QUERIES,
    SERVICES,
    TOPICS,
    Delivery,
    Topic,
    asked_of,
    kept_by,
    owned_by,
    read_by,
)
from mazebot.common.ros.actions import ACTIONS, actions_of
from mazebot.common.ros.interfaces import served_as
from mazebot.common.ros.table import ROS_SERVICES, services_of

ROUTER: Final = "router"
OPERATOR, VIEWER, GRADER = "operator", "viewer", "grader"
AUTONOMY, ROBOT = "autonomy", "robot"
PEOPLE: Final = {
    OPERATOR: "reads topics, calls every service, commands the robot",
    VIEWER: "reads topics and state, and changes nothing",
    GRADER: "as viewer, and always the ground truth",
    AUTONOMY: "as operator, and publishes and answers what localization, mapping, explorer and "
    "navigation do: for a program in their place",
    ROBOT: "as viewer, and publishes and answers what physics does: for a robot or simulator in "
    "its place",
}
"""The roles of people and their programs, and what they may do."""
STANDS_IN_FOR: Final[dict[str, tuple[str, ...]]] = {
    AUTONOMY: ("localization", "mapping", "explorer", "navigation"),
    ROBOT: ("physics",),
}
"""The services in whose place a role may publish and answer."""
_COMMANDS = OPERATOR, AUTONOMY
ROLES: Final = (ROUTER, *SERVICES, *PEOPLE)


def about(role: str) -> str:
    """What a role may do, in a few words."""
    return PEOPLE.get(role, "what this service needs")


_GRAPH = "@ros2_lv"
_ONLY_READS = re.compile(r"(Get|List|Describe)[A-Z]\w*")
"""Types of services that change nothing, by ROS 2's convention."""


class Verb(Enum):
    """What somebody may do with a key. The value: the kinds of messages that the router lets in
    from them, and out to them.
    """

    PUT = (("put",), ("declare_subscriber",))
    SUBSCRIBE = (("declare_subscriber",), ("put",))
    QUERY = (("query",), ("reply", "declare_queryable"))
    ANSWER = (("declare_queryable", "reply"), ("query",))
    ASKED_WITH_ALL = ((), ("query",))
    """Be asked with a wildcard that more than its own keys match. It answers with its own."""
    RESEND = (("reply",), ())
    """Answer with messages under their own key, as the cache of a publisher does."""
    GET_RESENT = ((), ("reply",))
    DECLARE_TOKEN = (("liveliness_token",), ("declare_liveliness_subscriber", "liveliness_query"))
    WATCH_TOKENS = (("declare_liveliness_subscriber", "liveliness_query"), ("liveliness_token",))

    @property
    def text(self) -> str:
        """As on the command line."""
        return self.name.lower().replace("_", "-")


@dataclass(frozen=True)
class Grant:
    """One thing that a role may do, or must not whatever else it may."""

    verb: Verb
    key: str
    """A key expression of Zenoh: requests for all that it includes are granted."""
    why: str
    """The row of a table from which it follows."""
    denies: bool = False


def grants_of(role: str, keys: Keys, operator_sees_truth: bool = True) -> list[Grant]:
    """What a role may do. Without `operator_sees_truth` the topics of the ground truth are for the
    grader alone.

    Raises ValueError for an unknown role.
    """
    if role not in ROLES:
        raise ValueError(f"{role!r}: unknown role: must be one of {', '.join(ROLES)}")
    if role == ROUTER:
        # The guard and the health check sign in with it; the router itself does not.
        return list(_sees_tokens(keys))
    if role in PEOPLE:
        return list(_of_people(role, keys, operator_sees_truth))
    return list(_of_service(role, keys))


def _of_service(name: str, keys: Keys) -> Iterator[Grant]:
    for topic in owned_by(name):
        yield from _publishes(topic, keys, name)
    reads: tuple[Topic[Any], ...] = (CLOCK, *read_by(name), *kept_by(name))
    for topic in dict.fromkeys(reads):
        yield from _subscribes(topic, keys, name)
    yield from _answers(name, keys, name)
    for query in QUERIES:
        if name in query.asked_by:
            yield Grant(Verb.QUERY, keys.of_query(query), f"query {query.name}: {name} asks it")
    yield from _node_tokens(name, keys)
    for prefix, why in (
        (ALIVE_PREFIX, "says that it is alive"), (SEAT_PREFIX, "takes its turn in lockstep")
    ):  # fmt: skip
        yield Grant(Verb.DECLARE_TOKEN, keys.own(f"{prefix}{name}/*"), f"{name} {why}")
    for prefix, why in (
        (HELD_PREFIX, "passes on latched messages"), (SEAT_PREFIX, "takes its turn in lockstep")
    ):  # fmt: skip
        yield Grant(Verb.ANSWER, keys.own(f"{prefix}{name}/*"), f"{name} {why}")
    yield Grant(Verb.PUT, keys.own(f"{WAKE_PREFIX}{name}/*"), f"{name} asks for a turn")
    held = keys.own(f"{HELD_PREFIX}*/*")
    yield Grant(Verb.QUERY, held, f"{name} asks the others for latched messages")
    yield Grant(Verb.ASKED_WITH_ALL, held, f"{name} is asked for latched messages with the others")
    if CLOCK in owned_by(name):
        yield Grant(Verb.QUERY, keys.own(f"{SEAT_PREFIX}*/*"), f"{name} gives turns in lockstep")
        yield Grant(Verb.SUBSCRIBE, keys.own(f"{WAKE_PREFIX}*/*"), f"{name} gives turns")
    yield from _sees_tokens(keys)


def _of_people(role: str, keys: Keys, operator_sees_truth: bool) -> Iterator[Grant]:
    sees_truth = role == GRADER or operator_sees_truth
    for topic in TOPICS:
        if sees_truth or not topic.truth:
            yield from _subscribes(topic, keys, role)
    for name, type_name in _action_topics(None, keys):
        why = f"topic {name}: {role} reads it"
        for key in keys_of(name, type_name, keys):
            yield from _advanced_subscriber(key, why)
    stands_in_for = STANDS_IN_FOR.get(role, ())
    for owner in (*((EDGE,) if role in _COMMANDS else ()), *stands_in_for):
        for topic in owned_by(owner):
            yield from _publishes(topic, keys, role)
            yield _token("MP", topic.name, keys, f"topic {topic.name}: {owner} publishes it")
    for service in stands_in_for:
        yield from _answers(service, keys, role)
        for name, _ in _action_topics(service, keys):
            yield _token("MP", name, keys, f"topic {name}: {service} publishes it")
        for name, _ in _service_types(service, keys):
            yield _token("SS", name, keys, f"service {name}: {service} answers it")
    for query in QUERIES:
        if role in _COMMANDS or query.name.startswith("/get_"):
            yield Grant(Verb.QUERY, keys.of_query(query), f"query {query.name}: {role} asks it")
    for name, type_name in _service_types(None, keys):
        if role in _COMMANDS or _only_reads(name, type_name):
            for key in keys_of(name, type_name, keys):
                yield Grant(Verb.QUERY, key, f"service {name}: {role} calls it")
    for kind in ("NN", "MS", "SC"):
        key = f"{_GRAPH}/{keys.domain_id}/*/*/*/{kind}/**"
        yield Grant(Verb.DECLARE_TOKEN, key, "nodes of people stand in ROS 2's graph")
    for service in [name for name in (ROUTER, *SERVICES) if name not in stands_in_for]:
        for kind in ("NN", "MP", "MS", "SC"):
            key = f"{_GRAPH}/{keys.domain_id}/*/*/*/{kind}/*/*/{service}/**"
            why = f"only {service} may have a node of its name"
            yield Grant(Verb.DECLARE_TOKEN, key, why, denies=True)
    yield from _sees_tokens(keys)


def _only_reads(name: str, type_name: str) -> bool:
    is_action = "/_action/" in name
    return not is_action and _ONLY_READS.fullmatch(type_name.rsplit("/", 1)[1]) is not None


def _publishes(topic: Topic[object], keys: Keys, who: str) -> Iterator[Grant]:
    why = f"topic {topic.name}: {who} publishes it"
    for key in _topic_keys(topic, keys):
        if topic.delivery is Delivery.LATEST:
            yield Grant(Verb.PUT, key, why)
        else:
            yield from _advanced_publisher(key, why)


def _subscribes(topic: Topic[object], keys: Keys, who: str) -> Iterator[Grant]:
    why = f"topic {topic.name}: {who} reads it"
    for key in _topic_keys(topic, keys):
        if topic.delivery is Delivery.LATEST:
            yield Grant(Verb.SUBSCRIBE, key, why)
        else:
            yield from _advanced_subscriber(key, why)


def _advanced_publisher(key: str, why: str) -> Iterator[Grant]:
    """With a cache, which late readers and those that have missed messages query."""
    yield Grant(Verb.PUT, key, why)
    yield Grant(Verb.RESEND, key, why)
    for verb in (Verb.PUT, Verb.ANSWER, Verb.DECLARE_TOKEN, Verb.WATCH_TOKENS):
        yield Grant(verb, f"{key}/@adv/**", why)


def _advanced_subscriber(key: str, why: str) -> Iterator[Grant]:
    yield Grant(Verb.SUBSCRIBE, key, why)
    yield Grant(Verb.GET_RESENT, key, why)
    for verb in (Verb.SUBSCRIBE, Verb.QUERY, Verb.WATCH_TOKENS):
        yield Grant(verb, f"{key}/@adv/**", why)


def _answers(service: str, keys: Keys, who: str) -> Iterator[Grant]:
    for query in asked_of(service):
        yield Grant(Verb.ANSWER, keys.of_query(query), f"query {query.name}: {who} answers it")
    for name, type_name in _service_types(service, keys):
        for key in keys_of(name, type_name, keys):
            yield Grant(Verb.ANSWER, key, f"service {name}: {who} answers it")
    for name, type_name in _action_topics(service, keys):
        why = f"topic {name}: {who} publishes it"
        for key in keys_of(name, type_name, keys):
            yield from _advanced_publisher(key, why)


def _service_types(node: str | None, keys: Keys) -> Iterator[tuple[str, str]]:
    """The name and type of each service of ROS 2 of a node, those of its actions among them; None:
    of all.
    """
    if not keys.is_ros:
        return
    for service in ROS_SERVICES if node is None else services_of(node):
        yield service.name, service.type
    for action in ACTIONS if node is None else actions_of(node):
        yield from action.services.items()


def _action_topics(node: str | None, keys: Keys) -> Iterator[tuple[str, str]]:
    if keys.is_ros:
        for action in ACTIONS if node is None else actions_of(node):
            yield from action.topics.items()


def _node_tokens(name: str, keys: Keys) -> Iterator[Grant]:
    if keys.is_ros:
        key = f"{_GRAPH}/{keys.domain_id}/*/*/*/*/*/*/{name}/**"
        yield Grant(Verb.DECLARE_TOKEN, key, f"node {name} stands in ROS 2's graph")


def _token(kind: str, name: str, keys: Keys, why: str) -> Grant:
    """Of a publisher (MP) or a service (SS) in ROS 2's graph, by whatever node."""
    mangled = f"/{keys.prefix}{name.removeprefix('/')}".replace("/", "%")
    return Grant(
        Verb.DECLARE_TOKEN, f"{_GRAPH}/{keys.domain_id}/*/*/*/{kind}/*/*/*/{mangled}/**", why
    )


def _sees_tokens(keys: Keys) -> Iterator[Grant]:
    for key in (keys.own(f"{ALIVE_PREFIX}**"), keys.own(f"{SEAT_PREFIX}**"), f"{_GRAPH}/**"):
        yield Grant(Verb.WATCH_TOKENS, key, "everyone sees who is there")


def _topic_keys(topic: Topic[object], keys: Keys) -> list[str]:
    return list(dict.fromkeys(keys.of_topic(topic, kind) for kind in types_of(topic)))


def keys_of(name: str, type_name: str, keys: Keys) -> list[str]:
    """Of a service of ROS 2, in each form in which it is answered, or of a topic of an action."""
    return [
        keys.typed(name, type_name, types.hash_of(type_name))
        for types in served_as(type_name, keys.distro)
    ]

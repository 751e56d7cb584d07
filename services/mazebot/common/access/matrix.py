"""Who may do what, as a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from mazebot.common.access.grants import PEOPLE, ROLES, ROUTER, Verb, grants_of, keys_of
from mazebot.common.access.rules import decide
from mazebot.common.messages.keys import Keys, types_of
from mazebot.common.messages.topics import QUERIES, SERVICES, TOPICS
from mazebot.common.ros.actions import ACTIONS
from mazebot.common.ros.table import ROS_SERVICES

_EVERYONE = {role for role in ROLES if role != ROUTER}


class Named(NamedTuple):
    """A topic, a query, or a service or topic of ROS 2, and its keys."""

    name: str
    keys: tuple[str, ...]
    """One for each type that it takes."""
    is_topic: bool


class Row(NamedTuple):
    """Who may do what with one name."""

    name: str
    roles: dict[Verb, list[str]]


def named(keys: Keys) -> list[Named]:
    """All that has a name on the bus."""
    found = [
        Named(topic.name, tuple(keys.of_topic(topic, kind) for kind in types_of(topic)), True)
        for topic in TOPICS
    ]
    found += [Named(query.name, (keys.of_query(query),), False) for query in QUERIES]
    if keys.is_ros:
        services = {service.name: service.type for service in ROS_SERVICES}
        topics: dict[str, str] = {}
        for action in ACTIONS:
            services |= action.services
            topics |= action.topics
        for types, is_topic in ((services, False), (topics, True)):
            for name, kind in types.items():
                found.append(Named(name, tuple(keys_of(name, kind, keys)), is_topic))
    return found


def matrix(keys: Keys, operator_sees_truth: bool = True) -> Iterator[Row]:
    """Each name, in order, with the roles that may use it: a query of Mazebot's own and the service
    of ROS 2 with its name are for the same roles.
    """
    grants = {role: grants_of(role, keys, operator_sees_truth) for role in _EVERYONE}
    by_name = {one.name: one for one in sorted(named(keys))}
    for name, its_keys, is_topic in by_name.values():
        verbs = (Verb.PUT, Verb.SUBSCRIBE) if is_topic else (Verb.QUERY, Verb.ANSWER)
        yield Row(
            name,
            {
                verb: [
                    role
                    for role in ROLES
                    if role in grants and decide(grants[role], verb, its_keys[0]).is_granted
                ]
                for verb in verbs
            },
        )


def in_short(roles: Sequence[str]) -> str:
    """Roles in words: all services, and all people, by one word."""
    left = set(roles)
    words = []
    for group, word in ((set(SERVICES), "every service"), (set(PEOPLE), "people")):
        if group <= left:
            words.append(word)
            left -= group
    return ", ".join([*(role for role in roles if role in left), *words]) or "-"

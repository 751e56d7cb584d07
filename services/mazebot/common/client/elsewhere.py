"""Where services run that are not in this shell's domain and namespace."""

from __future__ import annotations

from collections.abc import Container, Iterable
from typing import NamedTuple

from mazebot.common.messages.keys import GraphPlace, Keys


class Place(NamedTuple):
    """A namespace in a domain."""

    domain: str
    namespace: str
    """Such as `/bot1`; empty: none."""


class Difference(NamedTuple):
    """In what another place is not this shell's."""

    here: str
    there: str
    setting: str
    """What would make it the same."""


def place_of(keys: Keys) -> Place:
    """Where a stack with these keys is."""
    return Place(str(keys.domain_id), f"/{keys.prefix}".rstrip("/"))


def places_of(nodes: Iterable[GraphPlace], services: Container[str]) -> list[Place]:
    """Where nodes with the names of some services are, each place once."""
    found = {
        Place(node.domain, namespace)
        for node in nodes
        for namespace, _, name in [node.name.rpartition("/")]
        if name in services
    }
    return sorted(found)


def differences(place: Place, keys: Keys) -> list[Difference]:
    """How a place is reached from that of some keys."""
    here, empty = place_of(keys), "''"
    found = []
    if not keys.is_ros:
        found.append(
            Difference("on the wire plain", "on the wire rmw_zenoh", "MAZEBOT_BUS_WIRE=rmw_zenoh"),
        )
    if place.domain != here.domain:
        found.append(
            Difference(
                f"in domain {here.domain}",
                f"in domain {place.domain}",
                f"ROS_DOMAIN_ID={place.domain}",
            )
        )
    if place.namespace != here.namespace:
        found.append(
            Difference(
                f"in namespace {here.namespace or '/'}", f"in namespace {place.namespace or '/'}",
                f"MAZEBOT_BUS_PREFIX={place.namespace.removeprefix('/') or empty}",
            )
        )  # fmt: skip
    return found


def elsewhere(nodes: Iterable[GraphPlace], services: Container[str], keys: Keys) -> str:
    """How to reach any of some services that run, but not here, after a semicolon; empty: none
    runs, or one does here.
    """
    ways = [differences(place, keys) for place in places_of(nodes, services)]
    if not all(ways):
        return ""
    texts = [
        f"{' and '.join(one.there for one in way)} ({' '.join(one.setting for one in way)})"
        for way in ways
    ]
    return f"; one runs {' or '.join(texts)}" if texts else ""

"""`mazebot doctor --ros`: how ROS 2 joins the stack from this machine, and what is in the way."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from mazebot.cli.parsing.options import print_json
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import graph_name
from mazebot.common.client.elsewhere import differences, places_of
from mazebot.common.client.robot import HOW_TO_START
from mazebot.common.files.key_file import Key, sign_in
from mazebot.common.messages.keys import (
    ALL_TOKENS,
    CLIENT,
    PUBLISHER,
    SERVICE,
    SUBSCRIBER,
    Endpoint,
    GraphPlace,
    Keys,
    node_in,
)
from mazebot.common.messages.topics import CMD_VEL, EDGE, PARAMETER_EVENTS, SERVICES, TOPICS
from mazebot.common.ros.actions import ACTIONS
from mazebot.common.ros.definitions import DISTROS
from mazebot.common.ros.interfaces import interfaces, served_as
from mazebot.common.ros.table import ROS_SERVICES

RMW = "rmw_zenoh_cpp"
TIMEOUT_S = 3.0
_USER, _PASSWORD = "transport/auth/usrpwd/user", "transport/auth/usrpwd/password"


@dataclass
class Diagnosis:
    """What `mazebot doctor --ros` tells."""

    exports: dict[str, str]
    """The environment in which ROS 2 joins."""
    found: str = ""
    """What is there, in one line."""
    wrong: list[str] = field(default_factory=list)
    """What is in the way, each in one line that says what would be right."""


def doctor(config: BusConfig, environment: Mapping[str, str], as_json: bool) -> int:
    """Print the diagnosis; returns the exit code: 1 where anything is wrong."""
    # It takes long to load.
    from mazebot.common.bus.session import BusUnavailableError  # noqa: PLC0415

    try:
        diagnosis = diagnose(config, environment, *_look(config))
    except BusUnavailableError as error:
        diagnosis = Diagnosis(exports_for(config), wrong=_wrong_in(environment, config))
        diagnosis.wrong.append(f"{error}: start a stack: {HOW_TO_START}")
    if as_json:
        exports, wrong = diagnosis.exports, diagnosis.wrong
        print_json({"exports": exports, "found": diagnosis.found, "wrong": wrong})
    else:
        sys.stdout.write(_text(diagnosis, config.distro))
    return 1 if diagnosis.wrong else 0


def _look(config: BusConfig) -> tuple[list[str], Key | None]:
    """The tokens of ROS 2's graph in all domains, and the key that the router asks for.

    Raises BusUnavailableError.
    """
    from mazebot.common.bus.session import join  # noqa: PLC0415

    session, key = join(config)
    try:
        replies = session.liveliness().get(ALL_TOKENS, timeout=TIMEOUT_S)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None], key
    finally:
        session.close()  # type: ignore[no-untyped-call]


def exports_for(config: BusConfig, key: Key | None = None) -> dict[str, str]:
    """The environment in which ROS 2 joins the stack, signed in with a key."""
    override = f'connect/endpoints=["{config.connect}"]'
    if key is not None:
        # Two peers would talk past the router and its rules.
        settings = {"mode": "client"} | {
            f"{path}/{field}": value
            for path, fields in sign_in(key, config.connect).items()
            for field, value in fields.items()
        }
        override += "".join(f";{name}={json.dumps(value)}" for name, value in settings.items())
    return {
        "RMW_IMPLEMENTATION": RMW,
        "ZENOH_CONFIG_OVERRIDE": override,
        "ROS_DOMAIN_ID": str(config.domain_id),
    }


def diagnose(
    config: BusConfig,
    environment: Mapping[str, str],
    tokens: Iterable[str],
    key: Key | None = None,
) -> Diagnosis:
    """What is right and wrong.

    Args:
        config: the settings of the bus.
        environment: of the shell, in which ROS 2 may be set up.
        tokens: of ROS 2's graph, in any domain.
        key: with which the router lets tools in, if it asks for one.
    """
    diagnosis = Diagnosis(exports_for(config, key))
    wrong = diagnosis.wrong
    wrong += _wrong_in(environment, config, key)
    if not config.keys.is_ros:
        wrong.append("bus.wire: plain: must be rmw_zenoh, in the stack and here")
        return diagnosis
    tokens = list(tokens)
    nodes = [node for node in map(node_in, tokens) if node is not None]
    ours, others = _sorted_out(nodes, config.keys)
    wrong += _wrong_places(nodes, ours, config)
    wrong += [
        f"{name} is there {count} times: two stacks in one domain need a namespace each "
        "(MAZEBOT_BUS_PREFIX)"
        for name, count in Counter(node.name for node in ours).items()
        if count > 1
    ]
    names = {node.name for node in ours} | {f"{_namespace(config.keys)}/{graph_name(EDGE)}"}
    endpoints = [end for end in map(config.keys.endpoint, tokens) if end is not None]
    wrong += _wrong_types([end for end in endpoints if end.node not in names], config.keys)
    wrong += _rivals(endpoints, names, config.keys)
    stacks = Counter(node.name.rpartition("/")[0] or "/" for node in others if _is_service(node))
    diagnosis.found = (
        f"router at {config.connect}, domain {config.domain_id}: {len(ours)} nodes of Mazebot, "
        + "".join(f"{count} of Mazebot in {where}, " for where, count in sorted(stacks.items()))
        + f"{len(others) - stacks.total()} of others"
    )
    return diagnosis


def _wrong_in(
    environment: Mapping[str, str], config: BusConfig, key: Key | None = None
) -> list[str]:
    wrong = []
    distro, rmw = environment.get("ROS_DISTRO"), environment.get("RMW_IMPLEMENTATION")
    if rmw not in (None, "", RMW) or (not rmw and distro):
        wrong.append(
            f"RMW_IMPLEMENTATION: {rmw or 'not set'}: must be {RMW}, or let "
            "`docker compose up ros2-bridge` carry everything to DDS"
        )
    if distro and distro not in DISTROS and distro < "jazzy":
        wrong.append(f"ROS_DISTRO: {distro}: must be jazzy or newer: its keys have no type hashes")
    elif distro in DISTROS and distro != config.distro:
        wrong.append(
            f"ROS_DISTRO: {distro}: services and actions have the types of {config.distro}: start "
            f"the stack with MAZEBOT_BUS_DISTRO={distro}"
        )
    override = environment.get("ZENOH_CONFIG_OVERRIDE", "")
    if (override or distro) and config.connect not in re.findall(r"\w+/[^\"',\]\s]+", override):
        wrong.append(
            f"ZENOH_CONFIG_OVERRIDE: {override[:120] or 'not set'}: must have "
            f'connect/endpoints=["{config.connect}"]'
        )
    elif override and key is not None and _USER not in override:
        wrong.append(f"ZENOH_CONFIG_OVERRIDE: must have {_USER} and {_PASSWORD}: the router asks")
    domain = environment.get("ROS_DOMAIN_ID") or "0"
    if domain != str(config.domain_id):
        wrong.append(
            f"ROS_DOMAIN_ID: {domain}: must be {config.domain_id}, as MAZEBOT_BUS_DOMAIN_ID"
        )
    return wrong


def _namespace(keys: Keys) -> str:
    return f"/{keys.prefix}".rstrip("/")


def _sorted_out(
    nodes: Iterable[GraphPlace], keys: Keys
) -> tuple[list[GraphPlace], list[GraphPlace]]:
    """The stack's nodes in its domain, and those of others there; tools are hidden."""
    names = {f"{_namespace(keys)}/{service}" for service in SERVICES}
    here = [
        node
        for node in nodes
        if node.domain == str(keys.domain_id) and not node.name.rpartition("/")[2].startswith("_")
    ]
    return (
        [node for node in here if node.name in names],
        [node for node in here if node.name not in names],
    )


def _is_service(node: GraphPlace) -> bool:
    """Whether it is a node of some stack, by its name."""
    return node.name.rpartition("/")[2] in SERVICES


def _wrong_places(
    nodes: Iterable[GraphPlace], ours: Iterable[GraphPlace], config: BusConfig
) -> list[str]:
    """Stacks that are looked for in another domain or namespace than theirs, and nodes of others in
    a domain without a stack.
    """
    nodes, keys = list(nodes), config.keys
    stacks = places_of(nodes, SERVICES)
    if not list(ours):
        ways = [differences(place, keys) for place in stacks]
        nearest = min(ways, key=len, default=None)
        if nearest is None:
            return [
                f"no node of Mazebot in domain {config.domain_id} at {config.connect}: start a "
                f"stack: {HOW_TO_START}"
            ]
        here, there, settings = (
            " and ".join(parts) for parts in zip(*nearest, strict=True)
        )  # fmt: skip
        return [f"no node of Mazebot {here}, but {there}: must be {settings}"]
    elsewhere: dict[str, list[str]] = defaultdict(list)
    for node in nodes:
        elsewhere[node.domain].append(node.name)
    occupied = {place.domain for place in stacks}
    return [
        f"{', '.join(sorted(names)[:5])}: in domain {domain}: must be in {config.domain_id}, or "
        "else be of another stack"
        for domain, names in elsewhere.items()
        if domain not in occupied
    ]


def _wrong_types(foreign: Iterable[Endpoint], keys: Keys) -> list[str]:
    """Endpoints of others on our names whose types or hashes are not ours."""
    wrong = []
    services = _types_of_services(keys)
    for end in foreign:
        topic = keys.topic_with(end)
        if end.kind in (PUBLISHER, SUBSCRIBER) and topic is not None:
            misfit = end.misfit(topic)
            fate = "is heard by nobody" if end.kind == PUBLISHER else "hears nothing"
            if misfit:
                wrong.append(f"{end.name} of {end.node} {fate}: {misfit}")
        elif end.kind in (CLIENT, SERVICE) and end.name in services:
            kind = services[end.name]
            answered = [types.hash_of(kind) for types in served_as(kind, keys.distro)]
            if end.type_name != kind:
                wrong.append(f"{end.name} of {end.node}: {end.type_name}: must be {kind}")
            elif end.type_hash not in answered:
                fits = [one for one in DISTROS if interfaces(one).hash_of(kind) == end.type_hash]
                hint = f": must be bus.distro={fits[0]}" if fits else ""
                wrong.append(
                    f"{end.name} of {end.node}: {kind} with the hash {end.type_hash}: the stack "
                    f"has {answered[0]}, that of {keys.distro}{hint}"
                )
    return wrong


def _types_of_services(keys: Keys) -> dict[str, str]:
    """By name with its namespace: the type of each service, those of actions among them."""
    found = {service.name: service.type for service in ROS_SERVICES}
    for action in ACTIONS:
        base = f"{action.name}/_action"
        found[f"{base}/send_goal"] = f"{action.type}_SendGoal"
        found[f"{base}/get_result"] = f"{action.type}_GetResult"
    return {f"{_namespace(keys)}{name}": kind for name, kind in found.items()}


def _rivals(endpoints: Iterable[Endpoint], ours: set[str], keys: Keys) -> list[str]:
    """Topics with a publisher of ours and one of others; of velocities with two of others."""
    publishers: dict[str, set[str]] = defaultdict(set)
    for end in endpoints:
        if end.kind == PUBLISHER:
            publishers[end.name].add(end.node)
    wrong = []
    for topic in TOPICS:
        name = f"{_namespace(keys)}{topic.name}"
        foreign = sorted(publishers[name] - ours)
        own = sorted(publishers[name] & ours)
        is_open = EDGE in topic.owners or len(topic.owners) > 2 or topic is PARAMETER_EVENTS
        if (topic is CMD_VEL and len(foreign) > 1) or (foreign and own and not is_open):
            names = ", ".join([*own, *foreign])
            wrong.append(f"{name} has several publishers: {names}: must be one")
    return wrong


def _text(diagnosis: Diagnosis, distro: str) -> str:
    lines = [f"# in a shell with ROS 2 ({distro}) and ros-{distro}-rmw-zenoh-cpp:"]
    for name, value in diagnosis.exports.items():
        quoted = f"'{value}'" if '"' in value else value
        lines.append(f"export {name}={quoted}")
    lines += ["ros2 daemon stop", ""]
    if diagnosis.found:
        lines.append(f"found: {diagnosis.found}")
    lines += [f"wrong: {each}" for each in diagnosis.wrong] or ["nothing is wrong"]
    return "\n".join(lines) + "\n"

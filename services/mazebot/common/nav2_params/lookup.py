"""Finds the parameters of a file in the tables of those of Nav2."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache

from mazebot.common.nav2_params.entry import (
    Entry,
    child_of,
    joined_notes,
    kind_of,
    listed_names,
    wrapped_class,
)
from mazebot.common.nav2_params.observation_sources import lidars, why_not_taken
from mazebot.common.nav2_params.parameter import OWN_NAME, Group, Namespace, Value
from mazebot.common.nav2_params.tables.every_node import EVERY_NODE, PREFIXES
from mazebot.common.nav2_params.tables.nodes import NODES
from mazebot.common.nav2_params.tables.others import OTHER_PACKAGES
from mazebot.common.nav2_params.yaml_leaves import is_pattern

_MOST_HOMES = 2


def known(entry: Entry, node: Namespace | None, values: Mapping[str, Value]) -> Entry:
    """The entry with what is known of it."""
    if entry.knowledge == "gone":
        return entry
    if entry.name in EVERY_NODE.parameters:
        row = EVERY_NODE.parameters[entry.name]
        return dataclasses.replace(entry, parameter=row, place=EVERY_NODE.place)
    if entry.name.startswith(PREFIXES):
        return _unread(entry, "read by ROS 2 itself")
    if node is None:
        if is_pattern(entry.node):
            note = f"no node of Nav2 that matches has such a parameter{_home(entry)}"
        else:
            near = get_close_matches(entry.node, NODES, 1, 0.7)
            note = "not a node of Nav2"
            if entry.node in OTHER_PACKAGES:
                note += f" but of {OTHER_PACKAGES[entry.node]}"
            else:
                note += f"; did you mean {near[0]}?" if near else _home(entry)
        return dataclasses.replace(entry, knowledge="unknown", note=joined_notes(entry.note, note))
    return _found(entry, node, entry.name, "", node.place, values)


def _found(
    entry: Entry, space: Namespace, name: str, prefix: str, place: str, values: Mapping[str, Value]
) -> Entry:
    row = space.parameters.get(name)
    if row is not None:
        group = next((one for one in space.groups if one.lister == name), None)
        note = joined_notes(entry.note, row.note or space.note)
        if group is not None:
            note = joined_notes(note, _of_list(group, prefix, values))
        return dataclasses.replace(entry, parameter=row, place=place, group=group, note=note)
    head, _, rest = name.partition(".")
    inner = f"{prefix}{head}"
    # A name that one parameter lists may look like those of another.
    for group in sorted(
        space.groups, key=lambda one: head not in listed_names(one, prefix, values)
    ):
        listed = listed_names(group, prefix, values)
        kind = kind_of(group, inner, head, values)
        child = child_of(group, kind, inner, values)
        if head not in listed:
            if not _would_be(group, child, head, rest, inner, values):
                continue
            why = f"{head} is not in {group.lister}: Nav2 does not read it either"
        else:
            why = _left_out(group, listed, head, rest, prefix, values)
        where = _below(place, child.place).replace("*", head) if child else place
        entry = dataclasses.replace(entry, instance=head)
        if rest == "plugin" and group.key == "plugin":
            *_, differs = group.implied.get(kind, ("",))
            found = dataclasses.replace(
                entry, knowledge="plugin", group=group, value=kind, place=where,
                note=joined_notes(entry.note, differs),
            )  # fmt: skip
        elif rest and rest == group.wraps.get(kind):
            found = dataclasses.replace(
                entry, knowledge="plugin", group=group, place=where,
                value=wrapped_class(group, kind, inner, values),
                note=joined_notes(entry.note, f"{rest} up to Kilted, now {rest}.plugin"),
            )  # fmt: skip
        elif child is None and kind and group.others and rest in group.others.parameters:
            where = f"{place}.{group.others.place}"
            found = _found(entry, group.others, rest, f"{inner}.", where, values)
        elif child is None:
            why = f"{kind} is not supported" if kind else f"{head}.{group.key} is missing"
            found = entry
        else:
            found = _found(entry, child, rest, f"{inner}.", where, values)
            other = wrapped_class(group, kind, inner, values)
            if found.knowledge == "unknown" and other and other not in group.kinds:
                # It may be one of the other plugin, which shares the namespace.
                found, why = entry, why or f"{other} is not supported"
        return _unread(found, why) if why and found.knowledge != "unknown" else found
    near = get_close_matches(name, space.parameters, 1, 0.6)
    hint = f"; did you mean {prefix}{near[0]}?" if near else _home(entry)
    note = joined_notes(entry.note, f"Nav2 has no such parameter and ignores it{hint}")
    return dataclasses.replace(entry, knowledge="unknown", note=note)


def _below(place: str, name: str) -> str:
    return f"{place}.{name}" if name else place


def _of_list(group: Group, prefix: str, values: Mapping[str, Value]) -> str:
    """What Nav2 would not do with the plugins or sensors that a parameter lists."""
    listed = listed_names(group, prefix, values)
    if group.sensors and not lidars(listed, prefix, values):
        return "the lidar is not among them: here it always is"
    if group.key != "plugin":
        return ""
    notes = []
    # Nav2's default classes are those of its default list alone.
    if listed != list(group.defaults):
        missing = [one for one in listed if f"{prefix}{one}.plugin" not in values]
        if missing:
            which = ", ".join(f"{one}.plugin" for one in missing)
            notes.append(f"{which} is missing: Nav2 does not start without it")
    kinds = [kind_of(group, f"{prefix}{one}", one, values) for one in listed]
    if group.last in kinds and kinds[-1] != group.last:
        at = kinds.index(group.last)
        after = [one for one, kind in zip(listed[at:], kinds[at:], strict=True)
                 if kind != group.last]  # fmt: skip
        if after:
            notes.append(
                f"{listed[at]} should be the last: in Nav2 what {', '.join(after)} marks is not "
                "inflated; here it is"
            )
    notes += [
        f"lists no {alike[0]}: there is always one here"
        for alike in group.always
        if not set(alike) & set(kinds)
    ]
    return "; ".join(notes)


@cache
def _homes() -> Mapping[str, tuple[str, ...]]:
    """Where Nav2 has a parameter, by the last part of its name."""
    found: dict[str, list[str]] = {}

    def walk(space: Namespace, prefix: str) -> None:
        for name in space.parameters:
            found.setdefault(name.rpartition(".")[2], []).append(f"{prefix}{name}")
        for group in space.groups:
            for instance, kind in group.defaults.items():
                if kind in group.kinds:
                    walk(group.kinds[kind], f"{prefix}{instance}.")

    for node, space in NODES.items():
        walk(space, f"{node}.")
    return {last: tuple(names) for last, names in found.items()}


def _home(entry: Entry) -> str:
    """The hint for a parameter that stands in the wrong place; "": there is none."""
    *_, last = entry.name.split(".")
    homes = _homes().get(last, ())
    homes = tuple(home for home in homes if home.startswith(f"{entry.node}.")) or homes
    if not 0 < len(homes) <= _MOST_HOMES:
        return ""
    return f"; it is a parameter at {' and '.join(homes)}"


def _would_be(
    group: Group,
    child: Namespace | None,
    head: str,
    rest: str,
    inner: str,
    values: Mapping[str, Value],
) -> bool:
    """Whether a namespace that is not listed is one of the group's."""
    if child is None or not rest:
        return False
    if group.key in {"", OWN_NAME}:
        return group.key == OWN_NAME or rest in child.parameters
    return head in group.defaults or f"{inner}.{group.key}" in values


def _left_out(
    group: Group, listed: list[str], head: str, rest: str, prefix: str, values: Mapping[str, Value]
) -> str:
    """Why a parameter of a listed name is not taken; empty: it is."""
    if group.sensors:
        return why_not_taken(listed, head, rest, prefix, values)
    if group.key != "plugin":
        return ""
    same = [
        one
        for one in listed
        if group.setting
        or _place(group, one, prefix, values) == _place(group, head, prefix, values)
    ]
    seeing = [one for one in same if _has_the_lidar(group, one, prefix, values)]
    used = (seeing or same)[0]
    first = "the first" if group.setting else "the first of its kind"
    first += " with the lidar" if used != same[0] else ""
    return "" if used == head else f"only {used}, {first} in {group.lister}, is used"


def _has_the_lidar(group: Group, instance: str, prefix: str, values: Mapping[str, Value]) -> bool:
    """Whether a plugin has no sensors of its own, or the lidar among them."""
    space = f"{prefix}{instance}"
    child = group.kinds.get(kind_of(group, space, instance, values))
    sensors = [inner for inner in child.groups if inner.sensors] if child else []
    return not sensors or any(
        lidars(listed_names(inner, f"{space}.", values), f"{space}.", values) for inner in sensors
    )


def _place(group: Group, instance: str, prefix: str, values: Mapping[str, Value]) -> str:
    child = group.kinds.get(kind_of(group, f"{prefix}{instance}", instance, values))
    return child.place if child else instance


def _unread(entry: Entry, why: str) -> Entry:
    """The entry as one that is only checked."""
    return dataclasses.replace(entry, knowledge="unread", note=joined_notes(entry.note, why))

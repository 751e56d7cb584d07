"""Gives the parameters of a file today's names and values."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

from mazebot.common.nav2_params.entry import (
    Entry,
    NodeEntries,
    listed_names,
    short_class,
    wrapped_class,
)
from mazebot.common.nav2_params.parameter import Value
from mazebot.common.nav2_params.renames import CLASS_RENAMES, RENAMES, UNCHANGED, Rename, convert
from mazebot.common.nav2_params.tables.nodes import NODES
from mazebot.common.nav2_params.yaml_leaves import Leaf

_NAMESPACE = "<robot_namespace>"
"""What Nav2's launch files for several robots replace by the namespace of one."""


def value_of_today(leaf: Leaf) -> Value:
    """The value; of a plugin, its class as it is written and named today; of a topic, its name
    within the node's namespace.
    """
    last = leaf.name.rpartition(".")[2]
    if not isinstance(leaf.value, str):
        return leaf.value
    if "topic" in last.split("_"):
        return _within_namespace(leaf.value, leaf.namespace)
    if last not in {"plugin", "primary_controller"}:
        return leaf.value
    name = leaf.value.replace("/", "::")
    for old, new in CLASS_RENAMES.items():
        if name.startswith(old):
            return new + name.removeprefix(old)
    return name


def _within_namespace(topic: str, namespace: str) -> str:
    """A topic without the node's namespace, or what launch files replace by it."""
    for prefix in (_NAMESPACE, f"/{_NAMESPACE}", namespace):
        if prefix and topic.startswith(f"{prefix}/"):
            return topic.removeprefix(f"{prefix}/")
    return topic


def rename_entries(node_name: str, node: NodeEntries) -> None:
    """Give the entries of a node today's names and values."""
    values = node.values
    classes: dict[str, tuple[str, ...]] = {
        entry.name.removesuffix(".plugin"): (short_class(entry.value),)
        for entry in node.entries
        if entry.name.endswith(".plugin")
    }
    for group in NODES[node_name].groups if node_name in NODES else ():
        # A plugin of Nav2's default needs no class in the file.
        for instance in listed_names(group, "", values):
            if instance in group.defaults:
                classes.setdefault(instance, (group.defaults[instance],))
        for space, (plugin, *_) in classes.items():
            wrapped = wrapped_class(group, plugin, space, values)
            if wrapped:
                classes[space] = (plugin, wrapped)
    for at, entry in enumerate(node.entries):
        for rename in RENAMES:
            new = _new_name(rename, node_name, entry.name, classes)
            if new is None:
                continue
            value = convert(rename.convert, entry.value)
            if value is UNCHANGED:
                continue
            node.entries[at] = _renamed(entry, rename, new, value, values)
            break


def _renamed(
    entry: Entry, rename: Rename, new: str, value: Value, values: Mapping[str, Value]
) -> Entry:
    parts = [entry.note, rename.note]
    if not new:
        note = "; ".join(part for part in (*parts, f"removed after {rename.until}") if part)
        return dataclasses.replace(entry, knowledge="gone", note=note)
    if new != entry.name and new in values:
        note = f"{new} is also given, and is used"
        return dataclasses.replace(entry, knowledge="gone", note=note)
    old = entry.name.rpartition(".")[2] if new != entry.name else entry.value
    parts.insert(1, f"{old} up to {rename.until}, now {new if new != entry.name else value}")
    note = "; ".join(part for part in parts if part)
    return dataclasses.replace(entry, name=new, value=value, renamed=True, note=note)


def _new_name(
    rename: Rename, node: str, name: str, classes: Mapping[str, tuple[str, ...]]
) -> str | None:
    """Today's full name of a parameter, "" where it is gone; None: the row is of another one."""
    if rename.node not in {"", node}:
        return None
    if rename.old.startswith("*."):
        space, _, last = name.rpartition(".")
        fits = bool(space) and last == rename.old[2:]
        return f"{space}.{rename.new[2:]}" if fits else None
    space, old = "", name
    if rename.plugin:
        spaces = [one for one, plugin in classes.items() if rename.plugin in plugin]
        space = next((one for one in spaces if name.startswith(f"{one}.")), "")
        if not space:
            return None
        old = name.removeprefix(f"{space}.")
    if not fnmatchcase(old, rename.old):
        return None
    if not rename.new or not rename.new.startswith("/"):
        return f"{space}.{rename.new}" if space and rename.new else rename.new
    plugin, _, rest = rename.new.removeprefix("/{").partition("}")
    return _space_of(plugin.split(","), node, classes) + rest


def _space_of(plugins: Sequence[str], node: str, classes: Mapping[str, tuple[str, ...]]) -> str:
    """The namespace of the plugin of one of these classes: that of the file, or Nav2's default."""
    for space, given in classes.items():
        if not set(given).isdisjoint(plugins):
            return space
    for group in NODES[node].groups:
        for space, found in group.defaults.items():
            if found in plugins:
                return space
    return plugins[0]

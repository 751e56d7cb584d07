"""A parameter of a file, and the namespaces of its node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from mazebot.common.nav2_params.parameter import (
    OWN_NAME,
    Group,
    Namespace,
    Parameter,
    Value,
    joined,
)
from mazebot.common.nav2_params.yaml_leaves import Leaf

Knowledge = Literal["parameter", "plugin", "unread", "gone", "unknown"]
"""A parameter; the class of a plugin; one that Nav2 does not read either, such as that of a plugin
that is not listed; one that is gone from Nav2; or none of Nav2."""


@dataclass(frozen=True)
class Entry:
    """A parameter of the file."""

    leaf: Leaf
    """As it stands in the file."""
    node: str
    """Today's names."""
    name: str
    value: Value
    """Of the parameter's kind; of a plugin, the last part of its class."""
    knowledge: Knowledge
    place: str = ""
    """The section with its setting."""
    parameter: Parameter | None = None
    group: Group | None = None
    """Of a plugin, or of a parameter that lists names: the group."""
    instance: str = ""
    """The name of the innermost namespace that a parameter lists, such as `FollowPath`."""
    renamed: bool = False
    unresolved: bool = False
    """The value is filled in by a launch file: here it is false, or Nav2's default."""
    note: str = ""

    @property
    def full_name(self) -> str:
        """Node and name as the file has them."""
        return f"{self.leaf.node}.{self.leaf.name}"


@dataclass
class NodeEntries:
    """The leaves of one node under today's names."""

    entries: list[Entry] = field(default_factory=list)

    @property
    def values(self) -> dict[str, Value]:
        """The value of each name."""
        return {entry.name: entry.value for entry in self.entries if entry.knowledge != "gone"}


def listed_names(group: Group, prefix: str, values: Mapping[str, Value]) -> list[str]:
    """The names that the parameter of a group lists."""
    listed = values.get(f"{prefix}{group.lister}")
    if isinstance(listed, str):
        return listed.split()
    if isinstance(listed, list):
        return [str(one) for one in listed]
    return list(group.defaults)


def kind_of(group: Group, space: str, instance: str, values: Mapping[str, Value]) -> str:
    """The last part of the class of a namespace; "" where the file does not say."""
    if group.key == OWN_NAME:
        return instance
    if not group.key:
        return ""
    return short_class(values.get(f"{space}.{group.key}", group.defaults.get(instance, "")))


def child_of(group: Group, kind: str, space: str, values: Mapping[str, Value]) -> Namespace | None:
    """The namespace of a kind; None: there is none such.

    `space` is its name in the file. A plugin that stands before another one shares it.
    """
    child = group.kinds.get(kind)
    other = group.wraps.get(kind)
    if child is None or other is None:
        return child
    nested = short_class(values.get(f"{space}.{other}.plugin", ""))
    wrapped = wrapped_class(group, kind, space, values)
    child = group.before.get(nested or wrapped, child)
    (inner,) = child.groups
    primary = inner.kinds.get(wrapped, inner.others if wrapped else None)
    return joined(child, primary) if primary is not None else child


def wrapped_class(group: Group, kind: str, space: str, values: Mapping[str, Value]) -> str:
    """The class of the plugin that one of a kind stands before and shares its namespace with, as
    the rotation shim does; "": there is none.
    """
    return short_class(values.get(f"{space}.{group.wraps.get(kind, '')}", ""))


def short_class(plugin: Value) -> str:
    """The last part of a class's name."""
    return str(plugin).replace("/", "::").rpartition("::")[2]


def joined_notes(first: str, second: str) -> str:
    """Both notes in one; either may be empty."""
    return "; ".join(part for part in (first, second) if part)

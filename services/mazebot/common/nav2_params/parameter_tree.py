"""The parameters of a node, nested, over Nav2's defaults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from mazebot.common.nav2_params.entry import Entry, NodeEntries, child_of, kind_of, listed_names
from mazebot.common.nav2_params.parameter import Namespace, Value
from mazebot.common.nav2_params.tables.nodes import NODES


def tree_of(name: str, node: NodeEntries, entries: Sequence[Entry]) -> Mapping[str, Value]:
    """The parameters of a node, nested: Nav2's defaults, and over them the file's values.

    `entries` are those of the node with what is known of each.
    """
    tree: dict[str, Value] = {}
    if name in NODES:
        for path, value in _defaults(NODES[name], "", node.values):
            _put(tree, path, value)
    for before, entry in zip(node.entries, entries, strict=True):
        if entry.knowledge != "gone" and entry.value is not None:
            _put(tree, entry.name, before.value if entry.knowledge == "plugin" else entry.value)
    return tree


def _defaults(
    space: Namespace, prefix: str, values: Mapping[str, Value]
) -> Iterator[tuple[str, Value]]:
    for row in space.parameters.values():
        if row.default is not None:
            yield f"{prefix}{row.name}", row.default
    for group in space.groups:
        for instance in listed_names(group, prefix, values):
            inner = f"{prefix}{instance}"
            kind = kind_of(group, inner, instance, values)
            if group.key == "plugin" and kind:
                yield f"{inner}.plugin", kind
            child = child_of(group, kind, inner, values)
            if child is not None:
                yield from _defaults(child, f"{inner}.", values)


def _put(tree: dict[str, Value], path: str, value: Value) -> None:
    """Set a value; where a name is both a value and a namespace, the first one stays."""
    *spaces, last = path.split(".")
    for space in spaces:
        tree = tree.setdefault(space, {})
        if not isinstance(tree, dict):
            return
    if not isinstance(tree.get(last), dict):
        tree[last] = value

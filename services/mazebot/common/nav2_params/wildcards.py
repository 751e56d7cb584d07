"""Which nodes the sections of a file are for whose names have wildcards, such as `/**`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mazebot.common.nav2_params.entry import Entry
from mazebot.common.nav2_params.renames import NODE_RENAMES
from mazebot.common.nav2_params.tables.every_node import EVERY_NODE, PREFIXES
from mazebot.common.nav2_params.tables.nodes import NODES
from mazebot.common.nav2_params.yaml_leaves import Leaf, is_pattern

_DOUBLED = ("local_costmap", "global_costmap")
"""Nodes in a namespace of their own name."""
_LAST_COUNTS = "the last section of the file that matches the node counts, as in ROS 2"


@dataclass(frozen=True)
class Claim:
    """A parameter as one that a node may have."""

    leaf: Leaf
    node: str
    lost: str = ""
    """Why the node has another value; "": this one counts."""


def claims_of(leaves: Sequence[Leaf]) -> list[Claim]:
    """The leaves, each for every node of Nav2 that its section matches.

    Of two sections with the same parameter for a node, the one that begins later in the file
    counts, whatever is more specific, as in ROS 2 since Humble. What every node has stays with its
    section.
    """
    rank: dict[str, int] = {}
    for leaf in leaves:
        rank.setdefault(leaf.node, len(rank))
    matching = {pattern: nodes_of(pattern) for pattern in rank if is_pattern(pattern)}
    winners: dict[tuple[str, str], Leaf] = {}
    found = [(leaf, node) for leaf in leaves for node in _nodes(leaf, matching)]
    for leaf, node in found:
        winner = winners.setdefault((node, leaf.name), leaf)
        if rank[leaf.node] > rank[winner.node]:
            winners[node, leaf.name] = leaf
    return [Claim(leaf, node, _lost(leaf, node, winners[node, leaf.name])) for leaf, node in found]


def nodes_of(pattern: str) -> list[str]:
    """The nodes of Nav2 that a name with wildcards matches: `*` is one part of a name, `**` any
    number of them. Namespaces before it are not looked at.
    """
    parts = pattern.strip("/").split("/")
    while "*" not in parts[0] and parts[0] not in NODES:
        parts.pop(0)
    words = {"**": r"(/\w+)*", "*": r"/\w+"}
    wanted = re.compile("".join(words.get(part, f"/{re.escape(part)}") for part in parts))
    return [
        node for node in NODES
        if wanted.fullmatch(f"/{node}/{node}" if node in _DOUBLED else f"/{node}")
    ]  # fmt: skip


def chosen(entries: Iterable[Entry], unknown: Entry) -> list[Entry]:
    """What becomes of a parameter of a section with wildcards: the entries of the nodes for which
    it means something here, or else the one that tells most of it.

    `entries` are those of each node that the section matches, `unknown` that of none.
    """
    known = [entry for entry in entries if entry.knowledge != "unknown"]
    takers = {(entry.place, entry.name): entry for entry in reversed(known) if _means(entry)}
    if takers:
        return list(takers.values())[::-1]
    order = ("parameter", "plugin", "gone", "unread")
    return [min(known, key=lambda entry: order.index(entry.knowledge), default=unknown)]


def _means(entry: Entry) -> bool:
    if entry.node not in NODES or NODES[entry.node].note:
        return False
    if entry.knowledge == "plugin":
        return True
    row = entry.parameter
    return entry.knowledge == "parameter" and row is not None and bool(row.kind)


def _nodes(leaf: Leaf, matching: dict[str, list[str]]) -> list[str]:
    of_every_node = leaf.name in EVERY_NODE.parameters or leaf.name.startswith(PREFIXES)
    if leaf.node not in matching or of_every_node:
        return [NODE_RENAMES.get(leaf.node, (leaf.node, ""))[0]]
    return matching[leaf.node] or [leaf.node]


def _lost(leaf: Leaf, node: str, winner: Leaf) -> str:
    if winner is leaf:
        return ""
    return f"{node} has {winner.value!r:.40} of {winner.node} in line {winner.line}: {_LAST_COUNTS}"

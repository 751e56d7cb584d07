"""Loads a parameter file of Nav2, of any distribution from Humble on, under today's names."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mazebot.common.config import ConfigError
from mazebot.common.nav2_params.contradictions import contradictions
from mazebot.common.nav2_params.entry import Entry, NodeEntries, joined_notes
from mazebot.common.nav2_params.lookup import known
from mazebot.common.nav2_params.parameter import Value, check, typed
from mazebot.common.nav2_params.parameter_tree import tree_of
from mazebot.common.nav2_params.renames import NODE_RENAMES
from mazebot.common.nav2_params.tables.nodes import NODES
from mazebot.common.nav2_params.today import rename_entries, value_of_today
from mazebot.common.nav2_params.wildcards import chosen, claims_of
from mazebot.common.nav2_params.yaml_leaves import Leaf, is_pattern, read_leaves

_MOST_PROBLEMS = 4
_SUBSTITUTION = re.compile(r"\$\(|^(KEEPOUT|SPEED)_ZONE_ENABLED$")
_SAFE = "collision_monitor"
"""A node of which nothing is switched off because a launch file may do so."""


@dataclass(frozen=True)
class Nav2Params:
    """A parameter file of Nav2."""

    name: str
    """The file's name."""
    entries: tuple[Entry, ...]
    """One for each leaf of the file, in its order; of a leaf below a wildcard such as `/**`, one
    for each node that takes it."""
    tree: Mapping[str, Mapping[str, Value]]
    """For each node of the file all its parameters under today's names, nested as in the file:
    Nav2's own defaults, and over them the values of the file."""


def load_nav2_params(text: str, name: str) -> Nav2Params:
    """Load the text of a parameter file; `name` is the file's, for errors.

    Old names, classes `package/Class` and topics with a slash are taken as today's. Values that
    launch files fill in (`$(...)`, `KEEPOUT_ZONE_ENABLED`) are taken as false or Nav2's default.

    Raises ConfigError in one line, with file, line, parameter, value and what would be right.
    """
    leaves, replaced = read_leaves(text, name)
    nodes = _nodes(leaves, replaced)
    problems: list[str] = []
    of_leaf: dict[tuple[str, str], list[Entry]] = {(leaf.node, leaf.name): [] for leaf in leaves}
    known_of: dict[str, list[Entry]] = {}
    for node_name, node in nodes.items():
        rename_entries(node_name, node)
        values = node.values
        for entry in node.entries:
            found = known(entry, NODES.get(node_name), values)
            try:
                found = _typed(found)
            except ValueError as error:
                where = f"{name}:{entry.leaf.line}: {entry.full_name}"
                problems.append(f"{where}: {entry.leaf.value!r:.60}: {error}")
            known_of.setdefault(node_name, []).append(found)
            of_leaf[entry.leaf.node, entry.leaf.name].append(found)
    entries = [entry for leaf in leaves for entry in _told(leaf, of_leaf[leaf.node, leaf.name])]
    tree = {}
    for node_name, node in nodes.items() if not problems else ():
        of_node = _kept(node, known_of[node_name])
        if node.entries:
            tree[node_name] = tree_of(node_name, node, of_node)
    problems += contradictions(name, tree, entries)
    if problems:
        more = len(problems) - _MOST_PROBLEMS
        text = "; ".join(problems[:_MOST_PROBLEMS])
        raise ConfigError(text + (f"; and {more} more" if more > 0 else ""))
    return Nav2Params(name, tuple(entries), tree)


def _nodes(leaves: Sequence[Leaf], replaced: Sequence[Leaf]) -> dict[str, NodeEntries]:
    """The parameters of the file by their node's name of today."""
    before = {(leaf.node, leaf.name): leaf for leaf in replaced}
    nodes: dict[str, NodeEntries] = {}
    for claim in claims_of(leaves):
        leaf = claim.leaf
        _, until = NODE_RENAMES.get(leaf.node, ("", ""))
        notes = [f"{leaf.node} up to {until}"] if until else []
        if is_pattern(leaf.node) and claim.node != leaf.node:
            notes.append(f"of {claim.node}")
        first = before.get((leaf.node, leaf.name))
        if first is not None:
            notes.append(f"duplicate of line {first.line}, {first.value!r:.40}: the last is used")
        notes += [note for note in (leaf.repeated, claim.lost) if note]
        entry = Entry(
            leaf, claim.node, leaf.name, value_of_today(leaf),
            "gone" if claim.lost else "parameter", renamed=bool(until), note="; ".join(notes),
        )  # fmt: skip
        nodes.setdefault(claim.node, NodeEntries()).entries.append(entry)
    return nodes


def _told(leaf: Leaf, entries: Sequence[Entry]) -> Sequence[Entry]:
    """What is told of a parameter: of one below a wildcard, what the nodes that have it make of
    it.
    """
    if not is_pattern(leaf.node):
        return entries
    unknown = Entry(leaf, leaf.node, leaf.name, leaf.value, "parameter")
    return chosen(entries, known(unknown, None, {}))


def _kept(node: NodeEntries, entries: Sequence[Entry]) -> list[Entry]:
    """The entries of a node, of which those of sections with wildcards are taken out of the node
    again that it does not have.
    """
    kept = [
        entry.knowledge != "unknown" or not is_pattern(entry.leaf.node) or is_pattern(entry.node)
        for entry in entries
    ]
    node.entries = list(itertools.compress(node.entries, kept))
    return list(itertools.compress(entries, kept))


def _typed(entry: Entry) -> Entry:
    """The entry with its value of the right kind. Raises ValueError, with what it must be."""
    row, given = entry.parameter, entry.value
    if row is None:
        return entry
    words = given if isinstance(given, list) else [given]
    if any(isinstance(word, str) and _SUBSTITUTION.search(word) for word in words):
        off = row.kind == "bool" and entry.node != _SAFE
        assumed = "assumed to be " + ("false" if off else "Nav2's default")
        value = False if off else row.default
        note = joined_notes(entry.note, f"filled in by a launch file: {assumed}")
        return dataclasses.replace(entry, value=value, unresolved=True, note=note)
    value = typed(row, given)
    check(row, value)
    return dataclasses.replace(entry, value=value)

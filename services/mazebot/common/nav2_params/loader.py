"""Loads a parameter file of Nav2, of any distribution from Humble on, under today's names."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass

from mazebot.common.config import ConfigError
from mazebot.common.nav2_params.contradictions import contradictions
from mazebot.common.nav2_params.entry import Entry, NodeEntries, joined_notes
from mazebot.common.nav2_params.lookup import known
from mazebot.common.nav2_params.parameter import Value, check, typed
from mazebot.common.nav2_params.parameter_tree import tree_of
from mazebot.common.nav2_params.renames import NODE_RENAMES
from mazebot.common.nav2_params.tables.nodes import NODES
from mazebot.common.nav2_params.today import class_of_today, rename_entries
from mazebot.common.nav2_params.yaml_leaves import read_leaves

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
    """One for each leaf of the file, in its order."""
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
    before = {(leaf.node, leaf.name): leaf for leaf in replaced}
    nodes: dict[str, NodeEntries] = {}
    for leaf in leaves:
        owner, until = NODE_RENAMES.get(leaf.node, (leaf.node, ""))
        notes = [f"{leaf.node} up to {until}"] if until else []
        first = before.get((leaf.node, leaf.name))
        if first is not None:
            notes.append(f"duplicate of line {first.line}, {first.value!r:.40}: the last is used")
        notes += [leaf.repeated] if leaf.repeated else []
        entry = Entry(
            leaf, owner, leaf.name, class_of_today(leaf), "parameter",
            renamed=bool(until), note="; ".join(notes),
        )  # fmt: skip
        nodes.setdefault(owner, NodeEntries()).entries.append(entry)
    problems: list[str] = []
    entries: dict[tuple[str, str], Entry] = {}
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
            entries[entry.leaf.node, entry.leaf.name] = found
    tree = {} if problems else {one: tree_of(one, node, entries) for one, node in nodes.items()}
    problems += contradictions(name, tree, entries.values())
    if problems:
        more = len(problems) - _MOST_PROBLEMS
        text = "; ".join(problems[:_MOST_PROBLEMS])
        raise ConfigError(text + (f"; and {more} more" if more > 0 else ""))
    return Nav2Params(name, tuple(entries[leaf.node, leaf.name] for leaf in leaves), tree)


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

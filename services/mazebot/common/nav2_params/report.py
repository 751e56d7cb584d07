"""What becomes of each parameter of a file of Nav2, and the settings that come of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic.fields import FieldInfo

from mazebot.common.config import ConfigError, put_value, value_of
from mazebot.common.nav2_params.entry import Entry, joined_notes
from mazebot.common.nav2_params.loader import Nav2Params
from mazebot.common.nav2_params.parameter import OWN_NAME, Group, Value
from mazebot.common.nav2_params.tables.every_node import EVERY_NODE
from mazebot.common.nav2_params.tables.nodes import NODES
from mazebot.common.nav2_params.targets import (
    CONVERSIONS,
    LIMITS,
    NOT_TAKEN,
    SAME_MEANING,
    Models,
    disorder,
    nearest,
    problems_of,
    setting,
    valid_for,
)

Status = Literal["used", "mapped", "unsupported", "unknown"]
STATUSES: tuple[Status, ...] = ("used", "mapped", "unsupported", "unknown")


@dataclass(frozen=True)
class Row:
    """What becomes of a parameter of the file."""

    node: str
    parameter: str
    """As the file has it."""
    value: Value
    status: Status
    """used: as it stands. mapped: under another name or with another value. unsupported: a
    parameter of Nav2 that changes nothing here. unknown: none of Nav2, which ignores it too."""
    setting: str
    """Ours; "" where there is none."""
    note: str
    line: int
    now: str
    """Node and parameter under today's names."""
    section: str
    """The section of our settings for its node; "" where there is none."""
    differs: bool = False
    """Whether another value than the file's counts here where this parameter means something."""


@dataclass(frozen=True)
class Report:
    """What becomes of a file."""

    name: str
    rows: tuple[Row, ...]
    """One for each parameter of the file, in its order."""
    settings: Mapping[str, Mapping[str, Value]]
    """Our settings by section, nested as in a settings file."""

    @property
    def counts(self) -> dict[Status, int]:
        """The number of parameters of each status; together all of the file."""
        return {status: sum(row.status == status for row in self.rows) for status in STATUSES}


def report(params: Nav2Params, models: Models) -> Report:
    """Say what becomes of each parameter, where `models` are the sections of our settings.

    A parameter whose setting does not exist is unsupported. Where Nav2 takes a value that our
    setting does not, the nearest one counts.

    Raises ConfigError in one line where a setting takes no value near to that of the file, or the
    settings of a zone do not take its values: another zone would be left.
    """
    settings: dict[str, dict[str, Value]] = {}
    owners: dict[str, tuple[Value, str]] = {}
    entries = params.entries
    order = sorted(range(len(entries)), key=lambda at: _turn_of(entries[at]))
    done = {at: _row(params.name, entries[at], models, settings, owners) for at in order}
    rows = [done[at] for at in range(len(entries))]
    for entry in entries:
        _put_in_order(entry, models, settings)
    rows = _filled_in(params, rows, models, settings)
    _check_wholes(params, rows, models, settings)
    rows = _in_order(rows, models, settings)
    taken = [
        f"{entry.node}.{entry.name}"
        for entry, row in zip(params.entries, rows, strict=True)
        if row.status in {"used", "mapped"} and row.setting
    ]
    structure = [
        _structure(entry, row, taken) if _lists(entry) else row
        for entry, row in zip(params.entries, rows, strict=True)
    ]
    return Report(params.name, tuple(structure), settings)


def _filled_in(
    params: Nav2Params,
    rows: Sequence[Row],
    models: Models,
    settings: dict[str, dict[str, Value]],
) -> list[Row]:
    """The rows, of which the first of a node says which of its parameters the file leaves out and
    have Nav2's defaults.
    """
    told = list(rows)
    stated: dict[str, set[str]] = {}
    first: dict[str, int] = {}
    for at, entry in enumerate(params.entries):
        stated.setdefault(entry.node, set()).add(entry.name)
        first.setdefault(entry.node, at)
    for node, names in stated.items():
        space = NODES.get(node)
        for parameter in space.parameters.values() if space and space.as_nav2 else ():
            found = setting(space.place, parameter.target, "", models) if space else None
            if parameter.name in names or found is None:
                continue
            path, field = found
            problem = valid_for(field, parameter.default)
            if not problem:
                put_value(settings, path, parameter.default)
            note = f"{parameter.name} is left out: {parameter.default} as in Nav2"
            note += f", which {problem}" if problem else ""
            row = told[first[node]]
            told[first[node]] = dataclasses.replace(row, note=joined_notes(row.note, note))
    return told


def _in_order(
    rows: Sequence[Row], models: Models, settings: dict[str, dict[str, Value]]
) -> list[Row]:
    """The rows, of which those say so whose value is also that of a setting that the file leaves
    out: a minimum above our default of its maximum, or a maximum below that of its minimum.
    """
    told = list(rows)
    for section, values in settings.items():
        # One at a time: a model tells of one at a time.
        while alone := [
            found for found in disorder(section, values, models)
            if value_of(settings, found[1]) is None
        ]:  # fmt: skip
            path, other, value = alone[0]
            put_value(settings, other, value)
            also = f"{other} is {value:g}, too"
            told = [
                dataclasses.replace(row, note=joined_notes(row.note, also))
                if row.setting == path else row
                for row in told
            ]  # fmt: skip
    return told


def _check_wholes(
    params: Nav2Params, rows: Sequence[Row], models: Models, settings: Mapping[str, Value]
) -> None:
    """Raises ConfigError where values that belong together are not taken."""
    parts = {
        row.setting: row
        for entry, row in zip(params.entries, rows, strict=True)
        if entry.parameter is not None and entry.parameter.whole and row.setting
    }
    sections = {name.rpartition(".")[0]: row for name, row in parts.items()}
    problems = []
    for section, first in sections.items():
        if any(section.startswith(f"{other}.") for other in sections):
            # It is a part of another one.
            continue
        for name, problem in problems_of(section, value_of(settings, section), models):
            at = f"{section}.{name}."
            row = next((parts[part] for part in parts if at.startswith(f"{part}.")), first)
            said = f"{params.name}:{row.line}: {row.node}.{row.parameter}: {row.value!r:.60}"
            problems.append(f"{said}: {problem}")
    if problems:
        raise ConfigError("; ".join(problems))


def _row(
    file: str,
    entry: Entry,
    models: Models,
    settings: dict[str, dict[str, Value]],
    owners: dict[str, tuple[Value, str]],
) -> Row:
    row = Row(
        entry.leaf.node, entry.leaf.name, entry.leaf.value,
        "unknown" if entry.knowledge == "unknown" else "unsupported",
        "", entry.note, entry.leaf.line, f"{entry.node}.{entry.name}", _section(entry),
    )  # fmt: skip
    if entry.group is not None and _is_switch(entry):
        return _switched(entry, entry.group, row, models, settings)
    emptied = _mapping(entry, models) if entry.value == [] else ""
    if emptied:
        put_value(settings, emptied, {})
        note = joined_notes(row.note, "there are none then, nor those by default here")
        return dataclasses.replace(row, status="mapped", setting=emptied, note=note)
    target = _setting_of(entry)
    if target is None:
        return row
    name, value = target
    found = setting(entry.place, name, entry.instance, models)
    if found is None:
        return _as_always(entry, row)
    path, field = found
    converted = value
    if entry.parameter is not None and entry.parameter.conversion:
        converted = CONVERSIONS[entry.parameter.conversion](value)
    changed = entry.renamed or entry.unresolved or converted != value
    changed |= path.rpartition(".")[2] != entry.name.rpartition(".")[2]
    status: Status = "mapped" if changed else "used"
    if converted is None:
        note = "the same as the default here"
        return dataclasses.replace(
            row, status=status, setting=path, note=joined_notes(row.note, note)
        )
    if converted is NOT_TAKEN:
        note = joined_notes(row.note, f"{path} does not take this value: its own one counts")
        return dataclasses.replace(row, note=note, differs=True)
    taken, why = converted, ""
    if entry.parameter is None or not entry.parameter.whole:
        taken, why = _nearest(file, row, field, converted)
    before = owners.setdefault(path, (taken, row.now))
    if before[0] != taken and _is_limit(entry):
        return dataclasses.replace(row, note=joined_notes(row.note, f"{before[1]} is lower"))
    if before[0] != taken:
        note = joined_notes(row.note, f"{path} is already set by {before[1]}")
        return dataclasses.replace(row, note=note, differs=True)
    put_value(settings, path, taken)
    if taken == value:
        return dataclasses.replace(row, status=status, setting=path)
    note = joined_notes(row.note, f"converted to {taken!r}{why}")
    same = entry.parameter is not None and entry.parameter.conversion in SAME_MEANING
    # A limit in the other direction has the other sign.
    same |= _is_limit(entry) and taken == -value
    return dataclasses.replace(
        row, status="mapped", setting=path, note=note, differs=bool(why) or not same
    )


def _turn_of(entry: Entry) -> tuple[int, float]:
    """When the entry is read. The lists first: the switch of one that is listed may be off. Of
    limits the lowest first: it counts.
    """
    if _is_switch(entry):
        return 0, 0.0
    if _is_limit(entry) and isinstance(entry.value, float):
        return 2, abs(entry.value)
    return 1, 0.0


def _is_limit(entry: Entry) -> bool:
    return entry.parameter is not None and entry.parameter.conversion in LIMITS


def _section(entry: Entry) -> str:
    space = NODES.get(entry.node)
    return (entry.place or (space.place if space else "")).partition(".")[0]


def _nearest(file: str, row: Row, field: FieldInfo, value: Value) -> tuple[Value, str]:
    """The value, or the nearest one that its setting takes, and why that is.

    Raises ConfigError where there is none.
    """
    problem = valid_for(field, value)
    if not problem:
        return value, ""
    taken = nearest(field, value)
    if valid_for(field, taken):
        where = f"{file}:{row.line}: {row.node}.{row.parameter}"
        raise ConfigError(f"{where}: {row.value!r:.60}: {problem}")
    return taken, f": {problem} here"


def _mapping(entry: Entry, models: Models) -> str:
    """Our setting that is a mapping with the names of a list; "": the entry is no such list."""
    if entry.group is None or entry.knowledge != "parameter":
        return ""
    found = setting(entry.place, entry.group.mapping, "", models)
    return found[0] if found else ""


def _put_in_order(entry: Entry, models: Models, settings: dict[str, dict[str, Value]]) -> None:
    """Where a list gives the order of what a mapping of ours has, that of the file may differ."""
    path = _mapping(entry, models)
    found = value_of(settings, path) if path else None
    if found and entry.value:
        put_value(settings, path, {one: found[one] for one in entry.value if one in found})


def _is_switch(entry: Entry) -> bool:
    return entry.group is not None and entry.group.key == OWN_NAME


def _switched(
    entry: Entry,
    group: Group,
    row: Row,
    models: Models,
    settings: dict[str, dict[str, Value]],
) -> Row:
    """The row of a list such as MPPI's critics, of which each has a switch `enabled` here."""
    switches = {}
    for name in group.kinds:
        found = setting(f"{entry.place}.{name}", "enabled", entry.instance, models)
        if found is not None:
            switches[name] = found[0]
    if not switches:
        return dataclasses.replace(row, note=joined_notes(row.note, "has no setting here"))
    for name, path in switches.items():
        # The critic's own switch, where the file has it, is read later and counts.
        put_value(settings, path, name in entry.value)
    missing = [name for name in entry.value if name not in switches]
    note = f"without {', '.join(missing)}" if missing else ""
    on = sum(name in switches for name in entry.value)
    where = next(iter(switches.values())).rpartition(".")[0].rpartition(".")[0]
    note = joined_notes(f"{on} of {len(switches)} are on", note)
    return dataclasses.replace(
        row, status="mapped", setting=f"{where}.*.enabled", note=joined_notes(row.note, note),
        differs=bool(missing),
    )  # fmt: skip


def _setting_of(entry: Entry) -> tuple[str, Value] | None:
    """The name of our setting for the entry's value, and the value; None: there is none."""
    if entry.knowledge == "plugin" and entry.group is not None:
        if str(entry.value) in entry.group.implied:
            name, value, _ = entry.group.implied[str(entry.value)]
            return name, value
        chosen = entry.group.values.get(str(entry.value))
        return None if chosen is None else (entry.group.setting, chosen)
    if entry.knowledge == "parameter" and entry.parameter is not None:
        if entry.value is None:
            return None
        return entry.parameter.target, entry.value
    return None


def _as_always(entry: Entry, row: Row) -> Row:
    """The row of a parameter without a setting: used where it asks for what is always so."""
    fixed = entry.parameter.fixed if entry.parameter else ()
    if entry.parameter is not None and fixed == ("default",):
        fixed = (str(entry.parameter.default),)
    if not fixed:
        return row if row.note else dataclasses.replace(row, note="has no setting here")
    given = str(entry.value).lower() if isinstance(entry.value, bool) else str(entry.value)
    values = " or ".join(fixed)
    if given.lstrip("/") not in fixed:
        note = joined_notes(row.note, f"is always {values} here")
        # A real robot's file has the clock of the machine in each of its nodes.
        differs = not entry.unresolved and entry.place != EVERY_NODE.place
        return dataclasses.replace(row, note=note, differs=differs)
    status: Status = "mapped" if entry.renamed or entry.unresolved else "used"
    return dataclasses.replace(
        row, status=status, note=joined_notes(row.note, "is fixed to this value here")
    )


def _lists(entry: Entry) -> bool:
    """Whether the entry says which plugins there are, rather than anything of one."""
    listed = entry.knowledge in {"plugin", "parameter"}
    return entry.group is not None and listed and not _is_switch(entry)


def _missing_class(entry: Entry) -> str:
    """Why there is no plugin of a listed one's class here; "": there is, or there is no such
    node.
    """
    space = NODES.get(entry.node)
    if entry.group is None or space is None or space.note:
        return ""
    kind = entry.group.kinds.get(str(entry.value))
    return f"{entry.value} is not supported" if kind is None else kind.note


def _is_always(entry: Entry) -> bool:
    """Whether there is always a plugin of the entry's class here."""
    return entry.group is not None and any(entry.value in alike for alike in entry.group.always)


def _structure(entry: Entry, row: Row, taken: Iterable[str]) -> Row:
    """A list of plugins, or the class of one, is used where a parameter of such a plugin is."""
    if row.status != "unsupported":
        return row
    if entry.knowledge == "plugin":
        if entry.group is not None and entry.group.setting and entry.group.values:
            if str(entry.value) in entry.group.wraps:
                note = (
                    f"there is no {entry.value}: its {entry.group.wraps[str(entry.value)]} drives"
                )
                return dataclasses.replace(row, note=joined_notes(row.note, note))
            if str(entry.value) not in entry.group.values:
                built_in = ", ".join(entry.group.values)
                note = f"{entry.value} is not supported: must be one of {built_in}"
                return dataclasses.replace(row, note=note, differs=True)
        missing = _missing_class(entry)
        if missing:
            note = joined_notes(row.note, missing)
            return dataclasses.replace(row, note=note, differs=True)
        spaces = [f"{entry.node}.{entry.name.removesuffix('plugin')}"]
    else:
        above = entry.name.rpartition(".")[0]
        listed = entry.value.split() if isinstance(entry.value, str) else entry.value or []
        spaces = [".".join(filter(None, (entry.node, above, one))) + "." for one in listed]
    used = any(name.startswith(space) for space in spaces for name in taken)
    if not used and entry.knowledge == "plugin" and _is_always(entry):
        note = joined_notes(row.note, "there is always one here")
        return dataclasses.replace(row, status="used", note=note)
    if not used:
        note = row.note if row.note != "has no setting here" else ""
        return dataclasses.replace(row, note=joined_notes(note, "none of their parameters is used"))
    note = row.note if row.note != "has no setting here" else ""
    note = joined_notes(note, "its parameters are used")
    status: Status = "mapped" if entry.renamed else "used"
    return dataclasses.replace(row, status=status, note=note)

"""What a parameter of Nav2 is: its kind, default and valid values, and our setting for it."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

from mazebot.common.files import bounded_yaml

Value = Any
"""bool, int, float, str, or a list of these; of the kind `polygon` a list of [x, y] in metres, of
`planar` [x, y, yaw]."""

KINDS = (
    "bool", "int", "double", "string", "words", "polygon", "ints", "doubles", "strings", "planar",
)  # fmt: skip
UNCHECKED = ""
"""The kind of a parameter without a setting."""
OWN_NAME = "="
"""The `key` of a group whose namespaces have the names of their kinds, such as MPPI's critics."""
_ELEMENT = {"ints": "int", "doubles": "double", "strings": "string", "planar": "double"}
_IN_WORDS = {
    "bool": "true or false",
    "int": "an integer",
    "double": "a number",
    "string": "a string",
    "words": "a string of names",
    "polygon": 'a string of at least 3 points in metres, "[[x, y], [x, y], [x, y]]"',
}
_BOUND = re.compile(r"(?P<sign>>=|<=|>|<)(?P<bound>[-+.\d]+)$")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")


@dataclass(frozen=True)
class Parameter:
    """One row of a table: a parameter of Nav2 and what it is here."""

    name: str
    """Below its node or plugin; parts with dots between them."""
    kind: str
    """One of KINDS, or UNCHECKED."""
    default: Value
    """The default in Nav2's code; None: none."""
    valid: str = "*"
    """`*` any, `>0`, `0..1`, `{a,b}`; of a list, that of each element."""
    length: int | None = None
    """The length of a list; None: any."""
    target: str = ""
    """Name of our setting below the place of its namespace, or with `/` of the whole section; "":
    there is none."""
    conversion: str = ""
    """The name of a conversion of targets.py from Nav2's value to ours."""
    fixed: tuple[str, ...] = ()
    """The values that this robot always has; another one cannot be set."""
    note: str = ""
    whole: bool = False
    """Whether it means something only together with the others of its namespace: values that our
    settings do not take are an error then."""


@dataclass(frozen=True)
class Group:
    """Namespaces below a node or plugin that one of its parameters lists, such as its plugins."""

    lister: str
    """The parameter with the names; "" where a namespace is recognised by its `key` alone."""
    kinds: Mapping[str, Namespace]
    """By the last part of the class that `key` names; "" where there is only one kind."""
    key: str = "plugin"
    defaults: Mapping[str, str] = field(default_factory=dict)
    """The classes of the names that Nav2 lists by default."""
    setting: str = ""
    """Our setting that names the class of the first of them, and its values for each class."""
    values: Mapping[str, str] = field(default_factory=dict)
    wraps: Mapping[str, str] = field(default_factory=dict)
    """For the class of a plugin that stands before another one, the name of the namespace with the
    other's class and parameters. It may also be the parameter that names the other's class, whose
    parameters stand beside it then."""
    before: Mapping[str, Namespace] = field(default_factory=dict)
    """What such a plugin is before one of these classes, where that differs."""
    last: str = ""
    """The class that must be listed after the others; "": none."""
    always: tuple[tuple[str, ...], ...] = ()
    """Classes of which there is always one here, listed or not; several are each other's like."""
    implied: Mapping[str, tuple[str, Value, str]] = field(default_factory=dict)
    """What a class does other than its like, by its name: our setting below its place, the value of
    it, and a note."""
    mapping: str = ""
    """Our setting that is a mapping with these names, in the order of the list."""
    others: Namespace | None = None
    """What is taken of the parameters of any other class."""
    sensors: bool = False
    """Whether they are sensors, of which those that are the lidar share one section here."""


@dataclass(frozen=True)
class Namespace:
    """The parameters of a node or of a plugin."""

    place: str
    """The dotted name, below that of what it is in, of the section with our settings for it; `*` is
    the instance's name in the file. "": that of what it is in."""
    parameters: Mapping[str, Parameter]
    groups: tuple[Group, ...] = ()
    note: str = ""
    """Why its parameters are not supported, where none of their settings exists."""
    as_nav2: bool = False
    """Whether what a file with some of its parameters leaves out has Nav2's default, not ours: all
    together have a meaning, which another default would change."""


def namespace(
    place: str,
    rows: str,
    groups: Sequence[Group] = (),
    note: str = "",
    whole: bool = False,
    as_nav2: bool = False,
) -> Namespace:
    """A namespace from rows of text: `name kind default valid [=target[:conversion]]
    [!fixed|...] [# note]`, one a line, or `- name ... [# note]` for parameters of Nav2 that change
    nothing here: their values are not checked.

    A default `-` is none. The target has by default the parameter's own name, below `place`; one
    that begins with `/` is a dotted name of the whole section, and `=-` is no target. `doubles:3`
    is a list of three. `whole` is that of each parameter.
    """
    found = [row for line in rows.splitlines() if line.strip() for row in _rows(line.strip())]
    found = [dataclasses.replace(row, whole=whole) for row in found]
    return Namespace(place, {row.name: row for row in found}, tuple(groups), note, as_nav2)


def joined(first: Namespace, second: Namespace) -> Namespace:
    """Both namespaces in one, at the second's place: the second wins."""
    parameters = {
        name: dataclasses.replace(row, note=row.note or space.note)
        for space in (first, second)
        for name, row in space.parameters.items()
    }
    return Namespace(second.place, parameters, first.groups + second.groups)


def _rows(line: str) -> list[Parameter]:
    if not line.startswith("- "):
        return [_row(line)]
    names, _, note = line.removeprefix("- ").partition(" # ")
    return [Parameter(name, UNCHECKED, None, note=note.strip()) for name in names.split()]


def _row(line: str) -> Parameter:
    definition, _, note = line.partition(" # ")
    name, kind, default, valid, *rest = definition.split()
    kind, _, length = kind.partition(":")
    if kind not in KINDS:
        raise ValueError(f"{name}: {kind}: must be one of {', '.join(KINDS)}")
    target = name
    conversion = ""
    fixed: tuple[str, ...] = ()
    for word in rest:
        if word.startswith("="):
            other, _, conversion = word[1:].partition(":")
            target = other or name
        elif word.startswith("!"):
            fixed = tuple(word[1:].split("|"))
        else:
            raise ValueError(f"{name}: {word}: must begin with = or !")
    row = Parameter(
        name, kind, None, valid, int(length) if length else None,
        "" if target == "-" else target, conversion, fixed,
        note.strip(),
    )  # fmt: skip
    if default == "-":
        return row
    given = yaml.safe_load(default) if default != '""' else ""
    # A default such as 1e-10 or -1 with another meaning need not be among the valid values.
    value = typed(row, [] if given is None else given)
    return dataclasses.replace(row, default=value)


def typed(parameter: Parameter, given: Value) -> Value:
    """A value of a file as a value of the parameter's kind.

    Raises ValueError, with what it must be, where it is of another kind.
    """
    kind = parameter.kind
    if kind == UNCHECKED:
        return given
    if kind == "polygon":
        return _polygon(given)
    if kind not in _ELEMENT:
        return _scalar(kind, given)
    if kind == "planar" and isinstance(given, list) and len(given) == 6:
        # Since Kilted x, y, z, roll, pitch, yaw.
        given = [*given[:2], given[5]]
    element = _ELEMENT[kind]
    words = {"int": "integers", "double": "numbers", "string": "texts"}[element]
    count = "" if parameter.length is None else f"{parameter.length} "
    must = f"must be a list of {count}{words}"
    if not isinstance(given, list) or parameter.length not in {None, len(given)}:
        raise ValueError(must)
    try:
        return [_scalar(element, one) for one in given]
    except ValueError as error:
        raise ValueError(must) from error


def check(parameter: Parameter, value: Value) -> None:
    """Raises ValueError, with what it must be, where a value of the right kind is not valid."""
    for one in value if isinstance(value, list) and parameter.kind != "polygon" else [value]:
        problem = _problem(parameter.valid, one)
        if problem:
            each = "each " if isinstance(value, list) else ""
            raise ValueError(f"{each}{problem}")


def _scalar(kind: str, given: Value) -> Value:
    if kind == "bool" and isinstance(given, bool):
        return given
    number = isinstance(given, int | float) and not isinstance(given, bool)
    if kind == "int" and number and isinstance(given, int):
        return given
    if kind == "double":
        if number and not math.isnan(given):
            return float(given)
        # YAML 1.1 reads 1e-3 as a text, ROS 2 as a number.
        if isinstance(given, str) and _NUMBER.match(given):
            return float(given)
    if kind in {"string", "words"} and (isinstance(given, str) or number):
        return str(given)
    raise ValueError(f"must be {_IN_WORDS[kind]}")


def _polygon(given: Value) -> list[list[float]]:
    """The points of a text "[[x, y], ...]" or, as up to Iron, of a list [x, y, x, y, ...]."""
    points = given
    if isinstance(given, str):
        try:
            points = bounded_yaml.load(given) if given.strip() else []
        except bounded_yaml.ERRORS:
            points = None
    if isinstance(points, list) and points and not isinstance(points[0], list):
        points = [points[at : at + 2] for at in range(0, len(points), 2)]
    try:
        found = [[_scalar("double", one) for one in point] for point in points]
    except (TypeError, ValueError) as error:
        raise ValueError(f"must be {_IN_WORDS['polygon']}") from error
    whole = all(len(point) == 2 and all(map(math.isfinite, point)) for point in found)
    # An empty one means that there is none, such as Nav2's default footprint "[]".
    if not whole or len(found) in {1, 2}:
        raise ValueError(f"must be {_IN_WORDS['polygon']}")
    return found


def _problem(valid: str, value: Value) -> str:
    """What a value must be and is not; empty: it is valid."""
    if valid == "*":
        return ""
    if valid.startswith("{"):
        names = valid.strip("{}").split(",")
        return "" if str(value) in names else f"must be one of {', '.join(names)}"
    if ".." in valid:
        low, high = (float(part) for part in valid.split(".."))
        return "" if low <= value <= high else f"must be from {low:g} to {high:g}"
    found = _BOUND.match(valid)
    if found is None:
        raise ValueError(f"{valid}: must be *, {{a,b}}, low..high or a bound")
    bound = float(found["bound"])
    holds = {
        ">": value > bound, ">=": value >= bound, "<": value < bound, "<=": value <= bound,
    }[found["sign"]]  # fmt: skip
    words = {">": "greater than", ">=": "at least", "<": "less than", "<=": "at most"}
    return "" if holds else f"must be {words[found['sign']]} {bound:g}"

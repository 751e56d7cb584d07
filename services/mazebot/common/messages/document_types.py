"""The message types of documents on the wire: the ROS package `mazebot_msgs`, with one message for
each document class, made from its fields.

| field of a document | field of the message |
| --- | --- |
| `float`, `int`, `bool`, `str`, names | `float64`, `int64`, `bool`, `string` |
| fixed number of floats | `float64[N]` |
| list | `X[]`; of points in the plane: `Point2[]`; of lists: `XList[]` |
| anything or none | `X[<=1]`; of N floats `float64[<=N]` |
| one of several documents | a message with an `X[<=1]` for each, of which one is there |
| counts by name, JSON values by name | `Count[]`, `JsonValue[]` |
"""

from __future__ import annotations

import functools
import itertools
import json
import re
import types
import typing
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from pydantic import JsonValue
from pydantic_core import from_json, to_json
from rosbags.interfaces import Nodetype

from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Document
from mazebot.common.messages.documents.entities import Entity
from mazebot.common.messages.documents.shapes import Geometry

PACKAGE = "mazebot_msgs"

_UNIONS = {
    frozenset(typing.get_args(typing.get_args(union)[0])): name
    for name, union in (("ActionGoal", act.ActionGoal), ("Entity", Entity), ("Geometry", Geometry))
}
# `false` is a word of C.
_RENAMED: dict[tuple[type[Document], str], str] = {(doc.MarkersMapped, "false"): "found_falsely"}
_BASES: dict[Any, str] = {bool: "bool", int: "int64", float: "float64", str: "string"}
_DTYPES = {"int64": np.int64, "float64": np.float64, "bool": np.bool_}
_EMPTY = "structure_needs_at_least_one_member"

_Convert = Callable[[Any], Any]


def _itself(value: Any) -> Any:
    return value


@dataclass(frozen=True)
class _Rule:
    """How values of one kind are on the wire."""

    type: str
    """In a .msg file; of another message of the package its short name."""
    pack: _Convert = _itself
    """A document's value to the message's."""
    unpack: _Convert = _itself
    """Back, to what pydantic validates. Raises ValueError."""
    fixed: int = 0
    """The number of floats, if it is an array of them."""
    is_list: bool = False


@dataclass(frozen=True)
class _Field:
    """A field of a document and of its message."""

    name: str
    ros_name: str
    rule: _Rule
    about: str
    default: str = ""
    """As in a .msg file; empty: zero, or none."""


@dataclass(frozen=True)
class MessageFile:
    """A .msg file."""

    about: str
    fields: tuple[_Field, ...]

    @property
    def text(self) -> str:
        """Its content."""
        return "".join(self.lines())

    def lines(self, about: bool = True) -> list[str]:
        """Its lines; with what they are about, and default values, if wanted."""
        lines = [f"# {self.about}\n"] if about else []
        for field in self.fields:
            comment = f"  # {field.about}" if field.about else ""
            also = f"{field.default and ' '}{field.default}{comment}" if about else ""
            lines.append(f"{field.rule.type} {field.ros_name}{also}\n")
        return lines

    @property
    def needs(self) -> list[str]:
        """Short names of the package's other messages in it."""
        kinds = (field.rule.type.partition("[")[0] for field in self.fields)
        return [kind for kind in kinds if kind not in _BASES.values()]


_files: dict[str, MessageFile] = {}
"""By short name, each with all that it needs."""


@functools.cache
def type_name_of(kind: type[Document]) -> str:
    """The ROS type of a document class; registered in TYPESTORE once it has been asked for."""
    with msg.REGISTERING:
        return _register(_document_rule(kind).type)


def pack(document: Document) -> Any:
    """The message of a document, of its type in TYPESTORE."""
    return _converters(type(document))[0](document)


def unpack(kind: type[Document], message: Any) -> dict[str, Any]:
    """The fields of a document of a kind, in which nothing but the shape has been checked. Those
    that a message of another version does not have are left out.

    Raises ValueError where a message has several values for one.
    """
    return cast("dict[str, Any]", _converters(kind)[1](message))


def names_of(kind: type[Document]) -> list[str]:
    """The names of the fields of a document's message."""
    return [field.ros_name for field in _file_of(kind).fields]


def service_text(request: type[Document], response: type[Document], about: bool = True) -> str:
    """The .srv file of two documents."""
    parts = [_file_of(kind).lines(about) for kind in (request, response)]
    return "".join([*parts[0], "---\n", *parts[1]])


def _file_of(kind: type[Document]) -> MessageFile:
    return _files[type_name_of(kind).rpartition("/")[2]]


def files_of(
    kinds: Iterable[type[Document]], in_services: Iterable[type[Document]] = ()
) -> dict[str, MessageFile]:
    """The .msg files of document classes and of all in them, by short name in their order; of those
    that are a service's request or response, only of what is in them.
    """
    waiting = [type_name_of(kind).rpartition("/")[2] for kind in kinds]
    waiting += [needed for kind in in_services for needed in _file_of(kind).needs]
    found: dict[str, MessageFile] = {}
    while waiting:
        name = waiting.pop()
        if name not in found:
            found[name] = _files[name]
            waiting += found[name].needs
    return dict(sorted(found.items()))


@functools.cache
def _converters(kind: type[Document]) -> tuple[_Convert, _Convert]:
    type_name_of(kind)
    rule = _document_rule(kind)
    return rule.pack, rule.unpack


def _register(short: str) -> str:
    """Register a message and those in it; its whole name."""
    name = f"{PACKAGE}/msg/{short}"
    if name not in msg.TYPESTORE.fielddefs:
        for needed in _files[short].needs:
            _register(needed)
        fields: list[Any] = [
            (field.ros_name, _node(field.rule.type)) for field in _files[short].fields
        ]
        empty = (_EMPTY, (Nodetype.BASE, ("uint8", 0)))
        msg.TYPESTORE.register({name: ([], fields or [empty])})
    return name


def _node(kind: str) -> Any:
    """A field's type as TYPESTORE has it: parsing the whole text would take as long as the rest."""
    one, _, size = kind.rstrip("]").partition("[")
    is_base = one in _BASES.values()
    item = (Nodetype.BASE, (one, 0)) if is_base else (Nodetype.NAME, f"{PACKAGE}/msg/{one}")
    if one == kind:
        return item
    bound = int(size.lstrip("<=") or 0)
    return (Nodetype.ARRAY if size.isdecimal() else Nodetype.SEQUENCE), (item, bound)


@functools.cache
def _document_rule(kind: type[Document]) -> _Rule:
    """The rule of a document, whose message it defines."""
    fields = []
    for name, info in kind.model_fields.items():
        rule = _rule(info.annotation, f"{kind.__name__}.{name}")
        about = _one_line((info.description or "").replace("null", "none"))
        if typing.get_origin(info.annotation) is Literal:
            about = "; ".join(filter(None, (" | ".join(typing.get_args(info.annotation)), about)))
        ros_name = _RENAMED.get((kind, name), name)
        fields.append(_Field(name, ros_name, rule, about, _default(rule, info.default)))
    return _defined(kind.__name__, _one_line(kind.__doc__ or ""), fields)


def _defined(short: str, about: str, fields: list[_Field]) -> _Rule:
    """The rule of a message with some fields, which it defines."""
    made = MessageFile(about, tuple(fields))
    if _files.setdefault(short, made).text != made.text:
        raise ValueError(f"{PACKAGE}/{short}: two messages have this name")
    name = f"{PACKAGE}/msg/{short}"
    read = [(field.name, field.rule.pack) for field in fields]
    written = [(field.name, field.ros_name, field.rule.unpack) for field in fields]

    def pack(value: Any) -> Any:
        kind = msg.TYPESTORE.types[name]
        if not read:
            return kind(0)
        return kind(*[convert(getattr(value, field)) for field, convert in read])

    def unpack(message: Any) -> dict[str, Any]:
        try:
            return {field: convert(getattr(message, ros)) for field, ros, convert in written}
        except AttributeError:
            there = [one for one in written if hasattr(message, one[1])]
            return {field: convert(getattr(message, ros)) for field, ros, convert in there}

    return _Rule(short, pack, unpack)


def _rule(kind: Any, place: str) -> _Rule:
    """The rule of an annotated type. Raises TypeError where there is none."""
    origin, args = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return _rule(args[0], place)
    if kind in _BASES:
        return _Rule(_BASES[kind])
    if origin is Literal:
        return _rule(type(args[0]), place)
    if isinstance(kind, type) and issubclass(kind, Document):
        return _document_rule(kind)
    if origin is tuple and args[-1] is Ellipsis:
        return _list_of(_item(_rule(args[0], place)))
    if origin is tuple and all(_rule(each, place).type == "float64" for each in args):
        return _floats(len(args))
    if origin is dict:
        return _by_name(args[1])
    if origin in (typing.Union, types.UnionType):
        others = [each for each in args if each is not types.NoneType]
        one = _rule(others[0], place) if len(others) == 1 else _one_of(others, place)
        return one if len(others) == len(args) else _or_none(one)
    raise TypeError(f"{place}: no message field for {kind}")


def _floats(count: int) -> _Rule:
    return _Rule(
        f"float64[{count}]",
        lambda values: np.array(values, np.float64),
        lambda array: array.tolist(),
        fixed=count,
    )


def _list_of(item: _Rule) -> _Rule:
    if dtype := _DTYPES.get(item.type):
        return _Rule(
            f"{item.type}[]",
            lambda values: np.array(values, dtype),
            lambda array: array.tolist(),
            is_list=True,
        )
    pack, unpack = item.pack, item.unpack
    return _Rule(
        f"{item.type}[]",
        lambda values: [pack(value) for value in values],
        lambda items: [unpack(one) for one in items],
        is_list=True,
    )


def _item(rule: _Rule) -> _Rule:
    """The rule of what is in a list: a list in it is a message of its own."""
    if rule.fixed == 2:
        return _point()
    if not (rule.fixed or rule.is_list):
        return rule
    inner = rule.type.partition("[")[0]
    short = f"{inner[0].upper()}{inner[1:]}List"
    made = _defined(short, "A list.", [_Field("items", "items", _Rule(rule.type), "")])
    kind = f"{PACKAGE}/msg/{short}"
    return _Rule(
        made.type,
        lambda value: msg.TYPESTORE.types[kind](rule.pack(value)),
        lambda message: rule.unpack(message.items),
    )


@functools.cache
def _point() -> _Rule:
    axes = [_Field(axis, axis, _Rule("float64"), "") for axis in "xy"]
    made = _defined("Point2", "A point in the plane, m.", axes)
    kind = f"{PACKAGE}/msg/Point2"
    return _Rule(
        made.type,
        lambda value: msg.TYPESTORE.types[kind](*value),
        lambda message: (message.x, message.y),
    )


def _or_none(rule: _Rule) -> _Rule:
    if rule.fixed:
        none = np.zeros(0)
        return _Rule(
            f"float64[<={rule.fixed}]",
            lambda value: none if value is None else rule.pack(value),
            lambda array: array.tolist() or None,
        )
    one = _item(rule)
    several = _list_of(one)

    def unpack(items: Any) -> Any:
        if len(items) > 1:
            raise ValueError(f"{len(items)} values: must be one at most")
        return several.unpack(items)[0] if len(items) else None

    return _Rule(
        f"{one.type}[<=1]", lambda value: several.pack([] if value is None else [value]), unpack
    )


def _one_of(kinds: list[Any], place: str) -> _Rule:
    """The rule of one of several documents."""
    short = _UNIONS.get(frozenset(kinds))
    if short is None:
        raise TypeError(f"{place}: no name for a message that is one of {kinds}")
    fields = {kind: _snake(kind.__name__) for kind in kinds}
    rules = [_or_none(_document_rule(kind)) for kind in kinds]
    made = _defined(
        short, "One of these.",
        [
            _Field(name, name, rule, "")
            for name, rule in zip(fields.values(), rules, strict=True)
        ],
    )  # fmt: skip
    name = f"{PACKAGE}/msg/{short}"
    packs = {kind: _document_rule(kind).pack for kind in kinds}
    places = {kind: i for i, kind in enumerate(kinds)}
    count = len(kinds)

    def pack(value: Any) -> Any:
        parts: list[list[Any]] = [[] for _ in range(count)]
        parts[places[type(value)]].append(packs[type(value)](value))
        return msg.TYPESTORE.types[name](*parts)

    def unpack(message: Any) -> Any:
        found = [
            rule.unpack(getattr(message, field, ()))
            for field, rule in zip(fields.values(), rules, strict=True)
        ]
        given = [value for value in found if value is not None]
        if len(given) != 1:
            raise ValueError(
                f"{short}: has {len(given)} of {', '.join(fields.values())}: must be 1"
            )
        return given[0]

    return _Rule(made.type, pack, unpack)


def _by_name(kind: Any) -> _Rule:
    """The rule of values by name."""
    short, value_type = ("Count", "int64") if kind is int else ("JsonValue", "string")
    if kind not in (int, JsonValue):
        raise TypeError(f"no message field for {kind} by name")
    about = "A number by its name." if kind is int else "A value by its name, as JSON."
    made = _defined(
        short,
        about,
        [
            _Field("name", "name", _Rule("string"), ""),
            _Field("value", "value", _Rule(value_type), ""),
        ],
    )
    name = f"{PACKAGE}/msg/{short}"
    write: _Convert = _itself if kind is int else lambda value: to_json(value).decode()
    read: _Convert = _itself if kind is int else from_json
    return _Rule(
        f"{made.type}[]",
        lambda values: [
            msg.TYPESTORE.types[name](key, write(value)) for key, value in values.items()
        ],
        lambda items: {one.name: read(one.value) for one in items},
        is_list=True,
    )


def _default(rule: _Rule, value: Any) -> str:
    if rule.type not in _BASES.values() or type(value) not in _BASES or not value:
        return ""
    return str(value).lower() if isinstance(value, bool) else json.dumps(value)


def _snake(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def _one_line(text: str) -> str:
    return " ".join(itertools.chain.from_iterable(map(str.split, text.splitlines())))

"""Whether a bag's message definitions fit, and its messages as Mazebot's own types."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rosbags.interfaces import MessageDefinitionFormat, Nodetype
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)

from mazebot.common.messages import messages as msg

_Fields = list[tuple[str, Any]]
Decode = Callable[[bytes], Any]


class UnfitError(ValueError):
    """A definition that does not fit; one line of text."""


def decoder_of(connection: Any) -> Decode | None:
    """A function that decodes a connection's messages to Mazebot's type of the same name, where
    the bag's definition has other fields; None: it is the same.

    A bag without definitions, as older ones are, is taken to have the same. Fields that Mazebot
    does not know are left out. Raises UnfitError where one is missing.
    """
    theirs = _store_of(connection)
    name = connection.msgtype
    if theirs is None or _is_same(theirs, name):
        return None
    _check(theirs, name)
    return lambda data: _converted(theirs.deserialize_cdr(data, name), name)


def _store_of(connection: Any) -> Any:
    """The types that a bag defines for a connection."""
    definition = connection.msgdef
    if definition.format is MessageDefinitionFormat.NONE or not definition.data:
        return None
    read = (
        get_types_from_idl
        if definition.format is MessageDefinitionFormat.IDL
        else lambda text: get_types_from_msg(text, connection.msgtype)
    )
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(read(definition.data))
    except (TypesysError, ValueError, KeyError, AssertionError) as error:
        raise UnfitError(f"its definition of {connection.msgtype} cannot be read") from error
    if connection.msgtype not in store.fielddefs:
        return None
    return store


def _fields(store: Any, name: str) -> _Fields:
    fields: _Fields = store.fielddefs[name][1]
    return fields


def _item(what: Any) -> Any:
    """The type of a field without its being a list."""
    kind, inner = what
    return inner[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else what


def _is_same(theirs: Any, name: str) -> bool:
    """Whether messages of a type are the same bytes by both definitions."""
    if name not in theirs.fielddefs:
        # Standard types that a definition only names.
        return True
    if _fields(theirs, name) != _fields(msg.TYPESTORE, name):
        return False
    nested = [_item(what) for _, what in _fields(theirs, name)]
    return all(_is_same(theirs, inner) for kind, inner in nested if kind == Nodetype.NAME)


def _check(theirs: Any, name: str) -> None:
    """Raises UnfitError where a field is missing or of another type."""
    have = dict(_fields(theirs, name))
    for field, what in _fields(msg.TYPESTORE, name):
        if field not in have:
            raise UnfitError(f"its definition of {name} has no field '{field}'")
        if have[field] != what:
            raise UnfitError(f"its definition of {name} has another type of '{field}'")
        kind, inner = _item(what)
        if kind == Nodetype.NAME and inner in theirs.fielddefs:
            _check(theirs, inner)


def _converted(message: Any, name: str) -> Any:
    """A message of the type of that name, with the fields of another definition of it."""
    values = {}
    for field, what in _fields(msg.TYPESTORE, name):
        value = getattr(message, field)
        kind, inner = _item(what)
        if kind == Nodetype.NAME:
            several = isinstance(value, list)
            value = (
                [_converted(one, inner) for one in value] if several else _converted(value, inner)
            )
        values[field] = value
    return msg.TYPESTORE.types[name](**values)

"""Encodes messages as CDR (XCDR1, little endian), with one `struct` call for most of them, in half
the time of a serializer that goes field by field.
"""

from __future__ import annotations

import functools
import itertools
import operator
import struct
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np
from rosbags.interfaces import Nodetype

from mazebot.common.messages import messages as msg
from mazebot.common.messages.rows import Rows

HEADER = b"\0\1\0\0"

_CODES = {
    "bool": "?", "byte": "B", "char": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip
_MOST_CACHED = 1000
_LENGTH = struct.Struct("<I")

_Write = Callable[[Any, list[bytes], int], int]
"""Appends a message, or a part of one, that begins at a position; returns where it ends."""


def encode(type_name: str, message: Any) -> bytes:
    """The CDR bytes of a message.

    Raises AttributeError, TypeError, ValueError or struct.error where it is not of that type.
    """
    pieces = [HEADER]
    _writer(type_name)(message, pieces, 0)
    return b"".join(pieces)


class _Slot(NamedTuple):
    """A value in a `struct`."""

    path: str
    """Of the field in the message."""
    code: str
    """Of the value, or of the bytes of a list of fixed length; empty: bytes of any length."""
    alignment: int
    convert: Callable[[Any], Any] | None = None
    """Makes the value of the field; None: they are the same."""


@functools.cache
def _writer(type_name: str) -> _Write:
    """A function that writes messages of a type."""
    parts: list[_Write] = []
    slots: list[_Slot] = []

    def end_run() -> None:
        if slots:
            parts.append(_run_writer(tuple(slots)))
            slots.clear()

    for path, is_list, item_kind, item, length in _leaves(type_name):
        if is_list and (item_kind is Nodetype.NAME or item[0] == "string"):
            end_run()
            parts.append(_list_writer(operator.attrgetter(path), item_kind, item))
        elif is_list:
            dtype = np.dtype(item[0])
            if length is None:
                slots.append(_Slot(path, "I", 4, len))
            code = "" if length is None else f"{length * dtype.itemsize}s"
            slots.append(_Slot(path, code, dtype.itemsize, _array_converter(dtype, length)))
        elif item[0] == "string":
            slots.append(_Slot(path, "", 4, _text))
        else:
            code = _CODES[item[0]]
            slots.append(_Slot(path, code, struct.calcsize(code)))
    end_run()
    if len(parts) == 1:
        return parts[0]

    def write(message: Any, pieces: list[bytes], at: int) -> int:
        for part in parts:
            at = part(message, pieces, at)
        return at

    return write


def _leaves(type_name: str, prefix: str = "") -> list[tuple[str, bool, Nodetype, Any, int | None]]:
    """The fields of a type and of the types in it, but not of those in lists: path, whether it is a
    list, kind and type of it or of its items, and the length of a list that has a fixed one.
    """
    found: list[tuple[str, bool, Nodetype, Any, int | None]] = []
    for name, (kind, what) in msg.TYPESTORE.fielddefs[type_name][1]:
        is_list = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        item_kind, item = cast("tuple[Nodetype, Any]", what[0] if is_list else (kind, what))
        if item_kind is Nodetype.NAME and not is_list:
            found += _leaves(item, f"{prefix}{name}.")
        else:
            length = cast("int", what[1]) if kind is Nodetype.ARRAY else None
            found.append((prefix + name, is_list, item_kind, item, length))
    return found


def _run_writer(slots: tuple[_Slot, ...]) -> _Write:
    """A function that writes fields without lists of messages or texts between them."""
    get = _all_of([slot.path for slot in slots])
    converted = [(i, slot.convert) for i, slot in enumerate(slots) if slot.convert is not None]
    sized = [i for i, slot in enumerate(slots) if not slot.code]
    # A layout depends on nothing but where it begins, and on the lengths of texts and arrays.
    layouts: dict[tuple[int, ...], struct.Struct] = {}

    def write(message: Any, pieces: list[bytes], at: int) -> int:
        values = get(message)
        for i, convert in converted:
            values[i] = convert(values[i])
        key = (at & 7, *[len(values[i]) for i in sized])
        layout = layouts.get(key)
        if layout is None:
            if len(layouts) >= _MOST_CACHED:
                layouts.clear()
            layout = layouts[key] = _layout(slots, key[0], key[1:])
        pieces.append(layout.pack(*values))
        return at + layout.size

    return write


def _layout(slots: tuple[_Slot, ...], start: int, sizes: tuple[int, ...]) -> struct.Struct:
    codes, at, left = ["<"], start, iter(sizes)
    for slot in slots:
        size = struct.calcsize(slot.code) if slot.code else next(left)
        # An empty sequence is its length alone.
        padding = -at % slot.alignment if size else 0
        codes.append(f"{padding}x{slot.code or f'{size}s'}")
        at += padding + size
    return struct.Struct("".join(codes))


def _list_writer(get: Callable[[Any], Any], item_kind: Nodetype, item: Any) -> _Write:
    """A function that writes a sequence of messages or of texts."""
    write_one = _writer(item) if item_kind is Nodetype.NAME else _write_text
    alike = _numbers_alike(item) if item_kind is Nodetype.NAME else None

    def write(message: Any, pieces: list[bytes], at: int) -> int:
        items = get(message)
        padding = -at & 3
        pieces.append(bytes(padding) + _LENGTH.pack(len(items)))
        at += padding + 4
        if alike is None:
            for one in items:
                at = write_one(one, pieces, at)
        elif items:
            numbers_of, code, size = alike
            padding = -at % size
            if isinstance(items, Rows):
                data = bytes(padding) + items.numbers.astype(f"<{code}", copy=False).tobytes()
            else:
                numbers = list(itertools.chain.from_iterable(map(numbers_of, items)))
                data = struct.pack(f"<{padding}x{len(numbers)}{code}", *numbers)
            pieces.append(data)
            at += len(data)
        return at

    return write


def _numbers_alike(type_name: str) -> tuple[Callable[[Any], Any], str, int] | None:
    """Of a type with nothing but numbers of one kind, such as a pose: what gets them, the code of
    `struct` and the size of one. None: it has something else.
    """
    leaves = _leaves(type_name)
    codes = {"" if is_list else _CODES.get(item[0], "") for _, is_list, _, item, _ in leaves}
    if len(codes) != 1 or "" in codes:
        return None
    code, paths = codes.pop(), [leaf[0] for leaf in leaves]
    get = operator.attrgetter(*paths) if len(paths) > 1 else _all_of(paths)
    return get, code, struct.calcsize(code)


def _all_of(paths: list[str]) -> Callable[[Any], list[Any]]:
    """A function that returns the values at some paths."""
    get = operator.attrgetter(*paths)
    return (lambda message: list(get(message))) if len(paths) > 1 else lambda one: [get(one)]


def _text(text: str) -> bytes:
    data = text.encode()
    return _LENGTH.pack(len(data) + 1) + data + b"\0"


def _write_text(text: str, pieces: list[bytes], at: int) -> int:
    padding = -at & 3
    data = bytes(padding) + _text(text)
    pieces.append(data)
    return at + len(data)


def _array_converter(dtype: np.dtype[Any], length: int | None) -> Callable[[Any], bytes]:
    def convert(values: Any) -> bytes:
        if values.dtype != dtype:
            raise TypeError(f"an array of {values.dtype} instead of {dtype}")
        if length is not None and len(values) != length:
            raise ValueError(f"{len(values)} instead of {length} numbers")
        return cast("bytes", values.tobytes())

    return convert

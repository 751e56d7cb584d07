"""Eight-byte digest of a message: equal for equal messages, in any process."""

from __future__ import annotations

import functools
import hashlib
import operator
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from rosbags.interfaces import Nodetype

from services.common.bus import wire
from services.common.node import messages as msg
from services.common.node.documents import Document
from services.common.node.topics import Topic

if TYPE_CHECKING:
    from hashlib import _Hash

_Take = Callable[[Any, "_Hash"], None]

_CODES = {"float64": "d", "float32": "f", "uint64": "Q", "bool": "?"}
"""How a number is packed; others as signed 64 bits."""


def digest_of(topic: Topic[Any], message: Any) -> bytes:
    """The first 8 bytes of the sha1, for which CPUs have instructions, over all fields of a
    message.

    Not over its CDR: serialising takes as long as everything else for a small message.
    """
    taken = hashlib.sha1(usedforsecurity=False)
    if isinstance(message, Document):
        taken.update(message.model_dump_json().encode())
    else:
        _taker(wire.type_name(topic))(message, taken)
    return taken.digest()[:8]


@functools.cache
def _taker(type_name: str) -> _Take:
    """A function that hashes a message of a type: numbers first, then texts, arrays and lists."""
    numbers: list[str] = []
    codes: list[str] = []
    texts: list[str] = []
    arrays: list[tuple[Callable[[Any], Any], str]] = []
    lists: list[tuple[Callable[[Any], Any], _Take]] = []

    def collect(type_name_: str, prefix: str) -> None:
        for name, (kind, what) in msg.TYPESTORE.fielddefs[type_name_][1]:
            path = prefix + name
            is_list = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            item_kind, item = cast("tuple[Nodetype, Any]", what[0] if is_list else (kind, what))
            if item_kind == Nodetype.NAME:
                if is_list:
                    lists.append((operator.attrgetter(path), _taker(item)))
                else:
                    collect(item, f"{path}.")
            elif item[0] == "string":
                if is_list:
                    lists.append((operator.attrgetter(path), _take_text))
                else:
                    texts.append(path)
            elif is_list:
                arrays.append((operator.attrgetter(path), item[0]))
            else:
                numbers.append(path)
                codes.append(_CODES.get(item[0], "q"))

    collect(type_name, "")
    pack = struct.Struct("<" + "".join(codes)).pack
    all_numbers, all_texts = _all_of(numbers), _all_of(texts)

    def take(message: Any, taken: _Hash) -> None:
        taken.update(pack(*all_numbers(message)))
        if texts:
            taken.update("\0".join(all_texts(message)).encode())
        for get, dtype in arrays:
            values = np.ascontiguousarray(get(message), dtype)
            taken.update(b"%d;" % len(values))
            taken.update(values.data)
        for get, take_one in lists:
            several = get(message)
            taken.update(b"%d;" % len(several))
            for one in several:
                take_one(one, taken)

    return take


def _take_text(text: str, taken: _Hash) -> None:
    taken.update(text.encode() + b"\0")


def _all_of(paths: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """A function that returns the values at some attribute paths."""
    if not paths:
        return lambda _: ()
    get = operator.attrgetter(*paths)
    return get if len(paths) > 1 else lambda message: (get(message),)

"""Messages of the right type, with contents that nobody would send."""

from __future__ import annotations

import copy
import dataclasses
import random
import struct
from typing import Any

import numpy as np

from mazebot.common.messages import cdr, document_types, wire
from mazebot.common.messages.documents import Document
from mazebot.common.messages.topics import Topic

FLOATS = (
    0.0, -0.0, 5e-324, 1e-300, 1e-9, -1.0, 1.0, 0.05, 1e3, -1e5, 1e6, -1e6, 1e9, -1e9, 1e12,
    1e38, 1e200, 1.7e308, -1.7e308,
)  # fmt: skip
INTEGERS = (0, 1, -1, 2, 127, 255, -128, 65_535, 2**31 - 1, -(2**31), 2**32 - 1, 2**62, 10**30)
STRINGS = (
    "", " ", "/", "//", "../..", "map", "odom", "base_footprint", "a/b", "ü\n\t", "%s {0} \\",
    "x" * 300,
    "0", "-1", "60", "DICT_4X4_100:60", "rgb8", "32FC1", "jpeg", "__", "a:b", "!?*",
)  # fmt: skip


def absurd_bytes(topic: Topic[Any], message: Any, rng: random.Random) -> bytes | None:
    """What travels of a message after some of its fields have been changed; None: it does not."""
    changed = (
        document_types.pack(message) if isinstance(message, Document) else copy.deepcopy(message)
    )
    _change(changed, rng)
    try:
        return cdr.encode(wire.type_name(topic), changed)
    except (AttributeError, TypeError, ValueError, OverflowError, struct.error):
        return None


def _change(message: Any, rng: random.Random) -> None:
    """Change about a quarter of the fields of a ROS message, in place."""
    for field in dataclasses.fields(message):
        value = getattr(message, field.name)
        if dataclasses.is_dataclass(value):
            _change(value, rng)
        elif isinstance(value, list):
            setattr(message, field.name, _list(value, rng))
        elif rng.random() < 0.25:
            setattr(message, field.name, _leaf(value, rng))


def _list(items: list[Any], rng: random.Random) -> list[Any]:
    if rng.random() < 0.1:
        return []
    if rng.random() < 0.1:
        items = [copy.deepcopy(item) for item in items for _ in range(rng.choice((2, 30)))]
    for index, item in enumerate(items):
        if dataclasses.is_dataclass(item):
            _change(item, rng)
        elif rng.random() < 0.25:
            items[index] = _leaf(item, rng)
    return items


def _leaf(value: Any, rng: random.Random) -> Any:
    if isinstance(value, np.ndarray):
        return _array(value, rng)
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice(INTEGERS)
    if isinstance(value, float):
        return rng.choice(FLOATS)
    return rng.choice(STRINGS)


def _array(values: Any, rng: random.Random) -> Any:
    if rng.random() < 0.2:
        return values[: rng.randrange(len(values) + 1)]
    changed = np.array(values)
    for _ in range(min(len(changed), 4)):
        at = rng.randrange(len(changed))
        if changed.dtype.kind == "f":
            with np.errstate(over="ignore"):
                changed[at] = np.array(rng.choice(FLOATS)).astype(changed.dtype)
        else:
            changed[at] = rng.randrange(128)
    return changed

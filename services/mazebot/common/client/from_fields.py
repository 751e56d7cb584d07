"""Messages of what people and their tools write: fields by name, as JSON and YAML have them."""

from __future__ import annotations

from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from mazebot.common.config import ConfigError
from mazebot.common.messages import messages as msg
from mazebot.common.settings.known_settings import unknown_name

_ABSENT: Any = object()
"""In place of a field that is not given; None is what a person or tool has written, as JSON has
`null` for a number that is none.
"""
_INTEGERS = {
    f"{sign}int{bits}": (0 if sign else -(1 << bits - 1), (1 << (bits if sign else bits - 1)) - 1)
    for sign in ("u", "")
    for bits in (8, 16, 32, 64)
}
"""Minimum and maximum value by type."""


def message_of(kind: str, content: object, where: str) -> Any:
    """A message of a ROS type with fields as given, the others zero; `where` is said before the
    name of a field that is wrong.

    Raises ConfigError where a field is unknown, or its value is not of its type.
    """
    if not isinstance(content, dict):
        raise ConfigError(f"{where}: {content!r:.60}: must be the fields of {kind}")
    fields = dict(msg.TYPESTORE.fielddefs[kind][1])
    for name, value in content.items():
        if name not in fields:
            hint = unknown_name(str(name), fields)
            raise ConfigError(f"{where}.{name!s:.60}: {value!r:.60}: unknown field{hint}")
    if kind == "geometry_msgs/msg/Quaternion" and not content:
        # No rotation, as in ROS.
        content = {"w": 1.0}
    values: dict[str, Any] = {
        name: _value(spec, content.get(name, _ABSENT), f"{where}.{name}")
        for name, spec in fields.items()
    }
    return msg.TYPESTORE.types[kind](**values)


def _value(spec: Any, content: object, where: str) -> object:
    """A field's value, converted to its type; of `_ABSENT`: zero."""
    kind, what = spec
    if kind == Nodetype.NAME:
        return message_of(what, {} if content is _ABSENT else content, where)
    if kind == Nodetype.BASE:
        return _base(what[0], content, where)
    item, length = what
    if content is _ABSENT:
        content = [_ABSENT] * (length if kind == Nodetype.ARRAY else 0)
    if not isinstance(content, list):
        raise ConfigError(f"{where}: {content!r:.60}: must be a list")
    if kind == Nodetype.ARRAY and len(content) != length:
        raise ConfigError(f"{where}: {content!r:.60}: must be a list of {length}")
    items = [_value(item, one, f"{where}[{index}]") for index, one in enumerate(content)]
    if item[0] == Nodetype.BASE and item[1][0] != "string":
        return np.array(items, item[1][0])
    return items


def _base(kind: str, content: object, where: str) -> object:
    if kind == "string":
        text = "" if content is _ABSENT else content
        if not isinstance(text, str):
            raise ConfigError(f"{where}: {content!r:.60}: must be a string")
        try:
            text.encode()
        except UnicodeEncodeError:
            raise ConfigError(f"{where}: {content!r:.60}: must be valid Unicode") from None
        return text
    if kind == "bool":
        flag = False if content is _ABSENT else content
        if not isinstance(flag, bool):
            raise ConfigError(f"{where}: {content!r:.60}: must be true or false")
        return flag
    number = 0 if content is _ABSENT else content
    if kind in _INTEGERS:
        least, most = _INTEGERS[kind]
        if not isinstance(number, int) or isinstance(number, bool) or not least <= number <= most:
            raise ConfigError(f"{where}: {content!r:.60}: must be an integer, {least} to {most}")
        return number
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise ConfigError(f"{where}: {content!r:.60}: must be a number")
    try:
        return float(number)
    except OverflowError:
        raise ConfigError(f"{where}: {content!r:.60}: must be a number of 64 bits") from None

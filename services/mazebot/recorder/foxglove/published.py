"""Messages that a client of Foxglove publishes, as those of the topic table."""

from __future__ import annotations

import json
from typing import Any, cast

import numpy as np
from rosbags.interfaces import Nodetype

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import BY_NAME, CMD_VEL, CMD_VEL_TELEOP, EDGE, TOPICS, Topic

_VELOCITIES: tuple[Topic[Any], ...] = (CMD_VEL, CMD_VEL_TELEOP)
JSON, CDR = "json", "cdr"
_NUMBERS = {
    **{f"{sign}int{bits}": 0 for sign in ("", "u") for bits in (8, 16, 32, 64)},
    "float32": 0.0, "float64": 0.0,
}  # fmt: skip
_ZEROS: dict[str, Any] = {**_NUMBERS, "bool": False, "string": ""}
_TWIST = msg.Twist.__msgtype__
"""What Foxglove's Teleop panel sends."""


class PublishedError(ConfigError):
    """A message that is not taken; the text is one line."""


def topic_of(name: str, type_name: str) -> Topic[Any]:
    """The topic on which a client wants to publish.

    Raises PublishedError where the user's tools may not, or the type is another one.
    """
    topic = BY_NAME.get(name)
    if topic is None or EDGE not in topic.owners:
        names = ", ".join(topic.name for topic in TOPICS if EDGE in topic.owners)
        raise PublishedError(f"{name}: clients may publish {names}")
    kind = _full(type_name)
    if kind != wire.type_name(topic) and not (topic in _VELOCITIES and kind == _TWIST):
        raise PublishedError(f"{name}: {type_name}: must be {wire.type_name(topic)}")
    return topic


def message_of(topic: Topic[Any], type_name: str, data: bytes, encoding: str, now_ns: int) -> Any:
    """A client's message. Its stamp is the time of now: clients know only that of their own clock.

    Raises PublishedError where it cannot be read.
    """
    kind = _full(type_name)
    try:
        if encoding == JSON:
            message = _from_json(kind, json.loads(data))
        else:
            message = msg.TYPESTORE.deserialize_cdr(data, kind)
    except Exception as error:
        raise PublishedError(f"{topic.name}: is not a valid {kind} in {encoding}") from error
    if kind == _TWIST and topic in _VELOCITIES:
        return msg.TwistStamped(
            msg.header(now_ns, BASE_FOOTPRINT_FRAME), cast("msg.Twist", message)
        )
    if hasattr(message, "header"):
        message.header.stamp = msg.time_from_ns(now_ns)
    return message


def _from_json(kind: str, values: Any) -> Any:
    """A message of its fields; as in ROS, those that are not given are zero."""
    fields = msg.TYPESTORE.fielddefs[kind][1]
    if unknown := values.keys() - {name for name, _ in fields}:
        raise ValueError(f"{kind}: {unknown}")
    return msg.TYPESTORE.types[kind](
        **{name: _field(what, values.get(name)) for name, what in fields}
    )


def _field(what: Any, value: Any) -> Any:
    kind, inner = what
    if kind == Nodetype.NAME:
        return _from_json(inner, value or {})
    if kind == Nodetype.BASE:
        return _ZEROS[inner[0]] if value is None else type(_ZEROS[inner[0]])(value)
    (item_kind, item), length = inner
    items = value or [None] * (length if kind == Nodetype.ARRAY else 0)
    made = [_field((item_kind, item), one) for one in items]
    if item_kind == Nodetype.BASE and item[0] in _NUMBERS:
        return np.array(made, np.dtype(item[0]))
    return made


def _full(type_name: str) -> str:
    """A type's name as ROS 2 has it: panels made for ROS 1 say `geometry_msgs/Twist`."""
    package, _, rest = type_name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else type_name

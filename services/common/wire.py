"""Topic to key expression, message to bytes and back, and what no message may hold."""

from __future__ import annotations

import functools
import itertools
import math
import operator
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np
from pydantic import ValidationError
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError

from services.common import messages as msg
from services.common.documents import Document
from services.common.topics import Query, Topic

M = TypeVar("M")
D = TypeVar("D", bound=Document)

MAX_MESSAGE_BYTES = 64 * 1024 * 1024

# A lidar has no echo at inf; a covariance of -1 or a huge one is an honest answer. Only these may
# be infinite.
_MAY_BE_INFINITE = {("sensor_msgs/msg/LaserScan", "ranges")}
_FEW = 40
"""Numbers in an array that are looked at faster in Python than in numpy."""


class WireError(ValueError):
    """A message that must not cross a service's boundary; `reason` is a short phrase to count it
    by.
    """

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason


def key_from_topic(topic: Topic[M] | Query[Any, Any], prefix: str = "") -> str:
    """Zenoh key expression of a topic or a query: the plain ROS name without its slash, as
    zenoh-bridge-ros2dds has it.
    """
    return prefix + topic.name.removeprefix("/")


def type_name(topic: Topic[M]) -> str:
    """ROS type name of what a topic carries on the wire."""
    if issubclass(topic.type, Document):
        return msg.String.__msgtype__
    return cast("type[msg.RosMessage]", topic.type).__msgtype__


def encode(topic: Topic[M], message: M) -> bytes:
    """CDR bytes (XCDR1, little endian) of a message; a document travels as JSON in std_msgs/String.

    Raises WireError where the message does not fit its type.
    """
    try:
        if isinstance(message, Document):
            return encode_document(message)
        return bytes(msg.TYPESTORE.serialize_cdr(message, type_name(topic)))
    except (AttributeError, TypeError, ValueError, struct.error, SerdeError) as error:
        raise WireError("not of its type", str(error)) from error


def encode_document(document: Document) -> bytes:
    """CDR bytes of the std_msgs/String that carries a document as JSON."""
    text = msg.String(data=document.model_dump_json())
    return bytes(msg.TYPESTORE.serialize_cdr(text, msg.String.__msgtype__))


def decode(topic: Topic[M], data: bytes) -> M:
    """The message in CDR bytes.

    Raises WireError where they hold none of the topic's type.
    """
    if issubclass(topic.type, Document):
        return cast("M", decode_document(topic.type, data))
    return cast("M", _decode(type_name(topic), data))


def decode_document(kind: type[D], data: bytes) -> D:
    """The document of a kind in CDR bytes.

    Raises WireError where they hold none.
    """
    text = cast("msg.String", _decode(msg.String.__msgtype__, data)).data
    try:
        return kind.model_validate_json(text)
    except ValidationError as error:
        raise WireError("not of its schema", _first_mistake(error)) from error
    except RecursionError as error:
        raise WireError("malformed", str(error)) from error


def _decode(type_name_: str, data: bytes) -> object:
    if len(data) > MAX_MESSAGE_BYTES:
        raise WireError("too large", f"{len(data)} bytes")
    try:
        return msg.TYPESTORE.deserialize_cdr(data, type_name_)
    except (SerdeError, RecursionError, MemoryError, OverflowError, AssertionError) as error:
        raise WireError("malformed", str(error)) from error


def _first_mistake(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    field = ".".join(map(str, first["loc"]))
    return f"{field}: {first['msg']}" if field else first["msg"]


def validate(topic: Topic[M], message: M) -> None:
    """Check what types cannot say.

    Raises WireError where a number is not finite, an array has the wrong length, or a rotation is
    none.
    """
    if not isinstance(message, topic.type):
        raise WireError("not of its type", type(message).__name__)
    if isinstance(message, Document):
        return
    try:
        problem = _checker(type_name(topic))(message)
    except (TypeError, AttributeError, ValueError, OverflowError) as error:
        raise WireError("not of its type", str(error)) from error
    if problem:
        raise WireError(problem)


_Check = Callable[[Any], str]
_Get = Callable[[Any], Any]


@dataclass
class _Fields:
    """Dotted paths of what has to be looked at in a message."""

    numbers: list[str]
    arrays: list[tuple[str, bool]]
    """With whether its values may be infinite."""
    extras: list[tuple[str, _Check]]
    lists: list[tuple[str, str]]
    """With the type of their messages."""


@functools.cache
def _checks(type_name_: str) -> tuple[_Get | None, list[tuple[_Get, _Check]]]:
    """What fetches all numbers of a message in one call, since most messages hold little else and
    each is checked, and what else has to be fetched and looked at.
    """
    fields = _Fields([], [], [], [])
    _collect(type_name_, "", fields)
    numbers = _all_of(fields.numbers)
    checks: list[tuple[_Get, _Check]] = [
        (operator.attrgetter(path), _nan if inf else _not_finite) for path, inf in fields.arrays
    ]
    checks += [
        (operator.attrgetter(path) if path else _itself, extra) for path, extra in fields.extras
    ]
    checks += [
        (operator.attrgetter(path), functools.partial(_each, item)) for path, item in fields.lists
    ]
    return numbers, checks


@functools.cache
def _checker(type_name_: str) -> _Check:
    """The function that looks through a message of a type; made once."""
    numbers, checks = _checks(type_name_)

    def check(message: object) -> str:
        if numbers is not None and not _all_finite(numbers(message)):
            return "not finite"
        for get, problem_of in checks:
            problem = problem_of(get(message))
            if problem:
                return problem
        return ""

    return check


def _collect(type_name_: str, prefix: str, fields: _Fields) -> None:
    """Note what has to be looked at in a type, and in the types within it."""
    for name, (kind, what) in msg.TYPESTORE.fielddefs[type_name_][1]:
        path = prefix + name
        is_list = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        item_kind, item = cast("tuple[Nodetype, Any]", what[0] if is_list else (kind, what))
        if item_kind == Nodetype.NAME:
            if not is_list:
                _collect(item, f"{path}.", fields)
            elif _checks(item) != (None, []):
                fields.lists.append((path, item))
        elif item[0] in ("float32", "float64"):
            if is_list:
                fields.arrays.append((path, (type_name_, name) in _MAY_BE_INFINITE))
            else:
                fields.numbers.append(path)
    if type_name_ in _EXTRA:
        fields.extras.append((prefix.removesuffix("."), _EXTRA[type_name_]))


def _all_of(paths: list[str]) -> _Get | None:
    """What fetches the values at the paths as a tuple; None where there are none."""
    if not paths:
        return None
    get: _Get = operator.attrgetter(*paths)
    return get if len(paths) > 1 else lambda message: (get(message),)


def _itself(message: object) -> object:
    return message


def _all_finite(values: Sequence[float]) -> bool:
    # A sum is finite where all are, but for those too large for one.
    return math.isfinite(sum(values)) or all(map(math.isfinite, values))


def _not_finite(values: Any) -> str:
    if len(values) <= _FEW:
        return "" if _all_finite(values.tolist()) else "not finite"
    return "" if np.isfinite(values).all() else "not finite"


def _nan(values: Any) -> str:
    return "not finite" if np.isnan(values).any() else ""


def _each(type_name_: str, messages: list[object]) -> str:
    numbers, checks = _checks(type_name_)
    if numbers is not None:
        if not _all_finite(list(itertools.chain.from_iterable(map(numbers, messages)))):
            return "not finite"
    for get, problem_of in checks:
        for value in map(get, messages):
            problem = problem_of(value)
            if problem:
                return problem
    return ""


def _image(image: msg.Image) -> str:
    return "" if len(image.data) == image.height * image.step else "wrong length"


def _grid(grid: msg.OccupancyGrid) -> str:
    return "" if len(grid.data) == grid.info.height * grid.info.width else "wrong length"


def _unit(q: msg.Quaternion) -> str:
    norm = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    return "" if abs(norm - 1.0) < 1e-3 else "quaternion not of unit length"


_EXTRA: dict[str, _Check] = {
    "sensor_msgs/msg/Image": _image,
    "nav_msgs/msg/OccupancyGrid": _grid,
    "geometry_msgs/msg/Quaternion": _unit,
}

"""Topic to key expression, message to bytes and back, and what no message may hold."""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Callable
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
    except (TypeError, AttributeError, ValueError) as error:
        raise WireError("not of its type", str(error)) from error
    if problem:
        raise WireError(problem)


_Check = Callable[[Any], str]


@functools.cache
def _checker(type_name_: str) -> _Check:
    """Build, once a type, the function that looks through its fields."""
    checks: list[tuple[str, _Check]] = []
    for name, (kind, what) in msg.TYPESTORE.fielddefs[type_name_][1]:
        is_list = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        item_kind, item = cast("tuple[Nodetype, Any]", what[0] if is_list else (kind, what))
        if item_kind == Nodetype.NAME:
            inner = _checker(item)
            if inner is not _nothing:
                checks.append((name, functools.partial(_each, inner) if is_list else inner))
        elif item[0] in ("float32", "float64"):
            if not is_list:
                checks.append((name, _finite_number))
            else:
                infinite = (type_name_, name) in _MAY_BE_INFINITE
                checks.append((name, _no_nan if infinite else _finite_array))
    extra = _EXTRA.get(type_name_)
    if not checks and extra is None:
        return _nothing

    def check(message: object) -> str:
        for name, inner in checks:
            problem = inner(getattr(message, name))
            if problem:
                return problem
        return extra(message) if extra else ""

    return check


def _nothing(_: object) -> str:
    return ""


def _finite_number(value: float) -> str:
    return "" if math.isfinite(value) else "not finite"


def _finite_array(values: Any) -> str:
    return "" if np.isfinite(values).all() else "not finite"


def _no_nan(values: Any) -> str:
    return "not finite" if np.isnan(values).any() else ""


def _each(inner: _Check, values: list[object]) -> str:
    for value in values:
        problem = inner(value)
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

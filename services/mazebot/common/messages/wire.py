"""Message to bytes and back, and message validation."""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
import operator
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np
from pydantic import ValidationError
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from mazebot.common.config import printable
from mazebot.common.maths.frames import Array
from mazebot.common.messages import cdr, document_types
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Document
from mazebot.common.messages.rows import Rows
from mazebot.common.messages.topics import Topic

M = TypeVar("M")
D = TypeVar("D", bound=Document)
Buffer = bytes | memoryview

MAX_MESSAGE_BYTES = 64 * 1024 * 1024
"""Size limit of an image, a map, a file, or a document."""
MAX_SMALL_MESSAGE_BYTES = 1024 * 1024
"""Size limit of any other message."""
MAX_COORDINATE = 1e6
"""Largest component of a position (m), a velocity (m/s, rad/s) or an acceleration (m/s2)."""
MAX_NUMBER = 1e9
"""Largest value of any other number."""
MAX_IN_ARRAY = 1e12
"""Largest number in an array: a covariance of -1, or a huge one, is valid."""
MAX_CELLS = 16_000_000
"""Cells of a map: as many as the world generator makes at most."""
MIN_CELL_SIDE_M, MAX_CELL_SIDE_M = 1e-3, 1_000.0
"""As in the files of maps: with smaller cells no costmap around the robot fits in memory."""
MAX_ANGLE_RAD = 12.6
"""Of a lidar's beams: two turns. More are degrees, or what would keep a reader busy for years."""
MAX_NAME_CHARACTERS = 255
"""Maximum length of a frame's name."""

# inf is a lidar ray without an echo. Only these fields may be infinite.
_MAY_BE_INFINITE = {("sensor_msgs/msg/LaserScan", "ranges")}
# Each item costs its reader a stored frame, or an update of the filter.
_MOST_ITEMS = {
    ("tf2_msgs/msg/TFMessage", "transforms"): 1000,
    ("vision_msgs/msg/Detection3DArray", "detections"): 250,
    ("vision_msgs/msg/Detection3D", "results"): 16,
}
_COORDINATES = {"geometry_msgs/msg/Point", "geometry_msgs/msg/Vector3"}
_MAX_INTEGER = 2**63 - 1
_FEW = 40
"""Array length up to which Python checks faster than numpy."""


class WireError(ValueError):
    """An invalid message; `reason` is a short phrase by which it is counted, `detail` may quote
    whoever has sent it.
    """

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(printable(f"{reason}: {detail}") if detail else reason)
        self.reason = reason


def type_name(topic: Topic[M]) -> str:
    """ROS type name of a topic's messages on the wire."""
    kind: Any = topic.type
    return _type_name(kind)


@functools.cache
def _type_name(kind: Any) -> str:
    if _is_document(kind):
        return document_types.type_name_of(kind)
    return cast("type[msg.RosMessage]", kind).__msgtype__


@functools.cache
def _is_document(kind: Any) -> bool:
    """Asked for each message: of Pydantic's classes the answer takes as long as a short message."""
    return issubclass(kind, Document)


def encode(topic: Topic[M], message: M) -> bytes:
    """CDR bytes (XCDR1, little endian) of a message; a document's are those of its message in
    mazebot_msgs.

    Raises WireError where the message does not fit its type.
    """
    if isinstance(message, _PICTURES) and len(message.data):
        return b"".join(encode_in_pieces(topic, message))
    try:
        kind: Any = type(message)
        if _is_document(kind):
            document = cast("Document", message)
            return cdr.encode(_type_name(kind), document_types.pack(document))
        return cdr.encode(type_name(topic), message)
    except (AttributeError, TypeError, ValueError, OverflowError, struct.error) as error:
        raise WireError("wrong type", str(error)) from error


def encode_in_pieces(topic: Topic[M], message: M) -> tuple[Buffer, ...]:
    """As `encode()`, in pieces, so that a picture's bytes are not copied."""
    image: object = message
    empty: msg.Image | msg.CompressedImage
    if isinstance(image, msg.Image):
        empty = msg.Image(
            *(image.header, image.height, image.width, image.encoding, image.is_bigendian),
            *(image.step, _NO_PIXELS),
        )
    elif isinstance(image, msg.CompressedImage):
        empty = msg.CompressedImage(image.header, image.format, _NO_PIXELS)
    else:
        return (encode(topic, message),)
    try:
        pixels = np.ascontiguousarray(image.data, np.uint8).data
    except (TypeError, ValueError) as error:
        raise WireError("wrong type", str(error)) from error
    # They come last, after their number.
    head = encode(topic, cast("M", empty))
    return head[: -_LENGTH.size] + _LENGTH.pack(len(pixels)), pixels


_PICTURES = (msg.Image, msg.CompressedImage)
_NO_PIXELS = np.zeros(0, np.uint8)
_LENGTH = struct.Struct("<I")


def encode_json(document: Document) -> bytes:
    """CDR bytes of a std_msgs/String with a document as JSON: of a query, whose keys are Mazebot's
    own.
    """
    return cdr.encode(msg.String.__msgtype__, msg.String(data=document.model_dump_json()))


def of_own_type(topic: Topic[M], data: bytes) -> bytes:
    """The CDR bytes of a message of the topic's own type; `data` may be of one that it takes, too:
    a Twist becomes a TwistStamped without time and frame.
    """
    if msg.Twist in topic.also and len(data) == _TWIST_BYTES:
        return _UNSTAMPED + data[4:]
    return data


_TWIST_BYTES = 4 + 6 * 8
# Of a TwistStamped: encapsulation, time 0, an empty frame with its length, up to a multiple of 8.
_UNSTAMPED = struct.pack("<4sqI4s", b"\0\1\0\0", 0, 1, b"")


def decode(topic: Topic[M], data: bytes) -> M:
    """The message in CDR bytes.

    Raises WireError where they are no message of the topic's type.
    """
    if issubclass(topic.type, Document):
        return cast("M", _decode_document(topic.type, data))
    return cast("M", _decode(type_name(topic), data))


def _decode_document(kind: type[D], data: bytes) -> D:
    return document_of(kind, _decode(document_types.type_name_of(kind), data))


def document_of(kind: type[D], message: Any) -> D:
    """The document of a kind in its message of mazebot_msgs.

    Raises WireError where it is no such document.
    """
    with _invalid_schema():
        return kind.model_validate(document_types.unpack(kind, message))


def decode_json(kind: type[D], data: bytes) -> D:
    """The document of a kind in the CDR bytes of a std_msgs/String.

    Raises WireError where they are no such document.
    """
    text = cast("msg.String", _decode(msg.String.__msgtype__, data)).data
    with _invalid_schema():
        return kind.model_validate_json(text)


@contextlib.contextmanager
def _invalid_schema() -> Iterator[None]:
    try:
        yield
    except ValidationError as error:
        raise WireError("invalid schema", _first_mistake(error)) from error
    except RecursionError as error:
        raise WireError("malformed", str(error)) from error
    except ValueError as error:
        raise WireError("invalid schema", str(error)) from error


def decoder_of_another_version(
    topic: Topic[M], type_name_: str, definition: str
) -> Callable[[bytes], M] | None:
    """A function that decodes a topic's documents as another version of Mazebot recorded them: with
    other fields, or as JSON in std_msgs/String, as before mazebot_msgs. It raises WireError.

    None: they are of another type, or as in this version. `definition` is the text of the type and
    of those in it; empty where it is not known.
    """
    kind = cast("type[Document]", topic.type)
    if not issubclass(kind, Document):
        return None
    if type_name_ == msg.String.__msgtype__:
        return cast("Callable[[bytes], M]", functools.partial(decode_json, kind))
    if type_name_ != type_name(topic) or not definition:
        return None
    try:
        types = get_types_from_msg(definition, type_name_)
        if all(msg.TYPESTORE.fielddefs.get(name) == found for name, found in types.items()):
            return None
        store = get_typestore(Stores.EMPTY)
        store.register(types)
    except (TypesysError, ValueError, KeyError, AssertionError):
        return None

    def decode_theirs(data: bytes) -> M:
        try:
            message = store.deserialize_cdr(data, type_name_)
        except (SerdeError, RecursionError, MemoryError, OverflowError, AssertionError) as error:
            raise WireError("malformed", str(error)) from error
        return cast("M", document_of(kind, message))

    return decode_theirs


def _decode(type_name_: str, data: bytes) -> object:
    if len(data) > most_bytes(type_name_):
        raise WireError("too large", f"{len(data)} bytes")
    try:
        return msg.TYPESTORE.deserialize_cdr(data, type_name_)
    except (SerdeError, RecursionError, MemoryError, OverflowError, AssertionError) as error:
        raise WireError("malformed", str(error)) from error


def decode_type(type_name_: str, data: bytes) -> Any:
    """The message of a ROS type in CDR bytes.

    Raises WireError where they are none, or where it has invalid values, as of `validate`.
    """
    message = read_type(type_name_, data)
    problem = _checker(type_name_)(message)
    if problem:
        raise WireError(problem)
    return message


def read_type(type_name_: str, data: bytes) -> Any:
    """As `decode_type`, with any values."""
    return _decode(type_name_, data)


@functools.cache
def most_bytes(type_name_: str) -> int:
    """Size limit of a type: the large one with a byte array, and for documents."""
    if type_name_ == msg.String.__msgtype__ or type_name_.startswith(document_types.PACKAGE):
        return MAX_MESSAGE_BYTES
    for _, (kind, what) in msg.TYPESTORE.fielddefs[type_name_][1]:
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            item_kind, item = cast("tuple[Nodetype, Any]", what[0])
            if item_kind != Nodetype.NAME and item[0] in ("uint8", "int8", "byte"):
                return MAX_MESSAGE_BYTES
    return MAX_SMALL_MESSAGE_BYTES


def _first_mistake(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    field = ".".join(map(str, first["loc"]))
    return f"{field}: {first['msg']}" if field else first["msg"]


def validate(topic: Topic[M], message: M) -> None:
    """Check a message's type and values.

    Raises WireError where the type is wrong, a number is not finite or too large, an array has the
    wrong length, a list has too many items, a quaternion is not of unit length, or frames form a
    cycle.
    """
    # The first comparison alone is several times as fast for a document, whose class is abstract.
    if type(message) is not topic.type and not isinstance(message, topic.type):
        raise WireError("wrong type", type(message).__name__)
    try:
        problem = _checker_of(cast("Any", topic.type))(message)
    except (TypeError, AttributeError, ValueError, OverflowError) as error:
        raise WireError("wrong type", str(error)) from error
    if problem:
        raise WireError(problem)


def _document(document: Document) -> str:
    """The problem of any number in a document; empty: none."""
    waiting: list[Any] = list(document.__dict__.values())
    while waiting:
        value = waiting.pop()
        kind = type(value)
        if kind is float:
            if not -MAX_NUMBER <= value <= MAX_NUMBER:
                return _OUT_OF_RANGE if math.isfinite(value) else _NOT_FINITE
        elif kind is int:
            if not -_MAX_INTEGER <= value <= _MAX_INTEGER:
                return _OUT_OF_RANGE
        elif kind is tuple or kind is list:
            waiting.extend(value)
        elif kind is dict:
            waiting.extend(value.values())
        elif isinstance(value, Document):
            waiting.extend(value.__dict__.values())
    return ""


_Check = Callable[[Any], str]
_Get = Callable[[Any], Any]
_NOT_FINITE, _OUT_OF_RANGE, _TOO_MANY = "not finite", "out of range", "too many items"
_WRONG_LENGTH = "wrong length"


@dataclass
class _Fields:
    """Dotted paths of the fields to check in a message."""

    coordinates: list[str]
    numbers: list[str]
    """Numbers that are not coordinates."""
    arrays: list[tuple[str, _Check]]
    extras: list[tuple[str, _Check]]
    lists: list[tuple[str, str, int]]
    """Path, type of the items, and the maximum number of items."""


@dataclass(frozen=True)
class _Checks:
    """The checks of a message type.

    Most messages consist mainly of numbers, and each one is checked: one call fetches all of them.
    """

    coordinates: _Get | None
    numbers: _Get | None
    others: list[tuple[_Get, _Check]]


@functools.cache
def _checks(type_name_: str) -> _Checks:
    fields = _Fields([], [], [], [], [])
    _collect(type_name_, "", fields)
    checks: list[tuple[_Get, _Check]] = [
        (operator.attrgetter(path), problem_of) for path, problem_of in fields.arrays
    ]
    checks += [
        (operator.attrgetter(path), functools.partial(_each, item, most))
        for path, item, most in fields.lists
    ]
    checks += [
        (operator.attrgetter(path) if path else _itself, extra) for path, extra in fields.extras
    ]
    return _Checks(_all_of(fields.coordinates), _all_of(fields.numbers), checks)


@functools.cache
def _checker_of(kind: type[Any]) -> _Check:
    """The function that validates messages of a class; made once."""
    return _document if issubclass(kind, Document) else _checker(kind.__msgtype__)


@functools.cache
def _checker(type_name_: str) -> _Check:
    checks = _checks(type_name_)
    limits = [
        (get, largest)
        for get, largest in ((checks.coordinates, MAX_COORDINATE), (checks.numbers, MAX_NUMBER))
        if get is not None
    ]
    others = checks.others

    def check(message: object) -> str:
        for get, largest in limits:
            values = get(message)
            if not math.hypot(*values) <= largest:
                problem = _within(values, largest)
                if problem:
                    return problem
        for get_one, problem_of in others:
            problem = problem_of(get_one(message))
            if problem:
                return problem
        return ""

    return check


def _collect(type_name_: str, prefix: str, fields: _Fields) -> None:
    """Collect the fields to check in a type, and in its nested types."""
    if type_name_ == msg.BatteryState.__msgtype__:
        fields.extras.append((prefix.removesuffix("."), _battery))
        return
    for name, (kind, what) in msg.TYPESTORE.fielddefs[type_name_][1]:
        path = prefix + name
        is_list = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        item_kind, item = cast("tuple[Nodetype, Any]", what[0] if is_list else (kind, what))
        if item_kind == Nodetype.NAME:
            if is_list:
                most = _MOST_ITEMS.get((type_name_, name), MAX_SMALL_MESSAGE_BYTES)
                fields.lists.append((path, item, most))
            else:
                _collect(item, f"{path}.", fields)
        elif item[0] in ("float32", "float64"):
            if kind == Nodetype.ARRAY:
                fields.arrays.append((path, _array_of(cast("int", what[1]))))
            elif is_list:
                may_be_infinite = (type_name_, name) in _MAY_BE_INFINITE
                fields.arrays.append((path, _array_with_inf if may_be_infinite else _array))
            elif type_name_ in _COORDINATES:
                fields.coordinates.append(path)
            else:
                fields.numbers.append(path)
    if type_name_ in _EXTRA:
        fields.extras.append((prefix.removesuffix("."), _EXTRA[type_name_]))


def _all_of(paths: list[str]) -> _Get | None:
    """A getter of the values at the paths as a tuple; None where there are no paths."""
    if not paths:
        return None
    get: _Get = operator.attrgetter(*paths)
    return get if len(paths) > 1 else lambda message: (get(message),)


def _itself(message: object) -> object:
    return message


def _within(values: Sequence[float], largest: float) -> str:
    """The problem of some numbers; empty: none. Their norm is at least each one's magnitude."""
    if math.hypot(*values) <= largest or all(-largest <= value <= largest for value in values):
        return ""
    return _OUT_OF_RANGE if all(map(math.isfinite, values)) else _NOT_FINITE


def _array(values: Any) -> str:
    if len(values) <= _FEW:
        numbers = values.tolist()
        return "" if math.hypot(*numbers) <= MAX_IN_ARRAY else _within(numbers, MAX_IN_ARRAY)
    if np.abs(values).max() <= MAX_IN_ARRAY:
        return ""
    return _OUT_OF_RANGE if np.isfinite(values).all() else _NOT_FINITE


def _array_of(length: int) -> _Check:
    """A check of an array of fixed length: of few numbers, as all such arrays are."""

    def check(values: Any) -> str:
        if len(values) != length:
            return _WRONG_LENGTH
        numbers = values.tolist()
        return "" if math.hypot(*numbers) <= MAX_IN_ARRAY else _within(numbers, MAX_IN_ARRAY)

    return check


def _array_with_inf(values: Any) -> str:
    return _NOT_FINITE if np.isnan(values).any() else ""


def _each(type_name_: str, most: int, messages: list[object]) -> str:
    if not messages:
        return ""
    if len(messages) > most:
        return _TOO_MANY
    if isinstance(messages, Rows) and _are_right(messages.numbers):
        return ""
    checks = _checks(type_name_)
    for get, largest in ((checks.coordinates, MAX_COORDINATE), (checks.numbers, MAX_NUMBER)):
        if get is not None:
            problem = _within(list(itertools.chain.from_iterable(map(get, messages))), largest)
            if problem:
                return problem
    for get_one, problem_of in checks.others:
        for problem in map(problem_of, map(get_one, messages)):
            if problem:
                return problem
    return ""


def _are_right(rows: Array) -> bool:
    """Whether all is right with points (n, 3) or poses (n, 7). To make a message of each particle
    of a cloud, and look at that, takes longer than all that is done with them.
    """
    places, turns = rows[:, :3], rows[:, 3:]
    with np.errstate(over="ignore"):
        off = np.abs((turns * turns).sum(axis=1) - 1.0) if turns.size else np.zeros(1)
    return bool(np.abs(places).max() <= MAX_COORDINATE and off.max() < msg.UNIT_WITHIN)


def _image(image: msg.Image) -> str:
    return "" if len(image.data) == image.height * image.step else _WRONG_LENGTH


def _grid(grid: msg.OccupancyGrid) -> str:
    info = grid.info
    if len(grid.data) != info.height * info.width:
        return _WRONG_LENGTH
    if len(grid.data) > MAX_CELLS:
        return "too many cells"
    return "" if MIN_CELL_SIDE_M <= info.resolution <= MAX_CELL_SIDE_M else _OUT_OF_RANGE


def _grid_update(update: msg.OccupancyGridUpdate) -> str:
    if len(update.data) != update.height * update.width:
        return _WRONG_LENGTH
    return "" if min(update.x, update.y) >= 0 else _OUT_OF_RANGE


def _battery(state: msg.BatteryState) -> str:
    """What was not measured is NaN."""
    measured = (
        state.voltage, state.temperature, state.current, state.charge, state.capacity,
        state.design_capacity, state.percentage, *state.cell_voltage, *state.cell_temperature,
    )  # fmt: skip
    return _within([float(value) for value in measured if not math.isnan(value)], MAX_NUMBER)


def _beams(scan: msg.LaserScan) -> str:
    sweep_rad = abs(scan.angle_increment) * len(scan.ranges)
    most_rad = max(abs(scan.angle_min), sweep_rad)
    return "" if most_rad <= MAX_ANGLE_RAD else "beams over more than two turns"


def _unit(q: msg.Quaternion) -> str:
    return "" if msg.is_unit(q) else "quaternion not normalized"


def _frames(tree: msg.TFMessage) -> str:
    parents = {entry.child_frame_id: entry.header.frame_id for entry in tree.transforms}
    for frame, parent in parents.items():
        if not (0 < len(frame) <= MAX_NAME_CHARACTERS and 0 < len(parent) <= MAX_NAME_CHARACTERS):
            return "empty or too long frame_id"
    return "loop in the frame tree" if msg.has_ring(parents) else ""


_EXTRA: dict[str, _Check] = {
    "sensor_msgs/msg/Image": _image,
    "sensor_msgs/msg/LaserScan": _beams,
    "nav_msgs/msg/OccupancyGrid": _grid,
    "map_msgs/msg/OccupancyGridUpdate": _grid_update,
    "geometry_msgs/msg/Quaternion": _unit,
    "tf2_msgs/msg/TFMessage": _frames,
}

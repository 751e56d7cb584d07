"""Type hashes of ROS 2 (REP-2011, `RIHS01`), computed from the text of interface definitions.

A hash is the SHA-256 of a type's description and of those of all types in it, as JSON. Comments,
constants and default values are not part of it.
"""

from __future__ import annotations

import functools
import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

from rosbags.typesys.store import Typestore

from mazebot.common.messages import messages as msg

# type_description_interfaces/msg/FieldType. In a .msg file `char` is a name of uint8.
_NESTED, _STRING, _BOUNDED = 1, 17, 4
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144
_IDS = {
    "int8": 2, "uint8": 3, "char": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7,
    "int64": 8, "uint64": 9, "float32": 10, "float64": 11, "bool": 15, "byte": 16,
    "string": _STRING, "wstring": 18,
}  # fmt: skip
_EMPTY = "uint8 structure_needs_at_least_one_member"
_FIELD = re.compile(
    r"(?P<type>[\w/]+)(?:<=(?P<bound>\d+))?(?P<list>\[(?P<at_most><=)?(?P<size>\d*)\])?\s+(?P<name>\w+)"
)
_SECTION = re.compile(r"^=+\nMSG: (\S+)\n", re.MULTILINE)


def type_hash(name: str, definitions: Mapping[str, str]) -> str:
    """The hash of a message, a service or an action, such as `std_srvs/srv/SetBool`.

    Args:
        name: the type, with its package and `msg`, `srv` or `action`.
        definitions: the text of its file and of those of all types in it, by name; for a service
            also service_msgs/msg/ServiceEventInfo, for an action also
            unique_identifier_msgs/msg/UUID, and for both builtin_interfaces/msg/Time.

    Raises ValueError where a definition is missing or has an invalid line.
    """
    texts: dict[str, str] = {}
    for each, text in definitions.items():
        texts |= messages_of(each, text)
    return hash_by_messages(name, texts)


def hash_by_messages(name: str, texts: Mapping[str, str]) -> str:
    """As `type_hash`, by the texts of the messages alone that `messages_of` gives."""
    described: dict[str, Any] = {}
    waiting = [name]
    while waiting:
        each = waiting.pop()
        if each in described:
            continue
        if each not in texts:
            raise ValueError(f"{name}: no definition of {each}")
        fields = _fields(each, texts[each])
        described[each] = {"type_name": each, "fields": fields}
        waiting += filter(None, (field["type"]["nested_type_name"] for field in fields))
    whole = {
        "type_description": described.pop(name),
        "referenced_type_descriptions": [described[each] for each in sorted(described)],
    }
    return f"RIHS01_{hashlib.sha256(json.dumps(whole).encode()).hexdigest()}"


@functools.cache
def hash_of(type_name: str) -> str:
    """The hash of a message type of `messages.TYPESTORE`."""
    return type_hash(type_name, definitions_of(type_name))


def definitions_of(type_name: str, types: Typestore = msg.TYPESTORE) -> dict[str, str]:
    """The .msg texts of a message type and of all types in it, by name."""
    text = types.generate_msgdef(type_name, ros_version=2)[0]
    first, *others = _SECTION.split(text)
    nested = {
        short.replace("/", "/msg/"): part
        for short, part in zip(others[::2], others[1::2], strict=True)
    }
    return {type_name: first, **nested}


def messages_of(name: str, text: str) -> dict[str, str]:
    """The messages that a definition of a message, a service or an action consists of, as .msg
    texts by name; a service and an action are themselves among them.
    """
    kind = name.split("/")[1]
    if kind == "msg":
        return {name: text}
    parts = re.split(r"^---[ \t]*$", text, flags=re.MULTILINE)
    count = 2 if kind == "srv" else 3
    if len(parts) != count:
        raise ValueError(f"{name}: must have {count} parts, with --- between")
    if kind == "srv":
        return _service(name, *parts)
    of_goal = "unique_identifier_msgs/UUID goal_id\n"
    return {
        f"{name}_Goal": parts[0],
        f"{name}_Result": parts[1],
        f"{name}_Feedback": parts[2],
        f"{name}_FeedbackMessage": f"{of_goal}{name}_Feedback feedback",
        name: f"{name}_Goal goal\n{name}_Result result\n{name}_Feedback feedback\n"
        f"{name}_SendGoal send_goal_service\n{name}_GetResult get_result_service\n"
        f"{name}_FeedbackMessage feedback_message",
        **_service(
            f"{name}_SendGoal",
            f"{of_goal}{name}_Goal goal",
            "bool accepted\nbuiltin_interfaces/Time stamp",
        ),
        **_service(f"{name}_GetResult", of_goal, f"int8 status\n{name}_Result result"),
    }


def _service(name: str, request: str, response: str) -> dict[str, str]:
    request_name, response_name, event = (f"{name}_{it}" for it in ("Request", "Response", "Event"))
    return {
        request_name: request,
        response_name: response,
        event: "service_msgs/ServiceEventInfo info\n"
        f"{request_name}[<=1] request\n{response_name}[<=1] response",
        name: f"{request_name} request_message\n{response_name} response_message\n"
        f"{event} event_message",
    }


def _fields(name: str, text: str) -> list[dict[str, Any]]:
    """The fields of a .msg text, as type_description_interfaces/msg/Field without defaults."""
    fields = [
        _field(name, line)
        for line in (line.partition("#")[0].strip() for line in text.splitlines())
        if line and not _is_constant(line)
    ]
    return fields or [_field(name, _EMPTY)]


def _is_constant(line: str) -> bool:
    # The bound of a string or a list comes before the first space.
    return "=" in line.partition(" ")[2]


def _field(message: str, line: str) -> dict[str, Any]:
    found = _FIELD.match(line)
    if found is None:
        raise ValueError(f"{message}: {line!r:.80}: must be a type and a name")
    kind, bound = found["type"], int(found["bound"] or 0)
    id_, nested = _IDS.get(kind, _NESTED), ""
    if id_ == _NESTED:
        package, _, short = kind.rpartition("/")
        package = package or message.partition("/")[0]
        nested = kind if "/" in package else f"{package}/msg/{short}"
    if bound:
        id_ += _BOUNDED
    size = int(found["size"] or 0)
    if found["list"]:
        id_ += _BOUNDED_SEQUENCE if found["at_most"] else _ARRAY if size else _SEQUENCE
    return {
        "name": found["name"],
        "type": {
            "type_id": id_,
            "capacity": size,
            "string_capacity": bound,
            "nested_type_name": nested,
        },
    }

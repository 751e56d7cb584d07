"""Messages of ROS 1, as bags and MCAP files hold them: those whose definition is the same in ROS 2
come as CDR.
"""

from __future__ import annotations

from typing import Any, cast

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
    Nodetype,
)
from rosbags.typesys import TypesysError, get_types_from_msg
from rosbags.typesys.msg import normalize_msgtype

from mazebot.common.messages import messages as msg

CDR = "cdr"
ROS_1 = "ros1"
"""The encoding of a topic whose messages are not the same in ROS 2."""
_HEADER = "std_msgs/msg/Header"
_RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
_NONE = MessageDefinition(MessageDefinitionFormat.NONE, "")


def ros1_connection(number: int, topic: str, kind: str, definition: str, owner: Any) -> Connection:
    """A topic of ROS 1 with the names that it has in ROS 2. Its encoding is CDR where `as_cdr`
    converts its messages: without a definition, they are taken to be of the type of this name.
    """
    given = normalize_msgtype(kind)
    name = _RENAMED.get(given, given)
    encoding = CDR if _is_of_ros_2(given, definition, name) else ROS_1
    return Connection(
        number, f"/{topic.strip('/')}", name, _NONE, "", 0, ConnectionExtRosbag2(encoding, []),
        owner,
    )  # fmt: skip


def as_cdr(connection: Connection, data: bytes) -> bytes:
    """A message of ROS 1 in CDR; empty, which nobody takes for one, where it is damaged."""
    if cast("ConnectionExtRosbag2", connection.ext).serialization_format != CDR:
        return data
    try:
        return bytes(msg.TYPESTORE.ros1_to_cdr(data, connection.msgtype))
    except Exception:
        return b""


def _is_of_ros_2(given: str, definition: str, name: str) -> bool:
    """Whether messages of a type, by the bag's own definition, have the fields of ROS 2's type:
    names in another case, as in CameraInfo, are the same bytes. Its header has a number more, which
    the conversion leaves out.
    """
    if name not in msg.TYPESTORE.fielddefs:
        return False
    if not definition:
        return True
    try:
        types = get_types_from_msg(definition, given)
    except (TypesysError, ValueError, KeyError, AssertionError):
        return False
    return _are_alike(types, given, name)


def _are_alike(types: Any, given: str, name: str) -> bool:
    if given not in types:
        # Time and duration, which every definition has.
        return given == name
    theirs: list[tuple[str, Any]] = types[given][1]
    ours: list[tuple[str, Any]] = msg.TYPESTORE.fielddefs[name][1]
    if name == _HEADER:
        theirs = [one for one in theirs if one[0] != "seq"]
    if len(theirs) != len(ours):
        return False
    for (their_name, what), (our_name, our_what) in zip(theirs, ours, strict=True):
        if their_name.lower() != our_name.lower():
            return False
        kind, inner = what
        our_kind, our_inner = our_what
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) and kind == our_kind:
            if inner[1:] != our_inner[1:]:
                return False
            (kind, inner), (our_kind, our_inner) = inner[0], our_inner[0]
        if kind == our_kind == Nodetype.NAME:
            if inner != our_inner or not _are_alike(types, inner, our_inner):
                return False
        elif (kind, inner) != (our_kind, our_inner):
            return False
    return True

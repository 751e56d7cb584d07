"""The envelope of a message as Zenoh's attachment."""

from __future__ import annotations

import struct
from typing import TypeVar

from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Envelope

M = TypeVar("M")

# rmw_zenoh's attachment: sequence number, source time, gid with its length. Ours is followed by the
# world's hash and the topic's name, which rmw_zenoh does not read.
_ROS = struct.Struct("<qqB16s")
_ATTACHMENT = struct.Struct("<qqB16s16s")
_INVALID = "invalid attachment"


def pack_attachment(topic: Topic[M], envelope: Envelope) -> bytes:
    """The attachment of a message of a topic."""
    fixed = _ATTACHMENT.pack(
        envelope.sequence,
        envelope.sent_ns,
        16,
        bytes.fromhex(envelope.source),
        envelope.world_hash.encode("ascii"),
    )
    return fixed + topic.name.encode()


def pack_ros_attachment(sequence: int, sent_ns: int, gid: bytes) -> bytes:
    """The attachment of a request or a reply of a ROS service: a reply has the number and the 16
    bytes of its request.
    """
    return _ROS.pack(sequence, sent_ns, 16, gid)


def unpack_ros_attachment(data: bytes) -> tuple[int, bytes]:
    """The sequence number and the sender's 16 bytes in the attachment of a ROS node. Raises
    ValueError where it is invalid.
    """
    if len(data) < _ROS.size:
        raise ValueError(_INVALID)
    sequence, _, length, gid = _ROS.unpack_from(data)
    if length != 16:
        raise ValueError(_INVALID)
    return sequence, gid


def unpack_attachment(topic: Topic[M], data: bytes) -> Envelope:
    """The envelope in the attachment of a message received on a topic. One of a ROS node has the
    node's wall time, which is no time of the simulation, and no world.

    Raises ValueError where it is invalid, or names another topic: after a reconnect Zenoh may
    deliver a message under a wrong key.
    """
    if len(data) == _ROS.size:
        sequence, source = unpack_ros_attachment(data)
        if sequence < 0:
            raise ValueError(_INVALID)
        return Envelope(source.hex(), sequence, 0, "")
    fixed, name = data[: _ATTACHMENT.size], data[_ATTACHMENT.size :]
    try:
        sequence, sent_ns, length, source, world = _ATTACHMENT.unpack(fixed)
        world_hash = world.rstrip(b"\0").decode("ascii")
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(_INVALID) from error
    if length != 16 or sequence < 0 or not name:
        raise ValueError(_INVALID)
    if name != topic.name.encode():
        raise ValueError("message of another topic")
    return Envelope(source.hex(), sequence, sent_ns, world_hash)

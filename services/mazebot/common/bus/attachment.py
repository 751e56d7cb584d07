"""The envelope of a message as Zenoh's attachment."""

from __future__ import annotations

import struct
from typing import TypeVar

from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Envelope

M = TypeVar("M")

# rmw_zenoh's attachment (sequence number, source time, gid with its length), followed by the
# world's hash and the topic's name.
_ATTACHMENT = struct.Struct("<qqB16s16s")


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


def unpack_attachment(topic: Topic[M], data: bytes) -> Envelope:
    """The envelope in the attachment of a message received on a topic.

    Raises ValueError where it is invalid, or names another topic: after a reconnect Zenoh may
    deliver a message under a wrong key.
    """
    fixed, name = data[: _ATTACHMENT.size], data[_ATTACHMENT.size :]
    try:
        sequence, sent_ns, length, source, world = _ATTACHMENT.unpack(fixed)
        world_hash = world.rstrip(b"\0").decode("ascii")
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError("invalid attachment") from error
    if length != 16 or sequence < 0 or not name:
        raise ValueError("invalid attachment")
    if name != topic.name.encode():
        raise ValueError("message of another topic")
    return Envelope(source.hex(), sequence, sent_ns, world_hash)

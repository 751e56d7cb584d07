"""Messages that a client of Foxglove publishes, as those of the topic table."""

from __future__ import annotations

import json
from typing import Any, cast

from mazebot.common.client.from_fields import message_of as message_of_fields
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import BY_NAME, CMD_VEL, CMD_VEL_TELEOP, EDGE, TOPICS, Topic

_VELOCITIES: tuple[Topic[Any], ...] = (CMD_VEL, CMD_VEL_TELEOP)
JSON, CDR = "json", "cdr"
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

    Raises ConfigError where it cannot be read.
    """
    kind = _full(type_name)
    try:
        content = json.loads(data) if encoding == JSON else wire.read_type(kind, data)
    except (ValueError, RecursionError) as error:
        raise PublishedError(f"{topic.name}: is not a valid {kind} in {encoding}") from error
    message = message_of_fields(kind, content, topic.name) if encoding == JSON else content
    if kind == _TWIST and topic in _VELOCITIES:
        return msg.TwistStamped(
            msg.header(now_ns, BASE_FOOTPRINT_FRAME), cast("msg.Twist", message)
        )
    if hasattr(message, "header"):
        message.header.stamp = msg.time_from_ns(now_ns)
    return message


def _full(type_name: str) -> str:
    """A type's name as ROS 2 has it: panels made for ROS 1 say `geometry_msgs/Twist`."""
    package, _, rest = type_name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else type_name

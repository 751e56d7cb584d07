"""`mazebot topic pub`: publishes a message given in JSON or YAML."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np
import yaml
from rosbags.interfaces import Nodetype

from mazebot.cli.parsing.patience import wait_quietly
from mazebot.cli.sim import stats_now
from mazebot.cli.topics.topic import named_topic
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.config import ConfigError
from mazebot.common.files.yaml_words import line_and_words
from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, MAP_FRAME
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import CMD_VEL, EDGE, Topic, owned_by
from mazebot.common.settings.known_settings import unknown_name

_INTEGERS = {
    f"{sign}int{bits}": (0 if sign else -(2 ** (bits - 1)), 2 ** (bits if sign else bits - 1) - 1)
    for sign in ("u", "")
    for bits in (8, 16, 32, 64)
}
"""Minimum and maximum value by type."""


def publish_messages(
    endpoint: str, name: str, text: str, rate_hz: float, times: int | None
) -> None:
    """Publish a message `times` times; None: until Ctrl-C.

    Raises ConfigError where the message is not of the topic's type, the user may not publish the
    topic, or no subscriber is running.
    """
    topic = named_topic(name)
    mine = [one.name for one in owned_by(EDGE)]
    if topic.name not in mine:
        raise ConfigError(
            f"topic pub: {topic.name}: only {' and '.join(topic.owners)} may publish it; "
            f"must be one of {', '.join(mine)}"
        )
    content = parsed(topic, text)
    message_at(topic, content, 0)
    with ZenohRobot(endpoint) as robot:
        if not robot.alive().keys() & set(topic.readers):
            raise ConfigError(
                f"topic pub: {topic.name}: no {' or '.join(topic.readers)} is running"
            )
        begin_ns = round(stats_now(robot, "topic pub").sim_time_s * 1e9)
        sent, next_s = 0, time.monotonic()
        while times is None or sent < times:
            time.sleep(max(next_s - time.monotonic(), 0.0))
            next_s += 1.0 / rate_hz
            robot.publish(topic, message_at(topic, content, robot.now_ns() or begin_ns))
            sent += 1
            sys.stdout.write(f"published {sent} on {topic.name}\n")
            sys.stdout.flush()
            wait_quietly()


def parsed(topic: Topic[object], text: str) -> object:
    """The content of a text in JSON or YAML. Raises ConfigError."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        pass
    try:
        return yaml.load(text, yaml.CSafeLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = line_and_words(error)[1]
        raise ConfigError(
            f"topic pub: {topic.name}: {text!r:.60}: neither JSON nor YAML: {reason}"
        ) from error


def message_at(topic: Topic[object], content: object, now_ns: int) -> object:
    """The message of a topic with fields as given, the others zero. A missing stamp is `now_ns`, a
    missing frame that of the topic.

    Raises ConfigError where a field is unknown, of another type or out of range.
    """
    message: Any = _built(wire.type_name(topic), content, f"topic pub: {topic.name}")
    header = getattr(message, "header", None)
    if header is not None and not (header.stamp.sec or header.stamp.nanosec):
        header.stamp = msg.header(now_ns, "").stamp
    if header is not None and not header.frame_id:
        header.frame_id = BASE_FOOTPRINT_FRAME if topic.name == CMD_VEL.name else MAP_FRAME
    try:
        wire.validate(topic, message)
    except wire.WireError as error:
        raise ConfigError(f"topic pub: {topic.name}: {content!s:.60}: {error}") from error
    return message


def _built(kind: str, content: object, where: str) -> object:
    """A message of a ROS type."""
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
        name: _value(spec, content.get(name), f"{where}.{name}") for name, spec in fields.items()
    }
    return msg.TYPESTORE.types[kind](**values)


def _value(spec: Any, content: object, where: str) -> object:
    """A field's value, converted to its type; None: not given."""
    kind, what = spec
    if kind == Nodetype.NAME:
        return _built(what, {} if content is None else content, where)
    if kind == Nodetype.BASE:
        return _base(what[0], content, where)
    item, length = what
    given = [] if content is None else content
    if not isinstance(given, list):
        raise ConfigError(f"{where}: {content!r:.60}: must be a list")
    if kind == Nodetype.ARRAY and content is None:
        given = [None] * length
    if kind == Nodetype.ARRAY and len(given) != length:
        raise ConfigError(f"{where}: {content!r:.60}: must be a list of {length}")
    items = [_value(item, one, f"{where}[{index}]") for index, one in enumerate(given)]
    if item[0] == Nodetype.BASE and item[1][0] != "string":
        return np.array(items, item[1][0])
    return items


def _base(kind: str, content: object, where: str) -> object:
    if kind == "string":
        if content is not None and not isinstance(content, str):
            raise ConfigError(f"{where}: {content!r:.60}: must be a string")
        return content or ""
    if kind == "bool":
        if content is not None and not isinstance(content, bool):
            raise ConfigError(f"{where}: {content!r:.60}: must be true or false")
        return bool(content)
    number = 0 if content is None else content
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

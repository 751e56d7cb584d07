"""`mazebot topic pub`: publishes a message given in JSON or YAML."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import yaml

from mazebot.cli.parsing.patience import wait_quietly
from mazebot.cli.sim import stats_now
from mazebot.cli.topics.topic import named_topic
from mazebot.common.client.from_fields import message_of
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.config import ConfigError
from mazebot.common.files.yaml_words import line_and_words
from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, MAP_FRAME
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import CMD_VEL, EDGE, Topic, owned_by


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
                f"{robot.elsewhere(*topic.readers)}"
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
    message: Any = message_of(wire.type_name(topic), content, f"topic pub: {topic.name}")
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

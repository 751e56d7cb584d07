"""`mazebot stop`: the emergency stop of a running stack's robot."""

from __future__ import annotations

import sys

from mazebot.cli.drive.task import PATIENCE_S
from mazebot.cli.parsing.options import print_json
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import EmergencyStop
from mazebot.common.messages.topics import EMERGENCY_STOP


def emergency_stop(endpoint: str, asked: EmergencyStop, as_json: bool) -> None:
    """Stop the robot and hold it at rest, or let it move again.

    Raises ConfigError where no simulator is running, or it does not answer.
    """
    with ZenohRobot(endpoint) as robot:
        reply = robot.ask(EMERGENCY_STOP, asked, PATIENCE_S)
    if reply.error:
        raise ConfigError(f"stop: {reply.error}")
    if as_json:
        print_json(asked.model_dump(mode="json"))
    elif asked.stop:
        sys.stdout.write("stopped: the robot is held at rest until `mazebot stop --clear`\n")
    else:
        sys.stdout.write("cleared: the robot may move; a task goes on\n")

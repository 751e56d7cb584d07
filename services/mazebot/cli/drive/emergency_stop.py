"""`mazebot stop`: the emergency stop of a running stack's robot."""

from __future__ import annotations

import contextlib
import sys

from mazebot.cli.drive.task import PATIENCE_S
from mazebot.cli.parsing.options import print_json
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.client.robot import Robot, RobotError
from mazebot.common.client.subscription import first_message
from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import EmergencyStop, SimulationControl
from mazebot.common.messages.topics import EMERGENCY_STOP, NAVIGATION_STATUS, SIMULATION_CONTROL

_STATUS_PATIENCE_S = 1.0
"""Wall time to wait for what navigation has told last."""


def emergency_stop(endpoint: str, asked: EmergencyStop, as_json: bool) -> None:
    """Stop the robot and hold it at rest, or let it move again.

    Raises ConfigError where no simulator is running, or it does not answer.
    """
    with ZenohRobot(endpoint) as robot:
        was_set = asked.stop or _is_stopped(robot)
        reply = robot.ask(EMERGENCY_STOP, asked, PATIENCE_S)
        if reply.error:
            raise ConfigError(f"stop: {reply.error}")
        if as_json:
            print_json(asked.model_dump(mode="json"))
        elif asked.stop:
            sys.stdout.write("stopped: the robot is held at rest until `mazebot stop --clear`\n")
        elif not was_set:
            sys.stdout.write("no emergency stop was set: the robot may move\n")
        else:
            task = "; its task goes on, unless it is paused" if _has_task(robot) else ""
            sys.stdout.write(f"cleared: the robot may move{task}\n")


def _is_stopped(robot: Robot) -> bool:
    """Whether an emergency stop is set, or may be: before a world is loaded, nobody tells."""
    stats = robot.ask(SIMULATION_CONTROL, SimulationControl(), PATIENCE_S).stats
    return stats is None or bool(stats.emergency_stop)


def _has_task(robot: Robot) -> bool:
    """Whether a navigation is running and has a task."""
    if "navigation" not in robot.alive():
        return False
    with contextlib.suppress(RobotError):
        return first_message(robot, NAVIGATION_STATUS, _STATUS_PATIENCE_S).is_busy
    return False

"""The recorder of a stack, with the rights of the user's tools for clients of Foxglove."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

from mazebot.common.messages.topics import CLOCK
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.node import RecorderNode

if TYPE_CHECKING:
    from mazebot.common.client.robot import Robot


class RecorderOnBus(RecorderNode):
    """See RecorderNode."""

    def __init__(self, config: RecorderConfig) -> None:
        super().__init__(config, robot=functools.partial(_robot, config.foxglove_key_file))


def _robot(key_file: Path | None) -> Robot:
    from mazebot.common.bus.config import BusConfig  # noqa: PLC0415 - only with Foxglove
    from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415
    from mazebot.common.client.reconnecting import ReconnectingRobot  # noqa: PLC0415
    from mazebot.common.settings.load import load  # noqa: PLC0415

    config = load(BusConfig, "bus", [])
    if key_file is not None:
        config = config.model_copy(update={"key_file": key_file})
    robot = ReconnectingRobot(lambda: ZenohRobot(config))
    # It is connected while it watches something.
    robot.watch((CLOCK,))
    return robot

"""Driving by hand: the wanted velocity is sent on as long as the page wants it, and no longer."""

from __future__ import annotations

import asyncio
import contextlib
import time

from mazebot.common.client.robot import Robot, RobotError
from mazebot.common.client.user_messages import velocity
from mazebot.common.messages.topics import CMD_VEL_TELEOP

PERIOD_S = 0.05
TIMEOUT_S = 0.4
"""The robot stops after so long without a message of the page, which sends one every 0.1 s."""
_STOPS_SENT = 3
"""A stop may be lost; without commands the robot stops by itself, but later."""


class Teleoperation:
    """What one page wants. All methods run on the event loop."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._velocity = (0.0, 0.0)
        self._received_s = 0.0
        self._task: asyncio.Task[None] | None = None

    def drive(self, linear_m_s: float, angular_rad_s: float) -> None:
        """The page wants this velocity now. Raises RobotError where no stack is running."""
        self._velocity = linear_m_s, angular_rad_s
        self._received_s = time.monotonic()
        self._send(*self._velocity)
        if self._task is None:
            self._task = asyncio.create_task(self._repeat())

    def stop(self) -> None:
        """The page wants no velocity any more, or has gone: the robot stops at once."""
        if self._task is None:
            return
        self._task.cancel()
        self._task = None
        with contextlib.suppress(RobotError):
            for _ in range(_STOPS_SENT):
                self._send(0.0, 0.0)

    async def _repeat(self) -> None:
        """The robot stops 0.2 s after the last command, so the velocity is sent again."""
        while time.monotonic() - self._received_s < TIMEOUT_S:
            await asyncio.sleep(PERIOD_S)
            with contextlib.suppress(RobotError):
                self._send(*self._velocity)
        self.stop()

    def _send(self, linear_m_s: float, angular_rad_s: float) -> None:
        self._robot.publish(CMD_VEL_TELEOP, velocity(self._robot, linear_m_s, angular_rad_s))

"""The messages of some topics, taken by the caller's thread."""

from __future__ import annotations

import time
from collections import deque
from typing import Any, Self, TypeVar

from mazebot.common.client.robot import Robot, RobotError
from mazebot.common.messages import wire
from mazebot.common.messages.documents import World
from mazebot.common.messages.topics import WORLD, Topic
from mazebot.common.node.node import Envelope

M = TypeVar("M")

_MAX_WAITING = 1000
"""Messages that wait to be taken: beyond it the oldest are dropped."""


class Subscription:
    """Messages of some topics in the order in which they are received, beginning with the latched
    ones.
    """

    def __init__(self, robot: Robot, *topics: Topic[Any]) -> None:
        self._robot = robot
        self._waiting: deque[tuple[Topic[Any], Any]] = deque(maxlen=_MAX_WAITING)
        self._is_closed = False
        self._end = robot.watch(topics, self._receive)

    def _receive(self, topic: Topic[Any], message: Any, _: Envelope) -> None:
        self._waiting.append((topic, message))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the subscription."""
        self._is_closed = True
        self._end()

    def is_waiting(self) -> bool:
        """Whether a message waits to be taken."""
        return bool(self._waiting)

    def next(self, timeout_s: float) -> tuple[Topic[Any], Any] | None:
        """The next message with its topic; None if there is none in time, see Robot.wait.

        Raises WireError for a message that cannot be decoded, RobotError where the subscription is
        closed and none is left.
        """
        if self._is_closed and not self._waiting:
            raise RobotError("the subscription is closed")
        if timeout_s > 0.0 and not self._waiting:
            self._robot.wait(timeout_s, self.is_waiting)
        if not self._waiting:
            return None
        topic, message = self._waiting.popleft()
        return topic, wire.decode(topic, message) if isinstance(message, bytes) else message


def first_message(
    robot: Robot, topic: Topic[M], timeout_s: float, missing: str = "no message"
) -> M:
    """The first message on a topic.

    Raises RobotError where none is received within `timeout_s` of wall time, or an invalid one.
    """
    end_s = time.monotonic() + timeout_s
    with Subscription(robot, topic) as messages:
        try:
            while (left_s := end_s - time.monotonic()) > 0.0:
                received = messages.next(left_s)
                if received is not None:
                    message: M = received[1]
                    return message
        except wire.WireError as error:
            raise RobotError(f"{topic.name}: {error}") from error
    raise RobotError(f"{topic.name}: {missing} within {timeout_s:g} s")


def running_world(robot: Robot, timeout_s: float) -> World:
    """The world of the stack. Raises RobotError where none is received within `timeout_s`."""
    return first_message(robot, WORLD, timeout_s, "no world")

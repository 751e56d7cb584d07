"""What an action of ROS 2 is: its type, its node, and what its goals ask, hear and end with."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

from mazebot.common.messages.topics import Query, Topic
from mazebot.common.ros.call import Response


class GoalStatus(IntEnum):
    """action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def is_terminal(self) -> bool:
        """Whether the goal has ended."""
        return self >= GoalStatus.SUCCEEDED


class Ended(NamedTuple):
    """How a goal ended."""

    status: GoalStatus
    result: Response


class Feedback(NamedTuple):
    """How far a goal is."""

    values: Response


class GoalError(ValueError):
    """A goal that is accepted and fails, with the error code of its action."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class GoalRejectedError(ValueError):
    """A goal that is not accepted."""


class Running(NamedTuple):
    """The goal is accepted."""

    heard: Callable[[Any], Feedback | Ended | None]
    """What a message on one of the topics that the action observes says of the goal."""


class TakenUp(NamedTuple):
    """A goal that runs, whoever has sent it."""

    goal_id: str
    stamp_ns: int
    """When it was accepted."""
    heard: Callable[[Any], Feedback | Ended | None]
    """As in Running."""


Ask = tuple[Query[Any, Any], Any]
"""A query of the node, and its request."""
Course = Generator[Ask | Running | Feedback, Any, Ended | None]
"""Of one goal: asks queries of the node, one after another, and accepts the goal, at the latest by
its end. Returns how the goal has ended; None: what it hears tells.
"""


@dataclass(frozen=True, eq=False)
class Action:
    """One row: an action, its type, and what its goals do."""

    name: str
    type: str
    owner: str
    run: Callable[[Any, str], Course]
    """Of a goal (a message) with an id. Raises GoalError, GoalRejectedError, and ValueError where
    the goal is malformed.
    """
    observes: tuple[Topic[Any], ...]
    cancel: Callable[[str], Ask]
    """Ends the goal with an id."""
    failed: Callable[[int | None, str], Response]
    """The result of a goal that failed, with a code and a message; None: it has no code."""
    about: str
    checkpoint: Topic[Any] | None = None
    """On which the node tells of the goal that runs, with its first message once it knows whether
    one goes on that a process before had accepted.
    """
    taken_up: Callable[[Any], TakenUp | None] = lambda _: None
    """What a message on that topic says of a goal of this action."""
    cancel_other: Callable[[str | None, int | None], Ask] | None = None
    """Ends the goal of this action that runs though it did not come as one: that with an id, or
    that accepted up to a time; None: any. None: there are no such goals.
    """

    @property
    def services(self) -> dict[str, str]:
        """The types of its services by their names: to send a goal, to cancel, for the result."""
        base = f"{self.name}/_action/"
        return {
            f"{base}send_goal": f"{self.type}_SendGoal",
            f"{base}cancel_goal": "action_msgs/srv/CancelGoal",
            f"{base}get_result": f"{self.type}_GetResult",
        }

    @property
    def topics(self) -> dict[str, str]:
        """The types of its topics by their names: feedback and status."""
        base = f"{self.name}/_action/"
        return {
            f"{base}feedback": f"{self.type}_FeedbackMessage",
            f"{base}status": "action_msgs/msg/GoalStatusArray",
        }

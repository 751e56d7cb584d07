"""Sends a goal to navigation and follows it to its result, as an action client of ROS does."""

from __future__ import annotations

import contextlib
from typing import Any, Generic, Self, TypeVar

from mazebot.common.client.robot import Robot, RobotError
from mazebot.common.client.service_watch import ServiceGoneError, ServiceWatch
from mazebot.common.client.subscription import Subscription
from mazebot.common.messages import action_documents as act
from mazebot.common.messages.documents import CancelGoal, CancelGoalReply, NavigationResult
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    CANCEL_GOAL,
    NAVIGATION_STATUS,
    SEND_GOAL,
    Topic,
)
from mazebot.common.messages.wire import WireError

R = TypeVar("R", act.ActionResult, NavigationResult)


class ActionClient(Generic[R]):
    """One goal at a time, with its feedback and its result. For one thread.

    A goal that another one preempts gets its result from navigation, as any other.
    """

    def __init__(self, robot: Robot, results: Topic[R], *also: Topic[Any]) -> None:
        """Subscribe.

        Args:
            robot: the robot.
            results: ACTION_RESULT for goals of `send`, NAVIGATION_RESULT for those on /goal_pose.
            also: further topics, whose messages `update` returns.
        """
        self._robot = robot
        self._results: Topic[R] = results
        self._messages = Subscription(robot, results, *also)
        self._end_feedback = robot.watch((ACTION_FEEDBACK, NAVIGATION_STATUS))
        self._is_closed = False
        self._navigation: ServiceWatch | None = None
        self._last_feedback: act.ActionFeedback | None = None
        self.goal: CancelGoal | None = None
        """The goal, as it would be canceled; None before the first, and where it was rejected."""
        self.result: R | None = None
        """The result of the goal; None while it is active, or before the first."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the subscriptions; a goal stays active."""
        self._is_closed = True
        self._messages.close()
        self._end_feedback()

    def _check_open(self) -> None:
        if self._is_closed:
            raise RobotError("the action client is closed")

    @property
    def is_active(self) -> bool:
        """Whether a goal was accepted, and has no result yet."""
        return self.goal is not None and self.result is None

    @property
    def feedback(self) -> act.ActionFeedback | None:
        """The newest feedback of the goal; None before the first."""
        feedback = self._robot.latest(ACTION_FEEDBACK)
        if feedback is None or self.goal is None:
            return None
        # The feedback of a goal on /goal_pose has no id.
        return feedback if feedback.goal_id == (self.goal.goal_id or "") else None

    @property
    def holds(self) -> str:
        """What holds the robot at rest, and what ends that; "" where nothing does."""
        status = self._robot.latest(NAVIGATION_STATUS)
        causes = () if status is None else status.stop_causes
        stops = (cause for cause in causes if cause.level != "slowdown")
        return next((f"{cause.cause}; cleared by {cause.cleared_by}" for cause in stops), "")

    def send(self, goal_id: str, goal: act.ActionGoal, timeout_s: float) -> act.SendGoalReply:
        """Send a goal, and follow it if it is accepted.

        Raises RobotError where there is no reply within `timeout_s` of wall time, or this client is
        closed.
        """
        self._check_open()
        self.forget()
        self.update()
        self._navigation = ServiceWatch(self._robot, "navigation")
        reply = send_goal(self._robot, goal_id, goal, timeout_s)
        if reply.accepted:
            self.goal = CancelGoal(goal_id=goal_id)
        return reply

    def follow(self, goal: CancelGoal) -> None:
        """Follow a goal that is published next, named by its stamp, in place of the one before."""
        self._check_open()
        self.goal, self.result = goal, None
        self._navigation = ServiceWatch(self._robot, "navigation")

    def forget(self) -> None:
        """Follow no goal any more."""
        self.goal = self.result = None

    def update(self, timeout_s: float = 0.0) -> list[tuple[Topic[Any], Any]]:
        """Take what was received; where nothing was, wait for it, see Robot.wait. Returns the
        messages of the further topics.

        Raises ServiceGoneError where navigation has ended or was restarted while a goal is active,
        UnreachableError where the router is lost; RobotError where this client is closed.
        """
        self._check_open()
        if timeout_s > 0.0 and not self._messages.is_waiting():
            self._robot.wait(timeout_s, self._messages.is_waiting)
        others = []
        has_received = self._messages.is_waiting()
        while self._messages.is_waiting():
            # A message of another version, or a hostile one: the services count them.
            with contextlib.suppress(WireError):
                received = self._messages.next(0.0)
                if received is not None and received[0] is self._results:
                    self._take(received[1])
                elif received is not None:
                    others.append(received)
        if self.is_active and self._navigation is not None:
            feedback = self._robot.latest(ACTION_FEEDBACK)
            has_received |= feedback != self._last_feedback
            self._last_feedback = feedback
            try:
                self._navigation.check(has_received)
            except ServiceGoneError:
                self.forget()
                raise
        return others

    def _take(self, result: R) -> None:
        if self.goal is None:
            return
        if isinstance(result, NavigationResult):
            is_mine = result.goal_stamp_ns == self.goal.goal_stamp_ns
        else:
            is_mine = result.goal_id == self.goal.goal_id
        if is_mine:
            self.result = result


def send_goal(
    robot: Robot, goal_id: str, goal: act.ActionGoal, timeout_s: float
) -> act.SendGoalReply:
    """Send a goal without following it.

    Raises RobotError where there is no reply within `timeout_s` of wall time.
    """
    return robot.ask(SEND_GOAL, act.SendGoal(goal_id=goal_id, goal=goal), timeout_s)


def cancel_goal(robot: Robot, goal: CancelGoal, timeout_s: float) -> CancelGoalReply:
    """Cancel a goal, or with an empty request whichever is active: the robot stops.

    Raises RobotError where there is no reply within `timeout_s` of wall time.
    """
    return robot.ask(CANCEL_GOAL, goal, timeout_s)


def rejection_text(reply: act.SendGoalReply) -> str:
    """Why a goal was rejected, with the nearest free pose where there is one."""
    near, text = reply.nearest_free, reply.error_msg
    if near is not None and "nearest" not in text:
        text += f"; the nearest free pose is ({near.x_m:.2f}, {near.y_m:.2f}, {near.yaw_rad:.2f})"
    return text

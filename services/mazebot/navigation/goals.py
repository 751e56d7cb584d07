"""The goal in progress: start, cancel and pause, and the results of goals that have ended."""

from __future__ import annotations

import dataclasses
import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from mazebot.common.maths.frames import MAP_FRAME, SE2
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import CancelGoal, CancelGoalReply, NavigationResult
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.navigation.behavior.actions import (
    FollowWaypoints,
    NavigateToPose,
    Request,
    TaskFeedback,
    TaskResult,
    TaskStatus,
)
from mazebot.navigation.drive import Drive
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.messages import (
    goal_result,
    planar_document,
    request_of,
    result_action,
    result_document,
    waypoint_documents,
    with_missed,
)

_LOG = logging.getLogger("navigation")
_MOST_GOALS_TRIED = 4
"""Of goals that arrive together: planning a path to each takes milliseconds."""

_PREEMPTED = "preempted by a new goal"
_ENDED_KEPT = 100
_MOST_ENDS, _SOON_NS = 3, 30_000_000_000
"""A goal on whose way navigation has ended so often, each time so soon after it was started again,
would end it again.
"""

_RESUMED = (
    act.NavigateToPose, act.NavigateThroughPoses, act.FollowWaypoints, act.FollowPath,
    act.DockRobot,
)  # fmt: skip
"""Goals that say in the map what is still to be done."""

Ready = Callable[[], Drive]
"""Raises NavigationError while navigation is not active."""


class Goal(NamedTuple):
    """How a goal was given."""

    goal_id: str
    stamp_ns: int | None
    """Of its message on /goal_pose; None: it came as an action."""
    asked: act.ActionGoal
    """As it was given."""
    start_ns: int
    resumed: int = 0
    """Times in a row that navigation ended soon on its way."""
    missed: tuple[act.WaypointStatus, ...] = ()
    """Waypoints of it that were missed so far."""
    paused: bool = False
    explores: bool = False
    """Whether it is the explorer's."""


class Goals:
    """Keeps the goal of the task that runs, and results until they are published."""

    def __init__(self) -> None:
        self.current: Goal | None = None
        self.before: Goal | None = None
        """Of the process before, which goes on as soon as navigation is active."""
        self.exploration: ExplorationStatus | None = None
        """It tells which goal is the explorer's."""
        self._resumed_ns = 0
        self._results: list[tuple[Goal, TaskResult]] = []
        self._ended: deque[str] = deque(maxlen=_ENDED_KEPT)
        """Ids of goals: a request that comes twice must not be done twice."""

    def take_poses(self, now_ns: int, poses: Sequence[msg.PoseStamped], ready: Ready) -> None:
        """Accept the newest valid goal; those before it would be preempted at once."""
        tries, taken = _MOST_GOALS_TRIED, False
        rejected: list[tuple[Goal, TaskResult]] = []
        for message in reversed(poses):
            pose = msg.se2_from_pose(message.pose)
            request = NavigateToPose(pose)
            asked = act.NavigateToPose(pose=planar_document(pose))
            stamp_ns = msg.ns_from_time(message.header.stamp)
            explores = self.exploration is not None and self.exploration.goal_stamp_ns == stamp_ns
            goal = Goal("", stamp_ns, asked, now_ns, explores=explores)
            if taken or not tries:
                preempted = (ErrorCode.PREEMPTED, _PREEMPTED)
                rejected.append((goal, goal_result(request, now_ns, *preempted)))
                continue
            tries -= 1
            try:
                if message.header.frame_id not in ("", MAP_FRAME):
                    raise NavigationError(
                        ErrorCode.TF_ERROR,
                        f"frame_id {message.header.frame_id!r:.40}: must be 'map' or empty",
                    )
                if explores and self.current is not None and not self.current.explores:
                    raise NavigationError(
                        ErrorCode.PREEMPTED, "the exploration waits: another goal comes first"
                    )
                self._start(now_ns, request, goal, ready)
            except NavigationError as error:
                level = logging.INFO if error.code == ErrorCode.PREEMPTED else logging.ERROR
                _LOG.log(level, "Goal rejected with error %d: %s", error.code, error.message)
                rejected.append((goal, goal_result(request, now_ns, error.code, error.message)))
            else:
                taken = True
        self._results += reversed(rejected)

    def send(self, now_ns: int, send: act.SendGoal, ready: Ready) -> act.SendGoalReply:
        """Accept the goal of an action. Repeating the request of the goal in progress changes
        nothing.
        """
        current = self.current
        try:
            if current is not None and current.goal_id == send.goal_id:
                if current.asked == send.goal:
                    return act.SendGoalReply(accepted=True)
                raise NavigationError(
                    ErrorCode.GOAL_REJECTED,
                    f"goal_id: {send.goal_id!r:.70}: must be unique: in use",
                )
            if send.goal_id in self._ended:
                raise NavigationError(
                    ErrorCode.GOAL_REJECTED,
                    f"goal_id: {send.goal_id!r:.70}: must be unique: this goal has ended",
                )
            goal = Goal(send.goal_id, None, send.goal, now_ns)
            self._start(now_ns, request_of(send.goal), goal, ready)
        except NavigationError as error:
            _LOG.error("Goal rejected with error %d: %s", error.code, error.message)
            near = error.nearest_free
            return act.SendGoalReply(
                accepted=False,
                error_code=int(error.code),
                error_msg=error.message,
                nearest_free=None if near is None else planar_document(near),
            )
        return act.SendGoalReply(accepted=True)

    def _start(self, now_ns: int, request: Request, goal: Goal, ready: Ready) -> None:
        """Start a task. Raises NavigationError where it is rejected; the one before continues."""
        ended = ready().navigator.start(now_ns, request, goal.start_ns, stays_paused=goal.explores)
        self._keep(ended)
        self.give_up_before(now_ns, ErrorCode.PREEMPTED, _PREEMPTED)
        self.current = goal

    def remaining(self, now_ns: int, feedback: TaskFeedback | None) -> Goal | None:
        """The goal in progress, without what is done of it; None: there is none."""
        current = self.current
        if current is not None and current.resumed and now_ns - self._resumed_ns > _SOON_NS:
            current = self.current = current._replace(resumed=0)
        if current is None or feedback is None:
            return current
        asked = current.asked
        if isinstance(asked, act.NavigateThroughPoses):
            left = len(asked.poses) - feedback.number_of_poses_remaining
            asked = asked.model_copy(update={"poses": asked.poses[left:]})
        elif isinstance(asked, act.FollowWaypoints):
            rest = {
                "goal_index": feedback.current_waypoint,
                "number_of_loops": feedback.number_of_loops,
            }
            asked = asked.model_copy(update=rest)
            missed = waypoint_documents(feedback.waypoint_statuses)
            return current._replace(asked=asked, missed=missed)
        return current._replace(asked=asked)

    def resume(self, now_ns: int, ready: Ready) -> None:
        """Go on with the goal that a process before had, or end it where it cannot be resumed."""
        if self.before is None:
            return
        goal, self.before = self.before._replace(resumed=self.before.resumed + 1), None
        request = with_missed(request_of(goal.asked), goal.missed)
        try:
            if self.current is not None:
                raise NavigationError(ErrorCode.PREEMPTED, _PREEMPTED)
            if goal.resumed >= _MOST_ENDS:
                raise NavigationError(
                    ErrorCode.NAVIGATION_RESTARTED,
                    f"navigation has ended {goal.resumed} times in a row on its way: see its log",
                )
            if not isinstance(goal.asked, _RESUMED):
                raise NavigationError(
                    ErrorCode.NAVIGATION_RESTARTED,
                    "navigation was restarted: how far the robot has moved is not known",
                )
            self._start(now_ns, request, goal, ready)
            if goal.paused:
                ready().navigator.pause()
            self._resumed_ns = now_ns
        except NavigationError as error:
            _LOG.error("Goal ended with error %d: %s", error.code, error.message)
            self._end_before(now_ns, goal, error.code, error.message)
        else:
            goes_on = "is paused, as before" if goal.paused else "goes on"
            _LOG.warning("navigation resumed: %s %s", request.action, goes_on)

    def give_up_before(self, now_ns: int, code: ErrorCode, message: str) -> None:
        """End the goal that a process before had and that does not go on yet, if there is one."""
        if self.before is not None:
            goal, self.before = self.before, None
            self._end_before(now_ns, goal, code, message)

    def _end_before(self, now_ns: int, goal: Goal, code: ErrorCode, message: str) -> None:
        canceled = code == ErrorCode.CANCELED
        ended = dataclasses.replace(
            goal_result(request_of(goal.asked), now_ns, code, message),
            status=TaskStatus.CANCELED if canceled else TaskStatus.FAILED,
            start_ns=goal.start_ns,
        )
        self._results.append((goal, ended))
        if goal.goal_id:
            self._ended.append(goal.goal_id)

    def _keep(self, result: TaskResult | None) -> None:
        if result is not None and self.current is not None:
            self._results.append((self.current, result))
            if self.current.goal_id:
                self._ended.append(self.current.goal_id)

    def end(self, result: TaskResult | None) -> None:
        """Keep the result of the goal in progress, if it has ended."""
        self._keep(result)
        if result is not None:
            self.current = None

    def cancel(self, now_ns: int, drive: Drive | None, asked: CancelGoal) -> CancelGoalReply:
        """Cancel the goal that is asked for."""
        drives = drive is not None and drive.navigator.request is not None
        running = self.current if drives else None
        goal = next((one for one in (running, self.before) if _is_meant(asked, one)), None)
        if goal is None:
            error = "no active goal"
            told = self.exploration
            if told is not None and told.state in ("exploring", "returning"):
                error += ": the exploration sends the next; false on /explore/resume stops it"
            if asked.goal_stamp_ns is not None:
                error = f"goal_stamp_ns: {asked.goal_stamp_ns}: no active goal with this stamp"
            elif asked.goal_id is not None:
                error = f"goal_id: {asked.goal_id}: no active goal with this id"
            elif asked.action is not None:
                error = f"action: {asked.action!r:.40}: no active goal of this action"
            return CancelGoalReply(error=error, return_code=2)
        if goal is self.before:
            self.give_up_before(now_ns, ErrorCode.CANCELED, "canceled")
        elif drive is not None:
            self.end(drive.navigator.cancel(now_ns))
        return CancelGoalReply(
            goal=goal.asked.pose if isinstance(goal.asked, act.NavigateToPose) else None,
            goal_stamp_ns=goal.stamp_ns or 0,
            goal_id=goal.goal_id,
            accepted_ns=goal.start_ns,
            explores=goal.explores,
        )

    def stop_exploring(self, now_ns: int, drive: Drive | None) -> None:
        """Cancel the explorer's goal where the exploration is paused."""
        told = self.exploration
        if told is None or told.state != "paused" or told.goal_stamp_ns is None:
            return
        if any(
            one is not None and one.explores and one.stamp_ns == told.goal_stamp_ns
            for one in (self.current, self.before)
        ):
            self.cancel(now_ns, drive, CancelGoal(goal_stamp_ns=told.goal_stamp_ns))

    def pause(self, drive: Drive | None, paused: bool) -> act.Reply:
        """Pause the task that runs, or the one that is to go on, or resume it."""
        if drive is not None and drive.navigator.request is not None:
            if paused:
                drive.navigator.pause()
            else:
                drive.navigator.resume()
        elif self.before is not None:
            self.before = self.before._replace(paused=paused)
        else:
            return act.Reply(error="no action is running")
        return act.Reply()

    def take_results(
        self, docks: Callable[[], Mapping[str, SE2]]
    ) -> list[NavigationResult | act.ActionResult]:
        """How goals have ended since the last call; `docks` gives poses of the docked robot."""
        if not self._results:
            return []
        documents = [
            result_action(goal.goal_id, result, docks()) if goal.stamp_ns is None
            else result_document(goal.stamp_ns, result)
            for goal, result in self._results
        ]  # fmt: skip
        self._results.clear()
        return documents


def _is_meant(asked: CancelGoal, goal: Goal | None) -> bool:
    return (
        goal is not None
        and asked.goal_stamp_ns in (None, goal.stamp_ns)
        and asked.goal_id in (None, goal.goal_id)
        and asked.action in (None, goal.asked.action)
        and (asked.accepted_until_ns is None or goal.start_ns <= asked.accepted_until_ns)
    )


def input_at_waypoint(drive: Drive | None) -> act.Reply:
    """An input for the robot that waits at a waypoint."""
    if drive is None or not isinstance(drive.navigator.request, FollowWaypoints):
        return act.Reply(error="no waypoints are being followed")
    drive.navigator.exchange.inputs += 1
    return act.Reply()

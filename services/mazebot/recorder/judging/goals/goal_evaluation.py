"""Evaluates the goals and tasks of a run against the ground truth."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import ActionFeedback, ActionResult
from mazebot.common.messages.documents import (
    BodyEntity,
    GoalReport,
    NavigationResult,
    Planar,
    World,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.recorder.judging.goals.judged_goal import JudgedGoal
from mazebot.recorder.judging.goals.shortest_path import ShortestPath
from mazebot.recorder.judging.goals.tolerance import GoalTolerance
from mazebot.recorder.judging.obstacles import obstacles, read_meshes
from mazebot.recorder.judging.pending import Pending
from mazebot.recorder.judging.poses.driven_way import DrivenWay
from mazebot.recorder.judging.recent_rows import RecentRows

SAME_PLACE_M = 1e-3
"""A goal nearer than this to a named location gets its name."""

Result = NavigationResult | ActionResult
_DRIVE = "navigate_to_pose"
_CHECKED = (_DRIVE, "navigate_through_poses", "follow_waypoints", "follow_path")
"""Actions whose goal the goal checker checks."""
_EXPLORING = ("exploring", "returning")
_MOST_CONTACTS = 1000
_GOALS_UNDER_WAY = 16


class GoalEvaluation:
    """Judges a goal when its end is known. A task sent as an action is judged as a goal is: by its
    goal in the map, or, where it has none, by where it should have led from the true pose at its
    start.

    A goal is reached if navigation reports so and the robot's true pose is within `tolerance` of
    it, 0.25 m and 0.25 rad by default. Its path is the true one, from the start to the end that
    navigation reports. Its shortest path leads from the robot's true position at its start, around
    the walls and the bodies that were static when the goal was sent.
    """

    def __init__(
        self, world: World, assets: Mapping[str, bytes], way: DrivenWay, recent_error_m: RecentRows
    ) -> None:
        """`way` and `recent_error_m` are those of the run; `assets` may be filled later."""
        self.standing: tuple[BodyEntity, ...] = ()
        """The spawned bodies that do not move."""
        self.tolerance = GoalTolerance()
        """Of goals that the goal checker checks; motions are held against the default."""
        self._world = world
        self._assets = assets
        self._way = way
        self._recent_error_m = recent_error_m
        self._standing_at: dict[int | str, tuple[BodyEntity, ...]] = {}
        """Static bodies at the time a goal was sent, by its stamp or its id."""
        self._results = Pending[Result]()
        self._goals: list[JudgedGoal] = []
        self._stamps_ns: set[int] = set()
        self._ids: set[str] = set()
        self._exploring = False
        self._explorer_stamps_ns: set[int] = set()
        """Of goals that came while the explorer drove."""
        self._stopped_stamp_ns: int | None = None
        """Of the goal of an explorer that was stopped."""
        self._given_up_stamps_ns: set[int] = set()
        self._paths: tuple[tuple[BodyEntity, ...], ShortestPath] | None = None
        self._contact_stamps_ns: deque[int] = deque(maxlen=_MOST_CONTACTS)

    def add_goal(self, goal: msg.PoseStamped) -> None:
        """Add a goal that was sent."""
        stamp_ns = ns_from_time(goal.header.stamp)
        self._stamps_ns.add(stamp_ns)
        if self._exploring:
            self._explorer_stamps_ns.add(stamp_ns)
        self._remember_standing(stamp_ns)

    def add_exploration(self, status: ExplorationStatus) -> None:
        """The explorer's state: while it drives, it replaces a goal when it has a better one; where
        it is stopped, its goal is canceled.
        """
        self._exploring = status.state in _EXPLORING
        self._stopped_stamp_ns = status.goal_stamp_ns if status.state == "paused" else None

    def add_feedback(self, feedback: ActionFeedback) -> None:
        """Add the progress of an action; its first one tells that it was sent."""
        if feedback.goal_id and feedback.goal_id not in self._ids:
            self._ids.add(feedback.goal_id)
            self._remember_standing(feedback.goal_id)

    def _remember_standing(self, goal: int | str) -> None:
        self._standing_at[goal] = self.standing
        while len(self._standing_at) > _GOALS_UNDER_WAY:
            del self._standing_at[next(iter(self._standing_at))]

    def add_result(self, result: Result) -> None:
        """Add the result of a goal; one aborted by a restart of its world is not counted."""
        if result.error_code == ErrorCode.WORLD_RESTARTED:
            return
        if isinstance(result, ActionResult):
            self._ids.add(result.goal_id)
        else:
            stamp_ns = result.goal_stamp_ns
            self._stamps_ns.add(stamp_ns)
            of_explorer = self._exploring or stamp_ns in self._explorer_stamps_ns
            is_stopped = stamp_ns == self._stopped_stamp_ns
            if (of_explorer and result.error_code == ErrorCode.PREEMPTED) or (
                is_stopped and result.error_code == ErrorCode.CANCELED
            ):
                self._given_up_stamps_ns.add(stamp_ns)
            self._explorer_stamps_ns.discard(stamp_ns)
        self._results.add(ns_from_s(result.end_time_s), result)

    def see_contact(self, stamp_ns: int) -> None:
        """Count a contact for the goals on whose way it was."""
        self._contact_stamps_ns.append(stamp_ns)
        for judged in self._goals[-_GOALS_UNDER_WAY:]:
            judged.see_contact(stamp_ns)

    def see_error(self, stamp_ns: int, error_m: float) -> None:
        """Count an estimate's error for the goals on whose way it was."""
        for judged in self._goals[-_GOALS_UNDER_WAY:]:
            judged.see_error(stamp_ns, error_m)

    def settle(self, newest_ns: int) -> None:
        """Judge the goals that have ended, up to the newest true pose."""
        for _, result in self._results.take_until(newest_ns):
            self._goals.extend(self._judge(result))

    @property
    def ended(self) -> tuple[int, int]:
        """Number of ended goals that still wait for a true pose, and of those that are judged."""
        return len(self._results), len(self._goals)

    @property
    def sent(self) -> int:
        """Number of goals sent, with those given up."""
        return len(self._stamps_ns) + len(self._ids)

    def reports(self) -> list[GoalReport]:
        """The goals that have ended; those that wait for a true pose by the newest one."""
        provisional = [judged for result in self._results for judged in self._judge(result)]
        return [judged.report() for judged in (*self._goals, *provisional)]

    def totals(self) -> dict[str, Any]:
        """How many goals were sent and reached, and `spl`, success weighted by path length,
        https://arxiv.org/abs/1807.06757: the mean over the goals of navigate_to_pose that have
        ended of reached x shortest / max(driven, shortest); None where no goal has. Goals that the
        explorer has given up are only counted as such.
        """
        reports = [report for report in self.reports() if not report.given_up]
        given_up = len(self._given_up_stamps_ns)
        drives = [report for report in reports if report.action == _DRIVE]
        return {
            "goals_sent": len(self._stamps_ns) - given_up + len(self._ids),
            "goals_given_up": given_up,
            "goals_reached": sum(report.reached for report in reports),
            "spl": sum(map(_path_efficiency, drives)) / len(drives) if drives else None,
        }

    def values(self) -> dict[str, Any]:
        """The state as JSON values, for `restore()`."""
        return {
            "goals": [
                {
                    "start_ns": judged.start_ns,
                    "end_ns": judged.end_ns,
                    "verdict": judged.report().model_dump(mode="json"),
                    "errors": judged.errors,
                    "error_sum_m": judged.error_sum_m,
                    "contacts": judged.contacts,
                }
                for judged in self._goals
            ],
            "results": self._waiting(NavigationResult),
            "action_results": self._waiting(ActionResult),
            "goal_stamps_ns": sorted(self._stamps_ns),
            "given_up_stamps_ns": sorted(self._given_up_stamps_ns),
            "goal_ids": sorted(self._ids),
            "contact_stamps_ns": list(self._contact_stamps_ns),
        }

    def _waiting(self, kind: type[Result]) -> list[dict[str, Any]]:
        return [one.model_dump(mode="json") for one in self._results if isinstance(one, kind)]

    def restore(self, values: Mapping[str, Any]) -> None:
        """Continue from a saved state."""
        for goal in values["goals"]:
            verdict = GoalReport.model_validate(goal["verdict"])
            self._goals.append(JudgedGoal(**{**goal, "verdict": verdict}))
        self._given_up_stamps_ns.update(values.get("given_up_stamps_ns", ()))
        for result in values["results"]:
            self.add_result(NavigationResult.model_validate(result))
        for result in values["action_results"]:
            self.add_result(ActionResult.model_validate(result))
        self._ids.update(values["goal_ids"])
        self._stamps_ns.update(values["goal_stamps_ns"])
        self._contact_stamps_ns.extend(values["contact_stamps_ns"])

    def _judge(self, result: Result) -> list[JudgedGoal]:
        """A goal and its report; empty before the first true pose."""
        start_ns, end_ns = ns_from_s(result.start_time_s), ns_from_s(result.end_time_s)
        at_start, at_end = self._way.at(start_ns), self._way.at(end_ns)
        if at_start is None or at_end is None:
            return []
        (start, start_m), (end, end_m) = at_start, at_end
        if isinstance(result, ActionResult):
            action, stamp_ns, goal_id = result.action, 0, result.goal_id
        else:
            action, stamp_ns, goal_id = _DRIVE, result.goal_stamp_ns, ""
        goal = _target(result, start)
        # Not where the recorder was restarted at that time: navigation's report alone is left.
        is_known = goal is not None and self._way.is_known(end_ns)
        error_m = error_rad = shortest_m = None
        is_there = True
        if goal is not None and is_known:
            error_m = end.distance_m(goal)
            error_rad = abs(wrap_angle(end.yaw_rad - goal.yaw_rad))
            tolerance = self.tolerance if action in _CHECKED else GoalTolerance()
            is_there = tolerance.holds(error_m, error_rad)
        if goal is not None and action == _DRIVE:
            shortest_m = self._shortest_path_m(goal_id or stamp_ns, start, goal)
        report = GoalReport(
            name=action if result.goal is None else self._name(result.goal.se2()),
            reached=result.error_code == 0 and is_there,
            time_s=result.end_time_s - result.start_time_s,
            path_length_m=end_m - start_m,
            shortest_path_m=shortest_m,
            goal_error_m=error_m,
            goal_error_rad=error_rad,
            recoveries=result.number_of_recoveries,
            error_code=result.error_code,
            error_msg=result.error_msg,
            goal_stamp_ns=stamp_ns,
            action=action,
            goal_id=goal_id,
            start_time_s=result.start_time_s,
            goal=None if goal is None else Planar(x_m=goal.x_m, y_m=goal.y_m, yaw_rad=goal.yaw_rad),
            given_up=not goal_id and stamp_ns in self._given_up_stamps_ns,
        )
        judged = JudgedGoal(start_ns, end_ns, report)
        stamps_ns = self._recent_error_m.stamps_ns
        on_the_way = (stamps_ns >= start_ns) & (stamps_ns <= end_ns)
        judged.errors = int(np.count_nonzero(on_the_way))
        judged.error_sum_m = float(self._recent_error_m.rows[on_the_way].sum())
        for stamp_ns in self._contact_stamps_ns:
            judged.see_contact(stamp_ns)
        return [judged]

    def _shortest_path_m(self, key: int | str, start: SE2, goal: SE2) -> float | None:
        """For the robot's disc, around the walls and the bodies that were static at that time."""
        standing = self._standing_at.get(key, self.standing)
        if self._paths is None or self._paths[0] != standing:
            meshes = read_meshes((*self._world.bodies, *standing), self._assets)
            shortest = ShortestPath(obstacles(self._world, meshes, standing))
            self._paths = standing, shortest
        return self._paths[1].length_m(start[:2], goal[:2])

    def _name(self, goal: SE2) -> str:
        for location in self._world.locations:
            if goal.distance_m(location.se2()) <= SAME_PLACE_M:
                return location.name
        return "home" if goal.distance_m(self._world.start.se2()) <= SAME_PLACE_M else "goal"


def ns_from_s(time_s: float) -> int:
    """Nanoseconds of a time in seconds."""
    return round(time_s * 1e9)


def _target(result: Result, start: SE2) -> SE2 | None:
    """Where a task should have ended; None where the task does not specify it."""
    if result.goal is not None:
        return result.goal.se2()
    if isinstance(result, ActionResult) and result.displacement is not None:
        return start @ result.displacement.se2()
    return None


def _path_efficiency(goal: GoalReport) -> float:
    if not goal.reached or goal.shortest_path_m is None:
        return 0.0
    longer_m = max(goal.path_length_m, goal.shortest_path_m)
    return goal.shortest_path_m / longer_m if longer_m > 0.0 else 1.0

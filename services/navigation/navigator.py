"""Drives to goals: plan, control, recover, as Nav2's navigate_to_pose_w_replanning_and_recovery."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.common import portable
from services.common.error_codes import ErrorCode
from services.common.frames import SE2
from services.navigation.behaviors import (
    FOR_THE_LOST,
    ROUND_ROBIN,
    Behavior,
    BehaviorParams,
    BehaviorStatus,
    ClearCostmap,
)
from services.navigation.collision import STOP, Surroundings, Velocity
from services.navigation.controller import Controller, ControllerParams
from services.navigation.costmap import INSCRIBED_INFLATED_OBSTACLE, Costmap, LayeredCostmap
from services.navigation.errors import NavigationError
from services.navigation.path import PlannedPath
from services.navigation.planner import Planner, PlannerParams
from services.navigation.progress_checker import ProgressChecker, ProgressParams

_LOG = logging.getLogger("navigation")

State = Literal["idle", "planning", "controlling", "recovering"]


@dataclass(frozen=True, slots=True)
class NavigatorParams:
    """Names as in Nav2's default tree and controller server."""

    replanning_period_s: float
    number_of_retries: int
    failure_tolerance_s: float
    localization_tolerance_s: float
    """How long to wait, stopped, for a lost localisation."""
    path_improvement: float
    """A path that is still free is replaced only by one shorter by this fraction."""
    planner: PlannerParams
    controller: ControllerParams
    behaviors: BehaviorParams
    progress: ProgressParams


@dataclass(frozen=True, slots=True)
class Goal:
    """A goal pose, and the stamp that identifies the goal."""

    pose: SE2
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class GoalResult:
    """How a goal ended."""

    goal: Goal
    error_code: ErrorCode
    error_msg: str
    start_ns: int
    end_ns: int
    number_of_recoveries: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of one step."""

    command: Velocity | None
    """The command to publish; None: none, the robot is stopped and stays so."""
    new_path: PlannedPath | None
    """A path adopted in this step."""
    result: GoalResult | None
    """Set if the goal ended in this step."""


class Navigator:
    """The state machine, for one map; the caller gives the time."""

    def __init__(self, params: NavigatorParams, costmap: LayeredCostmap) -> None:
        self._params = params
        self._costmap = costmap
        self._planner = Planner(params.planner)
        self._controller = Controller(params.controller)
        self._progress = ProgressChecker(params.progress)
        self._state: State = "idle"
        self._goal: Goal | None = None
        self._start_ns = 0
        self._recoveries = 0
        self._behavior: Behavior | None = None
        self._failure = NavigationError(ErrorCode.NONE, "")
        self._stepped_ns = 0
        self._planned_ns = 0
        self._blocked_since_ns: int | None = None
        self._lost_since_ns: int | None = None
        self._distance_remaining_m = 0.0
        self._path_cells: NDArray[np.int64] = np.empty(0, np.int64)
        """Indices of the path's points in the flat grid."""
        self._path_was_free: NDArray[np.bool_] = np.empty(0, np.bool_)
        """Whether each of its points is free for the robot on the static map."""

    @property
    def state(self) -> State:
        """The navigator's state."""
        return self._state

    @property
    def goal(self) -> Goal | None:
        """The goal being driven to."""
        return self._goal

    @property
    def number_of_recoveries(self) -> int:
        """Recoveries that this goal has needed."""
        return self._recoveries

    @property
    def distance_remaining_m(self) -> float:
        """Length of the path that is left."""
        return self._distance_remaining_m

    def accept(self, now_ns: int, goal: Goal, pose: SE2) -> GoalResult | None:
        """Accept a goal in place of the one before; returns the result of that one, if any.

        Raises NavigationError if no path leads to the goal on the static map. The previous goal
        then stays active.
        """
        self._planner.plan(self._costmap.static, pose, goal.pose)
        preempted = None
        if self._goal is not None:
            preempted = self._end(now_ns, ErrorCode.PREEMPTED, "preempted by a new goal")
        self._goal = goal
        self._start_ns = now_ns
        self._recoveries = 0
        self._distance_remaining_m = pose.distance_m(goal.pose)
        self._to_planning()
        _LOG.info(
            "Begin navigating from current location (%.2f, %.2f) to (%.2f, %.2f)",
            pose.x_m, pose.y_m, goal.pose.x_m, goal.pose.y_m,
        )  # fmt: skip
        return preempted

    def abort(self, now_ns: int, code: ErrorCode, message: str) -> GoalResult | None:
        """Abort the goal; returns its result, if there was one."""
        if self._goal is None:
            return None
        result = self._end(now_ns, code, message)
        self._to_idle()
        return result

    def step(self, now_ns: int, around: Surroundings, localized: bool) -> Outcome:
        """Advance one control period.

        Args:
            now_ns: simulation time.
            around: the robot's pose and its surroundings; its costmap is not used.
            localized: whether the pose can be trusted.
        """
        # A late step is followed by one in time: less than a period after it.
        elapsed_s = (now_ns - self._stepped_ns) * 1e-9
        period_s = self._params.controller.control_period_s
        if not 0.0 < elapsed_s < period_s:
            elapsed_s = period_s
        self._stepped_ns = now_ns
        if self._goal is None:
            return Outcome(None, None, None)
        around = Surroundings(around.map_from_base, self._costmap.master, around.echoes_m)
        if self._state == "recovering":
            return self._recover(now_ns, elapsed_s, around)
        if not localized:
            return self._wait_for_localization(now_ns)
        self._lost_since_ns = None
        try:
            new_path = self._replan(now_ns, around)
            return self._control(now_ns, elapsed_s, around, new_path)
        except NavigationError as error:
            return self._fail(now_ns, error)

    def _replan(self, now_ns: int, around: Surroundings) -> PlannedPath | None:
        """A new path if one is due; None: keep the old one."""
        assert self._goal is not None
        old = self._controller.path
        due = now_ns - self._planned_ns >= self._params.replanning_period_s * 1e9
        blocked = old is not None and self._is_blocked(around.costmap)
        if self._state == "controlling" and not (due or blocked):
            return None
        if self._controller.xy_reached and self._state == "controlling":
            return None
        self._planned_ns = now_ns
        path = self._planner.plan(around.costmap, around.map_from_base, self._goal.pose)
        if self._state == "controlling" and old is not None and not blocked:
            index = self._controller.index
            left_m = old.length_m - float(old.along_m[index])
            off_m = portable.hypot_each(*(old.points_m[index] - around.map_from_base[:2]))
            shorter = path.length_m < left_m * (1.0 - self._params.path_improvement)
            if not shorter and off_m < around.costmap.frame.resolution_m * 3.0:
                return None
        self._controller.follow(path, same_goal=self._state == "controlling")
        self._look_up_cells(path)
        if self._state == "planning":
            self._state = "controlling"
            self._progress.reset()
        return path

    def _look_up_cells(self, path: PlannedPath) -> None:
        static = self._costmap.static
        frame = static.frame
        columns = ((path.points_m[:, 0] - frame.origin_x_m) / frame.resolution_m).astype(np.int64)
        rows = ((path.points_m[:, 1] - frame.origin_y_m) / frame.resolution_m).astype(np.int64)
        rows, columns = rows.clip(0, frame.rows - 1), columns.clip(0, frame.columns - 1)
        self._path_cells = rows * frame.columns + columns
        self._path_was_free = static.costs[rows, columns] < INSCRIBED_INFLATED_OBSTACLE

    def _is_blocked(self, costmap: Costmap) -> bool:
        """Whether a new obstacle is on the remaining path."""
        ahead = slice(self._controller.index + 1, None)
        costs = costmap.costs.ravel()[self._path_cells[ahead]]
        # A path may begin inside inflated cells; only cells that the scan has added block it.
        return bool(((costs >= INSCRIBED_INFLATED_OBSTACLE) & self._path_was_free[ahead]).any())

    def _control(
        self, now_ns: int, elapsed_s: float, around: Surroundings, new_path: PlannedPath | None
    ) -> Outcome:
        control = self._controller.step(elapsed_s, around)
        self._distance_remaining_m = control.distance_remaining_m
        if control.reached:
            result = self._end(now_ns, ErrorCode.NONE, "")
            self._to_idle()
            return Outcome(STOP, new_path, result)
        if not control.blocked:
            self._blocked_since_ns = None
        elif self._blocked_since_ns is None:
            self._blocked_since_ns = now_ns
        elif now_ns - self._blocked_since_ns > self._params.failure_tolerance_s * 1e9:
            pose = around.map_from_base
            raise NavigationError(
                ErrorCode.NO_VALID_CONTROL,
                f"every motion along the path collides at ({pose.x_m:.2f}, {pose.y_m:.2f})",
            )
        if not self._progress.makes_progress(now_ns, around.map_from_base):
            pose = around.map_from_base
            allowance_s = self._params.progress.movement_time_allowance_s
            raise NavigationError(
                ErrorCode.FAILED_TO_MAKE_PROGRESS,
                f"stuck for {allowance_s:.1f} s at ({pose.x_m:.2f}, {pose.y_m:.2f})",
            )
        return Outcome(control.velocity, new_path, None)

    def _wait_for_localization(self, now_ns: int) -> Outcome:
        self._controller.stop()
        self._to_planning()
        if self._lost_since_ns is None:
            self._lost_since_ns = now_ns
        lost_s = (now_ns - self._lost_since_ns) * 1e-9
        if lost_s > self._params.localization_tolerance_s:
            self._lost_since_ns = None
            return self._fail(
                now_ns,
                NavigationError(
                    ErrorCode.CONTROLLER_TF_ERROR, f"localisation lost for {lost_s:.1f} s"
                ),
            )
        return Outcome(STOP, None, None)

    def _fail(self, now_ns: int, error: NavigationError) -> Outcome:
        """Begin the next recovery, or abort the goal if none is left."""
        self._failure = error
        self._controller.stop()
        self._blocked_since_ns = None
        if self._recoveries >= self._params.number_of_retries:
            result = self._end(now_ns, error.code, error.message)
            self._to_idle()
            return Outcome(STOP, None, result)
        behaviors = FOR_THE_LOST if error.code is ErrorCode.CONTROLLER_TF_ERROR else ROUND_ROBIN
        self._behavior = behaviors[self._recoveries % len(behaviors)](self._params.behaviors)
        self._recoveries += 1
        self._state = "recovering"
        _LOG.warning(
            "error %d: %s. Running recovery %d of %d: %s",
            error.code, error.message, self._recoveries, self._params.number_of_retries,
            self._behavior.name,
        )  # fmt: skip
        return Outcome(STOP, None, None)

    def _recover(self, now_ns: int, elapsed_s: float, around: Surroundings) -> Outcome:
        assert self._behavior is not None
        if isinstance(self._behavior, ClearCostmap):
            self._costmap.clear()
        status, velocity = self._behavior.step(now_ns, elapsed_s, around)
        if status is BehaviorStatus.RUNNING:
            return Outcome(velocity, None, None)
        if status is BehaviorStatus.FAILED:
            _LOG.warning("%s failed", self._behavior.name)
            if self._recoveries < self._params.number_of_retries:
                return self._fail(now_ns, self._failure)
        self._to_planning()
        return Outcome(STOP, None, None)

    def _to_planning(self) -> None:
        self._state = "planning"
        self._behavior = None
        self._blocked_since_ns = None

    def _to_idle(self) -> None:
        self._state = "idle"
        self._behavior = None
        self._blocked_since_ns = self._lost_since_ns = None
        self._distance_remaining_m = 0.0
        self._controller.stop()

    def _end(self, now_ns: int, code: ErrorCode, message: str) -> GoalResult:
        assert self._goal is not None
        result = GoalResult(self._goal, code, message, self._start_ns, now_ns, self._recoveries)
        self._goal = None
        if code is ErrorCode.NONE:
            _LOG.info("Goal succeeded")
        elif code is ErrorCode.PREEMPTED:
            _LOG.info("Goal preempted")
        elif code is ErrorCode.CANCELED:
            _LOG.info("Goal was canceled. Stopping the robot.")
        else:
            _LOG.error("Goal failed with error %d: %s", code, message)
        return result

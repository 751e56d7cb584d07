"""The task server: one task at a time, with preemption, cancel, pause, feedback and results."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import Field

from mazebot.common.config import ConfigError, Params
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode, code_name
from mazebot.navigation.behavior.actions import (
    FollowPath,
    FollowWaypoints,
    NavigateThroughPoses,
    NavigateToPose,
    Request,
    TaskFeedback,
    TaskResult,
    TaskStatus,
)
from mazebot.navigation.behavior.context import NavigationContext
from mazebot.navigation.behavior.docking.docking import DockingParams
from mazebot.navigation.behavior.engine.running_actions import RunningActions
from mazebot.navigation.behavior.engine.tree import BehaviorTree, Ending, NodeSnapshot
from mazebot.navigation.behavior.motions.motion import BehaviorServerParams
from mazebot.navigation.behavior.nodes.node_kinds import is_own
from mazebot.navigation.behavior.nodes.nodes_goals import WaypointState, settled
from mazebot.navigation.behavior.nodes.xml_loader import (
    DEFAULT_NAV_THROUGH_POSES,
    DEFAULT_NAV_TO_POSE,
    TREES,
    TreeFile,
    read_tree_file,
)
from mazebot.navigation.behavior.tasks import (
    Task,
    TaskParams,
    TreeTask,
    single_node_tree,
)
from mazebot.navigation.behavior.waypoints import (
    FollowWaypointsTask,
    WaitAtWaypoint,
    WaypointExchange,
    WaypointTask,
    WorkOfEach,
)
from mazebot.navigation.control.collision import STOP
from mazebot.navigation.errors import NavigationError

_LOG = logging.getLogger("navigation")

Hold = Literal["", "held", "paused", "lost", "gives way"]


class BtNavigatorParams(Params):
    """Names as in Nav2's bt_navigator."""

    default_nav_to_pose_bt_xml: str = Field(
        DEFAULT_NAV_TO_POSE.stem, description="a tree that comes with navigation, or an XML file"
    )
    default_nav_through_poses_bt_xml: str = Field(
        DEFAULT_NAV_THROUGH_POSES.stem,
        description="a tree that comes with navigation, or an XML file",
    )
    localization_tolerance: float = Field(
        90.0,
        ge=0,
        description="s; how long a goal is held, and the robot moves to localize itself, while it "
        "is lost; after that the goal fails",
    )


class WaypointFollowerParams(Params):
    """Names as in Nav2's waypoint_follower."""

    stop_on_failure: bool = Field(
        False, description="whether a waypoint that cannot be reached ends the task"
    )


@dataclass(frozen=True)
class NavigatorParams:
    """The settings of what the navigator runs, as Nav2's nodes have them."""

    bt_navigator: BtNavigatorParams = field(default_factory=BtNavigatorParams)
    waypoint_follower: WaypointFollowerParams = field(default_factory=WaypointFollowerParams)
    behavior_server: BehaviorServerParams = field(default_factory=BehaviorServerParams)
    docking_server: DockingParams = field(default_factory=DockingParams)


def without_own_nodes(params: BtNavigatorParams) -> BtNavigatorParams:
    """The settings, with the trees that come with navigation in place of those that have nodes of a
    user's own class. Raises ConfigError where a tree cannot be used.
    """
    default = BtNavigatorParams()
    changes = {
        name: getattr(default, name)
        for name in ("default_nav_to_pose_bt_xml", "default_nav_through_poses_bt_xml")
        if any(map(is_own, read_tree_file(Path(tree_path(getattr(params, name)))).kinds()))
    }
    return params.model_copy(update=changes)


def tree_path(name: str) -> str:
    """Path of a tree: a name without a folder and an ending is one that comes with navigation."""
    return str(TREES / f"{name}.xml") if Path(name).name == name and "." not in name else name


@dataclass
class _Running:
    request: Request
    task: Task
    start_ns: int
    held_ns: int = 0
    """Time for which the request has been held."""
    behind_ns: int = 0
    """The task's own clock is behind by this: it stands still while the task is held."""
    lost_since_ns: int | None = None


class BtNavigator:
    """Runs requests; the caller gives the time, once each control period."""

    def __init__(
        self,
        params: NavigatorParams,
        context: NavigationContext,
        waypoint_task: WaypointTask | None = None,
        read: Callable[[Path], TreeFile] = read_tree_file,
    ) -> None:
        """Read the default trees.

        Args:
            params: trees and limits.
            context: the robot.
            waypoint_task: what to do at each waypoint; None: wait 0.2 s.
            read: reads a tree that a request names.

        Raises ConfigError where a default tree cannot be used.
        """
        self._params = params
        self._context = context
        self._waypoint_task: WaypointTask = waypoint_task or WaitAtWaypoint()
        self.exchange = WaypointExchange()
        """What the tasks at waypoints want, and what has come."""
        self._read = read
        self._task_params = TaskParams(params.behavior_server, params.docking_server)
        self._files: dict[str, TreeFile] = {}
        trees = params.bt_navigator
        for path in (trees.default_nav_to_pose_bt_xml, trees.default_nav_through_poses_bt_xml):
            self._file(tree_path(path))
        self._running: _Running | None = None
        self._paused = False
        self._last_ns: int | None = None
        self.gives_way = False
        """Whether the robot gets out of something's way: the caller drives it meanwhile."""
        self.held = False
        """Whether the robot may not move until a person clears it."""
        self.hold: Hold = ""
        """Why the task stood still in the last step."""

    def reconfigure(self, behaviors: BehaviorServerParams, docking: DockingParams) -> None:
        """Begin tasks with other parameters from now on."""
        self._task_params = TaskParams(behaviors, docking)

    @property
    def request(self) -> Request | None:
        """The request that runs."""
        return self._running.request if self._running else None

    @property
    def paused(self) -> bool:
        """Whether the task is paused."""
        return self._paused

    def start(
        self,
        now_ns: int,
        request: Request,
        start_ns: int | None = None,
        *,
        stays_paused: bool = False,
    ) -> TaskResult | None:
        """Begin a request in place of the one before; returns the result of that one, if any.
        `start_ns`: when it was begun by another process; None: now. `stays_paused`: whether it is
        paused where the one before was.

        A new goal of NavigateToPose or NavigateThroughPoses with the same tree replaces the old one
        without a stop. Raises NavigationError where the goal is refused: an occupied or unreachable
        goal, no waypoints, a tree that cannot be loaded. The task before then continues.
        """
        self._check(request)
        running = self._running
        if running is not None and self._gives_on(running, request):
            assert isinstance(running.task, TreeTask)
            preempted = self._result(now_ns, running, _PREEMPTED)
            assert isinstance(request, NavigateToPose | NavigateThroughPoses)
            running.task.give(request)
            self._running = _Running(request, running.task, now_ns, behind_ns=running.behind_ns)
            self._log_begin(request)
            return preempted
        task, paused = self._task(request), self._paused and stays_paused
        ended = self._end(now_ns, _PREEMPTED) if running is not None else None
        self._running = _Running(request, task, now_ns if start_ns is None else start_ns)
        self._paused = paused
        self._log_begin(request)
        return ended

    def cancel(self, now_ns: int) -> TaskResult | None:
        """Stop the robot and cancel the task; returns its result, if there was one."""
        return self._end(now_ns, _CANCELED) if self._running is not None else None

    def abort(self, now_ns: int, code: ErrorCode, message: str) -> TaskResult | None:
        """End the task with an error; returns its result, if there was one."""
        return self._end(now_ns, Ending(int(code), message)) if self._running else None

    def pause(self) -> None:
        """Let the robot stand until `resume`; the task's time stands still as well."""
        self._paused = self._running is not None

    def resume(self) -> None:
        """Go on."""
        self._paused = False

    def step(self, now_ns: int) -> TaskResult | None:
        """Advance by one control period; the task's result in its last one."""
        running, last_ns = self._running, self._last_ns
        self._last_ns = now_ns
        if running is None:
            self.hold = ""
            return None
        self.hold = self._holds(running)
        if self.hold:
            # It is not held before it began.
            held_ns = max(now_ns - max(last_ns, running.start_ns), 0) if last_ns is not None else 0
            running.held_ns += held_ns
            running.behind_ns += held_ns
            self._context.drive(STOP)
            return self._check_lost(now_ns, running)
        running.lost_since_ns = None
        ending = running.task.step(now_ns - running.behind_ns)
        return self._end(now_ns, ending) if ending is not None else None

    def feedback(self, now_ns: int) -> TaskFeedback | None:
        """Feedback of the task that runs."""
        running = self._running
        if running is None:
            return None
        return running.task.feedback((now_ns - running.start_ns - running.held_ns) * 1e-9)

    def snapshot(self) -> tuple[NodeSnapshot, ...]:
        """The tree of the task that runs, with each node's status in the last tick."""
        tree = self.running_tree()
        return () if tree is None else tree.snapshot()

    def running_tree(self) -> BehaviorTree | None:
        """The tree of the task that runs."""
        return self._running.task.running_tree() if self._running else None

    def _holds(self, running: _Running) -> Hold:
        if self.held:
            return "held"
        if self._paused:
            return "paused"
        if running.task.needs_localization and not self._context.is_localized():
            return "lost"
        return "gives way" if self.gives_way else ""

    def _check_lost(self, now_ns: int, running: _Running) -> TaskResult | None:
        if self.hold != "lost":
            return None
        if running.lost_since_ns is None:
            running.lost_since_ns = now_ns
            _LOG.warning("The robot is lost: holding the task until it is localized again")
        lost_s = (now_ns - running.lost_since_ns) * 1e-9
        if lost_s <= self._params.bt_navigator.localization_tolerance:
            return None
        return self._end(
            now_ns, Ending(int(ErrorCode.TF_ERROR), f"the robot has been lost for {lost_s:.0f} s")
        )

    def _check(self, request: Request) -> None:
        if isinstance(request, NavigateToPose):
            self._context.check_goals((request.pose,))
        elif isinstance(request, NavigateThroughPoses):
            if not request.poses:
                raise NavigationError(
                    ErrorCode.NO_VIAPOINTS_GIVEN, "no poses: must be at least one"
                )
            self._context.check_goals(request.poses)

    def _gives_on(self, running: _Running, request: Request) -> bool:
        """Whether a request is a new goal for the tree that runs."""
        old = running.request
        return (
            isinstance(request, NavigateToPose | NavigateThroughPoses)
            and type(old) is type(request)
            and isinstance(old, NavigateToPose | NavigateThroughPoses)
            and old.behavior_tree == request.behavior_tree
            and not self._paused
        )

    def _task(self, request: Request) -> Task:
        if isinstance(request, FollowWaypoints):
            at_each = self._waypoint_task
            if request.works:
                at_each = WorkOfEach(request.works, self.exchange)
            return FollowWaypointsTask(
                request,
                self._navigate_checked,
                at_each,
                self._params.waypoint_follower.stop_on_failure,
            )
        if isinstance(request, NavigateToPose):
            return self._navigate(request)
        if isinstance(request, NavigateThroughPoses):
            path = (
                request.behavior_tree or self._params.bt_navigator.default_nav_through_poses_bt_xml
            )
            code = ErrorCode.THROUGH_POSES_FAILED_TO_LOAD_BEHAVIOR_TREE
            return self._tree_task(request, path, code)
        kind = request.action
        if kind not in self._files:
            self._files[kind] = single_node_tree(kind)
        return TreeTask(
            request, self._files[kind], self._context, self._task_params, self._navigate_to
        )

    def _navigate_checked(self, request: NavigateToPose) -> TreeTask:
        self._check(request)
        return self._navigate(request)

    def _navigate(self, request: NavigateToPose, actions: RunningActions | None = None) -> TreeTask:
        path = request.behavior_tree or self._params.bt_navigator.default_nav_to_pose_bt_xml
        return self._tree_task(request, path, ErrorCode.FAILED_TO_LOAD_BEHAVIOR_TREE, actions)

    def _navigate_to(self, pose: SE2, actions: RunningActions) -> TreeTask:
        return self._navigate(NavigateToPose(pose), actions)

    def _tree_task(
        self,
        request: NavigateToPose | NavigateThroughPoses,
        path: str,
        code: ErrorCode,
        actions: RunningActions | None = None,
    ) -> TreeTask:
        try:
            return TreeTask(
                request, self._file(tree_path(path)), self._context, self._task_params,
                self._navigate_to, actions,
            )  # fmt: skip
        except ConfigError as error:
            raise NavigationError(code, str(error)) from None

    def _file(self, path: str) -> TreeFile:
        """A tree, read once (Nav2's always_reload_bt_xml is false)."""
        if path not in self._files:
            file = self._read(Path(path))
            for warning in file.warnings:
                _LOG.warning("%s", warning)
            if file.unsupported:
                raise ConfigError("; ".join(file.unsupported))
            self._files[path] = file
        return self._files[path]

    def _end(self, now_ns: int, ending: Ending) -> TaskResult:
        running = self._running
        assert running is not None
        result = self._result(now_ns, running, ending)
        running.task.halt()
        self._context.stop()
        self._running, self._paused, self.hold = None, False, ""
        return result

    def _result(self, now_ns: int, running: _Running, ending: Ending) -> TaskResult:
        status = TaskStatus.FAILED
        if ending.code == ErrorCode.NONE:
            status = TaskStatus.SUCCEEDED
            _LOG.info("Goal succeeded")
        elif ending is _CANCELED:
            status = TaskStatus.CANCELED
            _LOG.info("Goal was canceled")
        elif ending is _PREEMPTED:
            # Its client asked for no cancellation: as in Nav2 it is aborted.
            _LOG.info("Goal was preempted")
        else:
            name = code_name(running.request.action, ending.code)
            _LOG.error("Goal failed with error %d (%s): %s", ending.code, name, ending.message)
        feedback = running.task.feedback(0.0)
        succeeded = status is TaskStatus.SUCCEEDED
        left = WaypointState.COMPLETED if succeeded else WaypointState.FAILED
        return TaskResult(
            running.request,
            status,
            ending.code,
            ending.message,
            running.start_ns,
            now_ns,
            feedback.number_of_recoveries,
            settled(running.task.statuses(), left),
            feedback.num_retries,
        )

    def _log_begin(self, request: Request) -> None:
        if isinstance(request, NavigateToPose):
            x_m, y_m, _ = request.pose
            _LOG.info("Begin navigating to (%.2f, %.2f)", x_m, y_m)
        elif isinstance(request, FollowPath):
            _LOG.info("Begin following a path of %.2f m", request.path.length_m)
        else:
            _LOG.info("Begin %s", request.action)


_PREEMPTED = Ending(int(ErrorCode.PREEMPTED), "preempted by a new goal")
_CANCELED = Ending(int(ErrorCode.CANCELED), "canceled")

"""Running tasks: a tree with its goals on the blackboard, stepped until it ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.actions import (
    FollowPath,
    NavigateThroughPoses,
    NavigateToPose,
    SingleAction,
    TaskFeedback,
)
from mazebot.navigation.behavior.context import NavigationContext
from mazebot.navigation.behavior.docking.docking import DockingParams, DockState
from mazebot.navigation.behavior.engine.blackboard import Blackboard
from mazebot.navigation.behavior.engine.running_actions import RunningActions
from mazebot.navigation.behavior.engine.tree import (
    BehaviorTree,
    Ending,
    Errand,
    NodeStatus,
    TreeError,
    TreeRun,
)
from mazebot.navigation.behavior.motions.motion import BehaviorServerParams
from mazebot.navigation.behavior.nodes.goals import GOAL, GOALS, PATH, REQUESTED, WAYPOINT_STATUSES
from mazebot.navigation.behavior.nodes.node_kinds import NODE_KINDS
from mazebot.navigation.behavior.nodes.nodes_goals import Statuses, WaypointStatus
from mazebot.navigation.behavior.nodes.path_parts import length_left_m
from mazebot.navigation.behavior.nodes.xml_loader import TreeFile, read_tree
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.path import PlannedPath


@dataclass(frozen=True)
class TaskParams:
    """What tasks need beside their trees."""

    behaviors: BehaviorServerParams
    docking: DockingParams
    control_period_s: float = 0.05
    usual_speed_m_s: float = 0.25
    """For the time remaining, while the robot has not been driving."""


class Task(Protocol):
    """A task that runs."""

    needs_localization: bool
    """Whether the task is held while the robot is lost."""

    def step(self, now_ns: int) -> Ending | None:
        """Advance by one control period; the ending in its last one."""
        ...

    def halt(self) -> None:
        """Cancel what runs."""
        ...

    def feedback(self, running_s: float) -> TaskFeedback:
        """Feedback now."""
        ...

    def running_tree(self) -> BehaviorTree | None:
        """The tree that is ticked."""
        ...

    def statuses(self) -> Statuses:
        """Of its waypoints, for the result."""
        ...


class TreeTask:
    """One tree; a new goal for the same tree replaces the old one without a stop."""

    def __init__(
        self,
        request: NavigateToPose | NavigateThroughPoses | FollowPath | SingleAction,
        file: TreeFile,
        context: NavigationContext,
        params: TaskParams,
        navigate: Callable[[SE2, RunningActions], Errand] | None = None,
        actions: RunningActions | None = None,
    ) -> None:
        self._action = request.action
        self._unknown = (
            ErrorCode.THROUGH_POSES_NAVIGATOR_UNKNOWN
            if isinstance(request, NavigateThroughPoses)
            else ErrorCode.NAVIGATOR_UNKNOWN
        )
        self.needs_localization = not isinstance(request, SingleAction) or (
            request.action == "DockRobot"
        )
        self._context = context
        self._speed_m_s = params.usual_speed_m_s
        self._period_s = params.control_period_s
        self.file = file
        self.tree: BehaviorTree = file.build(
            TreeRun(
                context,
                behaviors=params.behaviors,
                docking=params.docking,
                control_period_s=params.control_period_s,
                navigate=navigate,
                actions=actions or RunningActions(),
            ),
            Blackboard(),
        )
        self.give(request)

    def give(
        self, request: NavigateToPose | NavigateThroughPoses | FollowPath | SingleAction
    ) -> None:
        """Put the goals of a request onto the blackboard, in place of those before."""
        board, run = self.tree.blackboard, self.tree.run
        # A tree that ends in the moment of a new goal has reached the old one.
        self._unplanned_since = run.plans if run.tick_number else None
        if run.tick_number:
            self.tree.renew()
        run.number_of_recoveries, run.failures = 0, []
        run.tracking = None
        goals: tuple[SE2, ...] = ()
        if isinstance(request, NavigateToPose):
            goals = (request.pose,)
        elif isinstance(request, NavigateThroughPoses):
            goals = request.poses
        elif isinstance(request, FollowPath):
            for name in FOLLOW_PORTS:
                board.set(name, getattr(request, name))
        else:
            for name, value in request.ports.items():
                board.set(name, value)
        if goals:
            self._context.begin_goal()
            board.set(GOAL, goals[-1])
            board.set(GOALS, goals)
            board.set(REQUESTED, goals)
            statuses = tuple(WaypointStatus(index, goal) for index, goal in enumerate(goals))
            board.set(WAYPOINT_STATUSES, statuses)

    def step(self, now_ns: int) -> Ending | None:
        """Tick the tree."""
        run = self.tree.run
        self._follow_speed()
        try:
            status = self.tree.tick(now_ns)
        except TreeError as error:
            self.tree.halt()
            return Ending(int(self._unknown), str(error))
        except NavigationError as error:
            # Of a control node that needs the pose: the robot is lost.
            self.tree.halt()
            return Ending(int(error.code), error.message)
        if status is NodeStatus.RUNNING:
            return None
        if status is NodeStatus.SUCCESS:
            unplanned, self._unplanned_since = self._unplanned_since, None
            # A tree that never plans drives to no goal.
            if unplanned == run.plans and run.plans:
                return None
            return Ending(0, "")
        cause = run.cause()
        if cause is None:
            words = f"the tree {self.tree.name!r} ended with {status.value}"
            if status is NodeStatus.FAILURE:
                node = self.tree.failed_node()
                words += f": {node} in line {node.place.line} failed"
            return Ending(int(self._unknown), words)
        return Ending(cause.code, cause.message)

    def halt(self) -> None:
        """Cancel what runs."""
        self.tree.halt()

    def feedback(self, running_s: float) -> TaskFeedback:
        """Feedback now."""
        run, board = self.tree.run, self.tree.blackboard
        try:
            pose: SE2 | None = self._context.pose()
        except NavigationError:
            pose = None
        remaining_m: float | None = None
        tracking = run.tracking
        path = board.get(PATH)
        if tracking is not None:
            remaining_m = tracking.distance_remaining_m
        elif isinstance(path, PlannedPath) and pose is not None:
            remaining_m = length_left_m(path, pose)
        goals = board.get(GOALS)
        docking = run.docking_step
        return TaskFeedback(
            self._action,
            running_s,
            pose,
            remaining_m,
            None if remaining_m is None else remaining_m / max(self._speed_m_s, 0.05),
            run.number_of_recoveries,
            tracking.position_tracking_error_m if tracking else 0.0,
            tracking.heading_tracking_error_rad if tracking else 0.0,
            tracking.current_path_index if tracking else 0,
            len(goals) if isinstance(goals, tuple) else 0,
            self.statuses(),
            motion=run.running_motion.feedback if run.running_motion else 0.0,
            speed_m_s=abs(self._context.velocity().linear_m_s),
            docking_state=docking.state if docking else DockState.NONE,
            num_retries=docking.num_retries if docking else 0,
        )

    def running_tree(self) -> BehaviorTree | None:
        """See Task."""
        return self.tree

    def statuses(self) -> Statuses:
        """Of NavigateThroughPoses: what has become of each pose."""
        if self._action != NavigateThroughPoses.action:
            return ()
        statuses = self.tree.blackboard.get(WAYPOINT_STATUSES)
        return statuses if isinstance(statuses, tuple) else ()

    def _follow_speed(self) -> None:
        """Mean speed over the last seconds of driving; while the robot stands it stays."""
        speed_m_s = abs(self._context.velocity().linear_m_s)
        if speed_m_s > 0.02:
            self._speed_m_s += self._period_s / _SPEED_TIME_S * (speed_m_s - self._speed_m_s)


_SPEED_TIME_S = 4.0
FOLLOW_PORTS = (
    "path",
    "controller_id",
    "goal_checker_id",
    "progress_checker_id",
    "path_handler_id",
)


def single_node_tree(kind: str) -> TreeFile:
    """A tree of one node, each port connected to the blackboard entry of its name.

    Raises ConfigError for a kind that is not an action.
    """
    if kind not in NODE_KINDS:
        raise ConfigError(f"action {kind!r:.60}: must be a node kind such as Spin")
    node = NODE_KINDS[kind]
    ports = " ".join(f'{port.name}="{{{port.name}}}"' for port in node.ports)
    return read_tree(
        f'<root BTCPP_format="4"><BehaviorTree ID="{kind}"><{kind} {ports}/></BehaviorTree></root>',
        kind,
    )

"""Nodes that change the goals, and the status of each waypoint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.engine.ports import Port, out
from mazebot.navigation.behavior.engine.tree import Node, NodeStatus
from mazebot.navigation.errors import NavigationError

SUCCESS, FAILURE = NodeStatus.SUCCESS, NodeStatus.FAILURE


class WaypointState(IntEnum):
    """Nav2's WaypointStatus."""

    PENDING = 0
    COMPLETED = 1
    SKIPPED = 2
    FAILED = 3


@dataclass(frozen=True, slots=True)
class WaypointStatus:
    """What has become of one waypoint; fields as in nav2_msgs/WaypointStatus."""

    waypoint_index: int
    waypoint_pose: SE2
    waypoint_status: WaypointState = WaypointState.PENDING
    error_code: int = 0
    error_msg: str = ""


Statuses = tuple[WaypointStatus, ...]


def marked(statuses: Statuses, index: int, state: WaypointState) -> Statuses:
    """The statuses with the first pending one from an index on in another state."""
    return tuple(
        replace(one, waypoint_status=state) if i == index else one for i, one in enumerate(statuses)
    )


def settled(statuses: Statuses, state: WaypointState) -> Statuses:
    """The statuses of a task that has ended: what was pending is in this state."""
    pending = WaypointState.PENDING
    return tuple(
        replace(one, waypoint_status=state) if one.waypoint_status is pending else one
        for one in statuses
    )


class _GoalsNode(Node):
    def statuses(self) -> Statuses:
        """The statuses on the blackboard."""
        value = self.get("input_waypoint_statuses")
        return value if isinstance(value, tuple) else ()

    def first_pending(self, statuses: Statuses) -> int:
        """Index of the first status that is pending; the length where none is."""
        for index, one in enumerate(statuses):
            if one.waypoint_status is WaypointState.PENDING:
                return index
        return len(statuses)


class RemovePassedGoals(_GoalsNode):
    """Takes the first goals away while the robot is within `radius` of them, in their order; the
    last one stays.
    """

    ports = (
        Port("radius", "number", "0.5"),
        Port("input_goals", "poses", required=True),
        out("output_goals", "poses"),
        Port("input_waypoint_statuses"),
        out("output_waypoint_statuses"),
        Port("robot_base_frame"),
        Port("global_frame"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        goals, statuses = self.poses("input_goals"), self.statuses()
        if not goals:
            self.put("output_goals", ())
            return SUCCESS
        try:
            pose = self.context.pose()
        except NavigationError:
            return FAILURE
        while len(goals) > 1 and pose.distance_m(goals[0]) <= self.number("radius"):
            goals = goals[1:]
            statuses = marked(statuses, self.first_pending(statuses), WaypointState.COMPLETED)
        self.put("output_goals", goals)
        self.put("output_waypoint_statuses", statuses)
        return SUCCESS


class RemoveInCollisionGoals(_GoalsNode):
    """Takes goals away at which the robot would collide; fails where none is left."""

    ports = (
        Port("service_name"),
        Port("server_timeout", "number"),
        Port("input_goals", "poses", required=True),
        out("output_goals", "poses"),
        Port("cost_threshold", "number", "254"),
        Port("use_footprint", "flag", "true"),
        Port("consider_unknown_as_obstacle", "flag", "false"),
        Port("input_waypoint_statuses"),
        out("output_waypoint_statuses"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        goals, statuses = self.poses("input_goals"), self.statuses()
        kept: list[SE2] = []
        first = self.first_pending(statuses)
        for offset, goal in enumerate(goals):
            cost = self.context.cost_at(goal, self.flag("use_footprint"))
            unknown = cost == _UNKNOWN
            if unknown and self.flag("consider_unknown_as_obstacle"):
                hit = True
            else:
                hit = not unknown and cost >= self.number("cost_threshold")
            if hit:
                statuses = marked(statuses, first + offset, WaypointState.SKIPPED)
            else:
                kept.append(goal)
        self.put("output_goals", tuple(kept))
        self.put("output_waypoint_statuses", statuses)
        return SUCCESS if kept else FAILURE


_UNKNOWN = 255


class AppendGoalPoseToGoals(Node):
    """Adds a pose to the end of the goals."""

    ports = (
        Port("goal_pose", "pose", required=True),
        Port("input_goals", "poses"),
        out("output_goals", "poses"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        goal = self.pose("goal_pose")
        if goal is None:
            return FAILURE
        self.put("output_goals", (*self.poses("input_goals"), goal))
        return SUCCESS


class GetNextFewGoals(Node):
    """The first `num_goals` goals."""

    ports = (
        Port("input_goals", "poses", required=True),
        Port("num_goals", "integer", required=True),
        out("output_goals", "poses"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        goals = self.poses("input_goals")
        if not goals:
            return FAILURE
        self.put("output_goals", goals[: max(self.integer("num_goals"), 0)])
        return SUCCESS


class GetCurrentPose(Node):
    """The robot's pose."""

    ports = (
        out("current_pose", "pose"),
        Port("global_frame"),
        Port("robot_base_frame"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        try:
            self.put("current_pose", self.context.pose())
        except NavigationError:
            return FAILURE
        return SUCCESS

"""Nodes that compute and judge paths."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.context import PathCheck
from mazebot.navigation.behavior.engine.ports import Port, out
from mazebot.navigation.behavior.engine.tree import Node, NodeStatus, TreeError
from mazebot.navigation.behavior.nodes.nodes_action import ACTION_PORTS, ActionNode
from mazebot.navigation.behavior.nodes.path_parts import (
    around,
    joined,
    length_left_m,
    nearest_index,
    pose_on,
    without_end,
)
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.path import PlannedPath
from mazebot.navigation.planning.smoother import check_smoother

SUCCESS, FAILURE = NodeStatus.SUCCESS, NodeStatus.FAILURE
_THROUGH_POSES = ErrorCode.THROUGH_POSES_UNKNOWN - ErrorCode.PLANNER_UNKNOWN


_TOO_NARROW = out("too_narrow", "flag")
"""Whether there is no path because a place is too narrow, which is no use to wait for."""


def _planned(node: ActionNode, start: SE2 | None, goals: Sequence[SE2]) -> PlannedPath:
    node.put("too_narrow", False)
    try:
        return node.context.compute_path(start, goals, node.text("planner_id"))
    except NavigationError as error:
        node.put("too_narrow", error.for_good)
        raise


class ComputePathToPose(ActionNode):
    """Plans to a pose, through via points if given; a failure empties the path."""

    action = "ComputePathToPose"
    ports = (
        Port("goal", "pose", required=True),
        Port("start", "pose"),
        Port("use_start", "flag", "true"),
        Port("viapoints", "poses"),
        Port("planner_id"),
        out("path", "path"),
        _TOO_NARROW,
        *ACTION_PORTS,
    )

    def _on_running(self, now_ns: int) -> NodeStatus:
        goal = self.pose("goal")
        if goal is None:
            raise TreeError(f"{self}, port 'goal': no goal on the blackboard")
        start = self.pose("start") if self.flag("use_start") else None
        goals = (*self.poses("viapoints"), goal)
        self.put("path", _planned(self, start, goals))
        self.place.run.plans += 1
        return SUCCESS

    def _fail(self, code: int, message: str) -> None:
        self.put("path", None)
        super()._fail(code, message)


class ComputePathThroughPoses(ActionNode):
    """Plans through poses in their order; a failure empties the path."""

    action = "ComputePathThroughPoses"
    ports = (
        Port("goals", "poses", required=True),
        Port("start", "pose"),
        Port("use_start", "flag", "true"),
        Port("planner_id"),
        out("path", "path"),
        out("last_reached_index", "integer"),
        _TOO_NARROW,
        *ACTION_PORTS,
    )

    def _on_running(self, now_ns: int) -> NodeStatus:
        goals = self.poses("goals")
        if not goals:
            raise NavigationError(ErrorCode.NO_VIAPOINTS_GIVEN, "no poses to plan through")
        start = self.pose("start") if self.flag("use_start") else None
        self.put("path", _planned(self, start, goals))
        self.place.run.plans += 1
        self.put("last_reached_index", -1)
        return SUCCESS

    def _fail(self, code: int, message: str) -> None:
        self.put("path", None)
        if ErrorCode.PLANNER_UNKNOWN <= code <= ErrorCode.NO_VALID_PATH:
            code += _THROUGH_POSES
        super()._fail(code, message)


class SmoothPath(ActionNode):
    """Hands the path on: the planners smooth what they plan. A collision can be asked for."""

    action = "SmoothPath"
    ports = (
        Port("unsmoothed_path", "path", required=True),
        Port("max_smoothing_duration", "number", "3.0"),
        Port("check_for_collisions", "flag", "false"),
        Port("smoother_id"),
        out("smoothed_path", "path"),
        out("smoothing_duration", "number"),
        out("was_completed", "flag"),
        *ACTION_PORTS,
    )

    def _on_running(self, now_ns: int) -> NodeStatus:
        path = self.path("unsmoothed_path")
        if path is None:
            raise NavigationError(ErrorCode.SMOOTHER_INVALID_PATH, "no path to smooth")
        check_smoother(self.text("smoother_id"))
        if self.flag("check_for_collisions"):
            hit = self.context.collisions(path, PathCheck())
            if hit:
                raise NavigationError(
                    ErrorCode.SMOOTHED_PATH_IN_COLLISION,
                    f"the path collides at ({hit[0].x_m:.2f}, {hit[0].y_m:.2f})",
                )
        self.put("smoothed_path", path)
        self.put("smoothing_duration", 0.0)
        self.put("was_completed", True)
        return SUCCESS


class ValidatePath(Node):
    """Succeeds where a path is free; without a path it fails. `IsPathValid` until Kilted."""

    ports = (
        Port("path", "path", required=True),
        Port("max_cost", "integer", "254"),
        Port("consider_unknown_as_obstacle", "flag", "false"),
        Port("layer_name", no_effect="ignored: the whole costmap is tested"),
        Port("footprint", no_effect="ignored: the robot's own is tested"),
        Port("stop_at_first_collision", "flag", "true"),
        Port("max_lookahead_distance", "number", "-1"),
        Port("server_name"),
        Port("server_timeout", "number"),
        Port("service_name"),
        out("collision_poses", "poses"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        path = self.path("path")
        if path is None:
            return FAILURE
        check = PathCheck(
            max_cost=self.integer("max_cost"),
            consider_unknown_as_obstacle=self.flag("consider_unknown_as_obstacle"),
            max_lookahead_distance_m=self.number("max_lookahead_distance"),
            stop_at_first_collision=self.flag("stop_at_first_collision"),
        )
        hit = self.context.collisions(path, check)
        self.put("collision_poses", hit)
        return FAILURE if hit else SUCCESS


class TruncatePath(Node):
    """Cuts off a path's last `distance` m."""

    ports = (
        Port("distance", "number", "1.0"),
        Port("input_path", "path", required=True),
        out("output_path", "path"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        path = self.path("input_path")
        if path is None:
            return FAILURE
        self.put("output_path", without_end(path, self.number("distance")))
        return SUCCESS


class TruncatePathLocal(Node):
    """Cuts a path down to the part around the robot; negative distances keep that side whole."""

    ports = (
        Port("input_path", "path", required=True),
        out("output_path", "path"),
        Port("distance_forward", "number", "8.0"),
        Port("distance_backward", "number", "4.0"),
        Port("robot_base_frame"),
        Port("transform_tolerance", "number"),
        Port("pose", "pose"),
        Port("angular_distance_weight", "number", "0.0"),
        Port("max_robot_pose_search_dist", "number", "inf"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        path = self.path("input_path")
        if path is None:
            return FAILURE
        try:
            pose = self.pose("pose") or self.context.pose()
        except NavigationError:
            return FAILURE
        index = nearest_index(
            path,
            pose,
            self.number("max_robot_pose_search_dist"),
            self.number("angular_distance_weight"),
        )
        back_m, ahead_m = self.number("distance_backward"), self.number("distance_forward")
        self.put("output_path", around(path, index, back_m, ahead_m))
        return SUCCESS


class ConcatenatePaths(Node):
    """Joins two paths; one that is missing is left out."""

    ports = (
        Port("input_path1", "path"),
        Port("input_path2", "path"),
        out("output_path", "path"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        first, second = self.path("input_path1"), self.path("input_path2")
        if first is None and second is None:
            return FAILURE
        path = joined(first, second) if first is not None and second is not None else None
        self.put("output_path", path or first or second)
        return SUCCESS


class GetPoseFromPath(Node):
    """The pose at an index of a path; a negative one counts from the end."""

    ports = (
        Port("path", "path", required=True),
        Port("index", "integer", "0"),
        out("pose", "pose"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        path, index = self.path("path"), self.integer("index")
        if path is None or not -len(path.points_m) <= index < len(path.points_m):
            return FAILURE
        self.put("pose", pose_on(path, index))
        return SUCCESS


class IsGoalNearby(Node):
    """Succeeds where less than `proximity_threshold` m of the path are left."""

    ports = (
        Port("path", "path", required=True),
        Port("proximity_threshold", "number", "1.0"),
        Port("max_robot_pose_search_dist", "number", "-1"),
        Port("global_frame"),
        Port("robot_base_frame"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        path = self.path("path")
        if path is None:
            return FAILURE
        search_m = self.number("max_robot_pose_search_dist")
        try:
            left_m = length_left_m(
                path, self.context.pose(), search_m if search_m >= 0.0 else math.inf
            )
        except NavigationError:
            return FAILURE
        return SUCCESS if left_m < self.number("proximity_threshold") else FAILURE


class PathExpiringTimer(Node):
    """Succeeds when the path on the blackboard is older than `seconds`."""

    ports = (Port("seconds", "number", "1.0"), Port("path", "path"))

    _path: object | None = None
    _since_ns = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        path = self.get("path")
        if path is not self._path or path is None:
            self._path, self._since_ns = path, now_ns
            return FAILURE
        if now_ns - self._since_ns < self.number("seconds") * 1e9:
            return FAILURE
        # A planner that keeps the path renews it as well.
        self._since_ns = now_ns
        return SUCCESS

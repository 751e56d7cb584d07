"""Navigation's requests and results as messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    MAP_FRAME,
    ODOM_FRAME,
    SE2,
    Array,
    wrap_angle,
)
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import NavigationResult, Planar
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.world.costmap import Cells
from mazebot.navigation.behavior import actions
from mazebot.navigation.behavior.actions import Request, TaskFeedback, TaskResult, TaskStatus
from mazebot.navigation.behavior.context import BatteryCharge, ClearRequest
from mazebot.navigation.behavior.docking.docks import CameraView
from mazebot.navigation.behavior.engine.tree import NodeSnapshot
from mazebot.navigation.behavior.nodes.nodes_goals import Statuses, WaypointState, WaypointStatus
from mazebot.navigation.control.collision import Velocity
from mazebot.navigation.control.mppi.mppi import Trajectories
from mazebot.navigation.control.safety.collision_monitor import MonitorState
from mazebot.navigation.costmap.footprint import Footprint
from mazebot.navigation.costmap.inflation_layer import Window
from mazebot.navigation.costmap.layered_costmap import GridFrame, LayeredCostmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.path import PlannedPath, dense, path_through, with_pieces_backwards

_CHARGING = 1
"""sensor_msgs/msg/BatteryState.POWER_SUPPLY_STATUS_CHARGING"""
_ACTIONS = {
    "NavigateToPose": "navigate_to_pose",
    "NavigateThroughPoses": "navigate_through_poses",
    "FollowWaypoints": "follow_waypoints",
    "FollowPath": "follow_path",
    "Spin": "spin",
    "BackUp": "backup",
    "DriveOnHeading": "drive_on_heading",
    "Wait": "wait",
    "AssistedTeleop": "assisted_teleop",
    "DockRobot": "dock_robot",
    "UndockRobot": "undock_robot",
}
_MOTIONS = {
    "Spin": {"spin_dist": SE2(0.0, 0.0, 1.0)},
    "BackUp": {"backup_dist": SE2(-1.0, 0.0, 0.0)},
    "DriveOnHeading": {"dist_to_travel": SE2(1.0, 0.0, 0.0)},
}
"""The port that gives how far a behaviour moves the robot, and where a unit of it leads."""
_STEPS_A_POINT = 4
"""A rollout is drawn with a point for as many of its steps: 0.2 s of driving is nearly straight."""
_ROLLOUTS_Z_M = 0.03
_ROLLOUT_WIDTH_M = 0.006
_STATUS = {TaskStatus.SUCCEEDED: "succeeded", TaskStatus.CANCELED: "canceled"}


def planar_document(pose: SE2) -> Planar:
    """A pose in the form of the documents."""
    return Planar(x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad)


def twist_message(now_ns: int, velocity: Velocity) -> msg.TwistStamped:
    """A velocity command."""
    return msg.TwistStamped(
        header=msg.header(now_ns, BASE_FOOTPRINT_FRAME),
        twist=msg.Twist(
            linear=msg.Vector3(velocity.linear_m_s, 0.0, 0.0),
            angular=msg.Vector3(0.0, 0.0, velocity.angular_rad_s),
        ),
    )


def footprint_message(now_ns: int, footprint: Footprint, odom_from_base: SE2) -> msg.PolygonStamped:
    """The robot's outline where odometry has it."""
    cosine, sine = portable.cos_sin(odom_from_base.yaw_rad)
    points = [
        msg.Point32(
            msg.float32(odom_from_base.x_m + cosine * x - sine * y),
            msg.float32(odom_from_base.y_m + sine * x + cosine * y),
            msg.float32(0.0),
        )
        for x, y in footprint.points_m.tolist()
    ]
    return msg.PolygonStamped(msg.header(now_ns, ODOM_FRAME), msg.Polygon(points))


def path_message(now_ns: int, path: PlannedPath) -> msg.Path:
    """A path as poses in the map."""
    header = msg.header(now_ns, MAP_FRAME)
    poses = [
        msg.PoseStamped(header=header, pose=msg.pose_from_se2(SE2(float(x), float(y), float(yaw))))
        for (x, y), yaw in zip(path.points_m, path.yaws_rad, strict=True)
    ]
    return msg.Path(header=header, poses=poses)


def path_poses(path: PlannedPath) -> tuple[Planar, ...]:
    """A path in the form of the documents."""
    return tuple(
        Planar(x_m=float(x), y_m=float(y), yaw_rad=float(yaw))
        for (x, y), yaw in zip(path.points_m, path.yaws_rad, strict=True)
    )


def camera_view(info: msg.CameraInfo, base_from_camera: Array) -> CameraView | None:
    """What a camera sees; None where its intrinsics are of no pinhole camera."""
    fx, fy, cx, cy = (float(info.k[index]) for index in (0, 4, 2, 5))
    if not (np.isfinite([fx, fy, cx, cy]).all() and fx > 0.0 and fy > 0.0):
        return None
    return CameraView(base_from_camera, (fx, fy), (cx, cy), (info.width, info.height))


def battery_charge(state: msg.BatteryState) -> BatteryCharge:
    """What a battery says."""
    return BatteryCharge(
        state.percentage, state.voltage, state.power_supply_status == _CHARGING
    )  # fmt: skip


def costmap_message(now_ns: int, costmap: LayeredCostmap, frame_id: str) -> msg.OccupancyGrid:
    """The costmap with all its layers."""
    frame = costmap.frame
    return msg.occupancy_grid(
        now_ns,
        frame.resolution_m,
        SE2(frame.origin_x_m, frame.origin_y_m, 0.0),
        costmap.master.occupancy(),
        frame_id,
    )


def costmap_update_message(
    now_ns: int, costmap: LayeredCostmap, window: Window, frame_id: str
) -> msg.OccupancyGridUpdate:
    """A part of the costmap: from a row to another one, from a column to another one."""
    row0, row1, column0, column1 = window
    cells = costmap.master.occupancy(np.s_[row0:row1, column0:column1])
    rows, columns = cells.shape
    return msg.OccupancyGridUpdate(
        msg.header(now_ns, frame_id), column0, row0, columns, rows, cells.reshape(-1)
    )


def mask_message(now_ns: int, frame: GridFrame, cells: Cells | None) -> msg.OccupancyGrid:
    """A filter's mask in the map, (rows, columns) int8; None: an empty one."""
    if cells is None:
        cells = np.zeros((frame.rows, frame.columns), np.int8)
    origin = SE2(frame.origin_x_m, frame.origin_y_m, 0.0)
    return msg.occupancy_grid(now_ns, frame.resolution_m, origin, cells)


def request_of(goal: act.ActionGoal) -> Request:
    """The request of a document. Raises NavigationError for a path without two points."""
    if isinstance(goal, act.NavigateToPose):
        return actions.NavigateToPose(goal.pose.se2(), goal.behavior_tree)
    if isinstance(goal, act.NavigateThroughPoses):
        poses = tuple(pose.se2() for pose in goal.poses)
        return actions.NavigateThroughPoses(poses, goal.behavior_tree)
    if isinstance(goal, act.FollowWaypoints):
        poses = tuple(pose.se2() for pose in goal.poses)
        works = tuple(
            actions.WaypointWork(task.wait_s, task.photo, task.input_timeout_s)
            for task in goal.tasks
        )
        return actions.FollowWaypoints(poses, goal.number_of_loops, goal.goal_index, works)
    if isinstance(goal, act.FollowPath):
        return _follow_path(goal)
    if isinstance(goal, act.Spin):
        return actions.spin(
            goal.target_yaw_rad, goal.time_allowance_s, goal.disable_collision_checks
        )
    if isinstance(goal, act.BackUp):
        return actions.back_up(
            goal.distance_m, goal.speed_m_s, goal.time_allowance_s, goal.disable_collision_checks
        )
    if isinstance(goal, act.DriveOnHeading):
        return actions.drive_on_heading(
            goal.distance_m, goal.speed_m_s, goal.time_allowance_s, goal.disable_collision_checks
        )
    if isinstance(goal, act.Wait):
        return actions.wait(goal.duration_s)
    if isinstance(goal, act.AssistedTeleop):
        return actions.assisted_teleop(goal.time_allowance_s)
    if isinstance(goal, act.DockRobot):
        pose = None if goal.dock_pose is None else goal.dock_pose.se2()
        return actions.dock_robot(
            pose, goal.dock_id, goal.navigate_to_staging_pose, goal.max_staging_time_s
        )
    return actions.undock_robot(goal.max_undocking_time_s)


def planned_path(poses: Sequence[Planar], code: ErrorCode) -> PlannedPath:
    """A path through poses, with the heading of the last one at its end, and backwards where those
    of others ask for it.

    Raises NavigationError with this code for fewer than two.
    """
    if len(poses) < 2:
        raise NavigationError(code, f"path of {len(poses)} poses: must be at least 2")
    points = np.array([[pose.x_m, pose.y_m] for pose in poses])
    yaws_rad = np.array([pose.yaw_rad for pose in poses])
    return dense(with_pieces_backwards(path_through(points, poses[-1].yaw_rad), yaws_rad))


def _follow_path(goal: act.FollowPath) -> actions.FollowPath:
    path = planned_path(goal.path, ErrorCode.INVALID_PATH)
    return actions.FollowPath(
        path,
        goal.controller_id,
        goal.goal_checker_id,
        goal.progress_checker_id,
        goal.path_handler_id,
    )


def clear_requests(ask: act.ClearCostmap) -> list[ClearRequest]:
    """What to clear, one for each costmap."""
    pose = None if ask.pose is None else ask.pose.se2()
    return [
        ClearRequest(name, ask.area, ask.reset_distance_m, pose)
        for name in ("local", "global")
        if ask.costmap in ("all", name)
    ]


def goal_result(request: Request, now_ns: int, code: int, message: str) -> TaskResult:
    """The result of a request that was never started."""
    return TaskResult(request, TaskStatus.FAILED, int(code), message, now_ns, now_ns)


def result_document(goal_stamp_ns: int, result: TaskResult) -> NavigationResult:
    """How a goal of /goal_pose ended."""
    assert isinstance(result.request, actions.NavigateToPose)
    return NavigationResult(
        goal=planar_document(result.request.pose),
        goal_stamp_ns=goal_stamp_ns,
        error_code=int(result.error_code),
        error_msg=result.error_msg,
        start_time_s=result.start_ns * 1e-9,
        end_time_s=result.end_ns * 1e-9,
        number_of_recoveries=result.number_of_recoveries,
    )


def goal_of(request: Request, docks: Mapping[str, SE2]) -> SE2 | None:
    """Where a request should end, in the map; None where it has no such place."""
    if isinstance(request, actions.NavigateToPose):
        return request.pose
    if isinstance(request, actions.NavigateThroughPoses | actions.FollowWaypoints):
        return request.poses[-1] if request.poses else None
    if isinstance(request, actions.FollowPath):
        return request.path.goal
    if request.action != "DockRobot":
        return None
    pose = request.ports["dock_pose"]
    return pose if isinstance(pose, SE2) else docks.get(str(request.ports["dock_id"]))


def displacement_of(request: Request) -> SE2 | None:
    """Where a request without a goal in the map should end, seen from where it begins."""
    if not isinstance(request, actions.SingleAction):
        return None
    for port, unit in _MOTIONS.get(request.action, {}).items():
        size = float(str(request.ports[port]))
        return SE2(unit.x_m * size, unit.y_m * size, wrap_angle(unit.yaw_rad * size))
    return SE2(0.0, 0.0, 0.0) if request.action == "Wait" else None


def result_action(goal_id: str, result: TaskResult, docks: Mapping[str, SE2]) -> act.ActionResult:
    """How an action ended; `docks`: poses of the docked robot."""
    goal, displacement = goal_of(result.request, docks), displacement_of(result.request)
    return act.ActionResult(
        goal_id=goal_id,
        action=_ACTIONS[result.request.action],
        status=_STATUS.get(result.status, "aborted"),
        error_code=int(result.error_code),
        error_msg=result.error_msg,
        start_time_s=result.start_ns * 1e-9,
        end_time_s=result.end_ns * 1e-9,
        number_of_recoveries=result.number_of_recoveries,
        num_retries=result.num_retries,
        waypoints=waypoint_documents(result.waypoint_statuses),
        goal=None if goal is None else planar_document(goal),
        displacement=None if displacement is None else planar_document(displacement),
    )


def with_missed(request: Request, missed: Sequence[act.WaypointStatus]) -> Request:
    """A request that goes on, with the waypoints that it has missed so far."""
    if not isinstance(request, actions.FollowWaypoints):
        return request
    statuses = tuple(
        WaypointStatus(
            one.index, request.poses[one.index], WaypointState[one.status.upper()],
            one.error_code, one.error_msg,
        )
        for one in missed
        if 0 <= one.index < len(request.poses)
    )  # fmt: skip
    return replace(request, missed=statuses)


def waypoint_documents(statuses: Statuses) -> tuple[act.WaypointStatus, ...]:
    """The statuses of waypoints as documents."""
    return tuple(
        act.WaypointStatus(
            status=one.waypoint_status.name.lower(),
            index=one.waypoint_index,
            error_code=one.error_code,
            error_msg=one.error_msg,
        )
        for one in statuses
    )


def feedback_document(
    goal_id: str,
    feedback: TaskFeedback,
    paused: bool,
    goal: SE2 | None = None,
    stopped_at: Sequence[tuple[float, float]] = (),
) -> act.ActionFeedback:
    """Progress of an action towards its goal in the map, if it has one, and where something that
    no sensor shows has stopped the robot.
    """
    action = feedback.action
    drives = action in ("NavigateToPose", "NavigateThroughPoses", "FollowWaypoints", "FollowPath")
    through = action in ("NavigateThroughPoses", "FollowWaypoints")
    docks = action == "DockRobot"
    pose = feedback.current_pose
    return act.ActionFeedback(
        goal_id=goal_id,
        action=_ACTIONS[action],
        navigation_time_s=feedback.navigation_time_s,
        current_pose=None if pose is None else planar_document(pose),
        distance_remaining_m=feedback.distance_remaining_m if drives else None,
        estimated_time_remaining_s=feedback.estimated_time_remaining_s if drives else None,
        number_of_recoveries=feedback.number_of_recoveries if drives else None,
        number_of_poses_remaining=feedback.number_of_poses_remaining if through else None,
        current_waypoint=feedback.current_waypoint if action == "FollowWaypoints" else None,
        angular_distance_traveled_rad=feedback.motion if action == "Spin" else None,
        distance_traveled_m=feedback.motion if action in ("BackUp", "DriveOnHeading") else None,
        time_left_s=feedback.motion if action == "Wait" else None,
        speed_m_s=feedback.speed_m_s if action == "FollowPath" else None,
        position_tracking_error_m=feedback.position_tracking_error_m if drives else None,
        heading_tracking_error_rad=feedback.heading_tracking_error_rad if drives else None,
        current_path_index=feedback.current_path_index if drives else None,
        waypoints=(
            waypoint_documents(feedback.waypoint_statuses)
            if action == "NavigateThroughPoses"
            else ()
        ),
        docking_state=feedback.docking_state.name.lower() if docks else None,
        num_retries=feedback.num_retries if docks else None,
        paused=paused,
        goal=None if goal is None else planar_document(goal),
        stopped_at=tuple(stopped_at),
    )


def tree_document(action: str, nodes: Sequence[NodeSnapshot]) -> act.BehaviorTreeLog:
    """The tree of an action, by its Nav2 name; empty: none runs."""
    return act.BehaviorTreeLog(
        action=_ACTIONS[action] if action else "",
        nodes=tuple(
            act.BehaviorTreeNode(
                name=one.name, kind=one.kind, status=one.status.value, depth=one.depth
            )
            for one in nodes
        ),
    )


def trajectories_message(now_ns: int, drawn: Trajectories) -> msg.MarkerArray:
    """Rollouts as lines, from green for the cheapest to red for the dearest, and the chosen one in
    white above them.
    """
    every = slice(None, None, _STEPS_A_POINT)
    lifted_m = _lifted(drawn.points_m[:, every], _ROLLOUTS_Z_M)
    shares = np.linspace(0.0, 1.0, len(drawn.costs)).tolist()
    markers = [
        msg.line_strip(
            now_ns, MAP_FRAME, "rollouts", number, points_m,
            _ROLLOUT_WIDTH_M, (min(1.0, 2.0 * share), min(1.0, 2.0 - 2.0 * share), 0.0, 1.0),
        )
        for number, (points_m, share) in enumerate(zip(lifted_m, shares, strict=True))
    ]  # fmt: skip
    markers.append(
        msg.line_strip(
            now_ns, MAP_FRAME, "optimal", 0, _lifted(drawn.optimal_m[every], 2 * _ROLLOUTS_Z_M),
            3 * _ROLLOUT_WIDTH_M, (1.0, 1.0, 1.0, 1.0),
        )
    )  # fmt: skip
    return msg.marker_array(markers)


def _lifted(points_m: Array, z_m: float) -> Array:
    """(..., 3) of (..., 2) points."""
    return np.concatenate([points_m, np.full((*points_m.shape[:-1], 1), z_m)], axis=-1)


def monitor_document(state: MonitorState) -> act.CollisionMonitorState:
    """What the collision monitor does."""
    return act.CollisionMonitorState(
        action=state.action.name.lower(),
        polygon_name=state.polygon_name,
        source=state.source,
        points=state.points,
        nearest_m=state.place_m,
        reason=state.reason,
    )

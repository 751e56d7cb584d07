"""The table of actions: those of Nav2, by the documents of the user's own tools, and of the
simulator.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from types import SimpleNamespace
from typing import Any, Final

from mazebot.common.maths.frames import MAP_FRAME
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import CancelGoal, Planar
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    CANCEL_GOAL,
    COMPUTE_PATH,
    NAVIGATION_CHECKPOINT,
    SEND_GOAL,
)
from mazebot.common.ros.action import (
    Action,
    Ask,
    Course,
    Ended,
    Feedback,
    GoalError,
    GoalRejectedError,
    GoalStatus,
    Running,
    TakenUp,
)
from mazebot.common.ros.call import Response
from mazebot.common.ros.interfaces import Versioned
from mazebot.common.ros.simulation import SIMULATION_ACTIONS
from mazebot.common.ros.values import (
    check_in_map,
    duration_values,
    planar_of,
    pose_stamped,
    seconds_of,
)

_STATUSES: Final = {
    "succeeded": GoalStatus.SUCCEEDED, "canceled": GoalStatus.CANCELED,
    "aborted": GoalStatus.ABORTED,
}  # fmt: skip


def _planars(poses: list[msg.PoseStamped]) -> tuple[Planar, ...]:
    return tuple(map(_planar, poses))


def _planar(pose: msg.PoseStamped) -> Planar:
    try:
        return planar_of(pose)
    except ValueError as error:
        raise GoalError(ErrorCode.TF_ERROR, str(error)) from error


def _poses(message: Any) -> list[msg.PoseStamped]:
    """Since Kilted they are in nav_msgs/Goals."""
    poses: list[msg.PoseStamped] = getattr(message.poses, "goals", message.poses)
    return poses


def _to_pose(message: Any) -> act.ActionGoal:
    return act.NavigateToPose(pose=_planar(message.pose), behavior_tree=message.behavior_tree)


def _through_poses(message: Any) -> act.ActionGoal:
    poses = _planars(_poses(message))
    return act.NavigateThroughPoses(poses=poses, behavior_tree=message.behavior_tree)


def _waypoints(message: Any) -> act.ActionGoal:
    return act.FollowWaypoints(
        poses=_planars(message.poses),
        number_of_loops=message.number_of_loops,
        goal_index=message.goal_index,
    )


def _path(message: Any) -> act.ActionGoal:
    try:
        check_in_map(message.path.header)
        path = tuple(map(planar_of, message.path.poses))
    except ValueError as error:
        raise GoalError(ErrorCode.CONTROLLER_TF_ERROR, f"path: {error}") from error
    return act.FollowPath(
        path=path,
        controller_id=message.controller_id,
        goal_checker_id=message.goal_checker_id,
        progress_checker_id=message.progress_checker_id,
        path_handler_id=getattr(message, "path_handler_id", ""),
    )


def _spin(message: Any) -> act.ActionGoal:
    return act.Spin(
        target_yaw_rad=message.target_yaw,
        time_allowance_s=_allowance_s(message),
        disable_collision_checks=getattr(message, "disable_collision_checks", False),
    )


def _allowance_s(message: Any) -> float:
    """Less than none is none, as in Nav2."""
    return max(seconds_of(message.time_allowance), 0.0)


def _straight(message: Any, code: ErrorCode) -> dict[str, Any]:
    target = message.target
    if target.y or target.z:
        raise GoalError(code, "target: y and z must be 0: the robot drives straight")
    return {
        "distance_m": target.x,
        "speed_m_s": message.speed,
        "time_allowance_s": _allowance_s(message),
        "disable_collision_checks": getattr(message, "disable_collision_checks", False),
    }


def _back_up(message: Any) -> act.ActionGoal:
    """Backwards whatever the signs, as in Nav2."""
    values = _straight(message, ErrorCode.BACKUP_INVALID_INPUT)
    return act.BackUp(
        **{
            **values,
            "distance_m": abs(values["distance_m"]),
            "speed_m_s": abs(values["speed_m_s"]),
        }
    )


def _on_heading(message: Any) -> act.ActionGoal:
    return act.DriveOnHeading(**_straight(message, ErrorCode.DRIVE_ON_HEADING_INVALID_INPUT))


def _wait(message: Any) -> act.ActionGoal:
    return act.Wait(duration_s=max(seconds_of(message.time), 0.0))


def _assisted(message: Any) -> act.ActionGoal:
    return act.AssistedTeleop(time_allowance_s=_allowance_s(message))


def _dock(message: Any) -> act.ActionGoal:
    """There is one type of dock: `dock_type` says nothing."""
    return act.DockRobot(
        dock_id=message.dock_id if message.use_dock_id else "",
        dock_pose=None if message.use_dock_id else _planar(message.dock_pose),
        navigate_to_staging_pose=message.navigate_to_staging_pose,
        max_staging_time_s=max(message.max_staging_time, 0.0),
    )


def _undock(message: Any) -> act.ActionGoal:
    return act.UndockRobot(max_undocking_time_s=max(message.max_undocking_time, 0.0))


def _compute(message: Any, _: str) -> Course:
    start = _planar(message.start) if message.use_start else None
    goals = _planars([*getattr(message, "viapoints", ()), message.goal])
    asked = act.ComputePath(goals=goals, start=start, planner_id=message.planner_id)
    begun_s = time.monotonic()
    reply = yield COMPUTE_PATH, asked
    planning_time = duration_values(time.monotonic() - begun_s)
    if reply.error_code == ErrorCode.GOAL_REJECTED:
        raise GoalRejectedError(reply.error_msg)
    path = {"header": {"frame_id": MAP_FRAME}, "poses": [pose_stamped(pose) for pose in reply.path]}
    failed = reply.error_code != ErrorCode.NONE
    return Ended(
        GoalStatus.ABORTED if failed else GoalStatus.SUCCEEDED,
        {
            "path": path,
            "planning_time": planning_time,
            "error_code": reply.error_code,
            "error_msg": reply.error_msg,
        },
    )


def _task_feedback(told: act.ActionFeedback, _: Any) -> Versioned:
    return Versioned(
        current_pose=_current_pose(told),
        navigation_time=duration_values(told.navigation_time_s),
        estimated_time_remaining=duration_values(told.estimated_time_remaining_s or 0.0),
        number_of_recoveries=told.number_of_recoveries or 0,
        distance_remaining=told.distance_remaining_m or 0.0,
        **_tracking_errors(told),
    )


def _current_pose(told: act.ActionFeedback) -> Any:
    return {} if told.current_pose is None else pose_stamped(told.current_pose)


def _tracking_errors(told: act.ActionFeedback) -> dict[str, float]:
    return {
        "position_tracking_error": told.position_tracking_error_m or 0.0,
        "heading_tracking_error": told.heading_tracking_error_rad or 0.0,
    }


def _through_feedback(told: act.ActionFeedback, goal: Any) -> Response:
    return Versioned(
        **_task_feedback(told, goal),
        number_of_poses_remaining=told.number_of_poses_remaining or 0,
        waypoint_statuses=_statuses(told.waypoints, _poses(goal)),
    )


def _waypoints_feedback(told: act.ActionFeedback, _: Any) -> Response:
    return {"current_waypoint": told.current_waypoint or 0}


def _path_feedback(told: act.ActionFeedback, _: Any) -> Response:
    """Nav2's numbers: until Kilted `distance_to_goal` is along the path, since Lyrical straight."""
    remaining_m, speed_m_s = told.distance_remaining_m or 0.0, told.speed_m_s or 0.0
    pose, goal, straight_m = told.current_pose, told.goal, 0.0
    if pose is not None and goal is not None:
        straight_m = pose.se2().distance_m(goal.se2())
    tracking = {
        "header": {"frame_id": MAP_FRAME},
        **_tracking_errors(told),
        "current_path_index": told.current_path_index or 0,
        "robot_pose": _current_pose(told),
        "distance_to_goal": straight_m,
        "speed": speed_m_s,
        "remaining_path_length": remaining_m,
    }
    return Versioned(distance_to_goal=remaining_m, speed=speed_m_s, tracking_feedback=tracking)


def _spin_feedback(told: act.ActionFeedback, _: Any) -> Response:
    return {"angular_distance_traveled": told.angular_distance_traveled_rad or 0.0}


def _straight_feedback(told: act.ActionFeedback, _: Any) -> Response:
    return {"distance_traveled": told.distance_traveled_m or 0.0}


def _wait_feedback(told: act.ActionFeedback, _: Any) -> Response:
    return {"time_left": duration_values(told.time_left_s or 0.0)}


def _assisted_feedback(told: act.ActionFeedback, _: Any) -> Response:
    return {"current_teleop_duration": duration_values(told.navigation_time_s)}


_DOCKING_STATES: Final = (
    "none", "nav_to_staging_pose", "initial_perception", "controlling", "wait_for_charge", "retry",
)  # fmt: skip


def _dock_feedback(told: act.ActionFeedback, _: Any) -> Response:
    return {
        "state": _DOCKING_STATES.index(told.docking_state or "none"),
        "docking_time": duration_values(told.navigation_time_s),
        "num_retries": told.num_retries or 0,
    }


def _no_feedback(_told: act.ActionFeedback, _: Any) -> Response:
    return {}


def _task_result(ended: act.ActionResult, _: Any) -> dict[str, Any]:
    return {"error_code": ended.error_code, "error_msg": ended.error_msg}


def _behavior_result(ended: act.ActionResult, goal: Any) -> Response:
    elapsed = duration_values(max(ended.end_time_s - ended.start_time_s, 0.0))
    return {**_task_result(ended, goal), "total_elapsed_time": elapsed}


def _undock_result(ended: act.ActionResult, goal: Any) -> dict[str, Any]:
    return {**_task_result(ended, goal), "success": ended.status == "succeeded"}


def _dock_result(ended: act.ActionResult, goal: Any) -> Response:
    return {**_undock_result(ended, goal), "num_retries": ended.num_retries}


_WAYPOINT_STATUS: Final = {"pending": 0, "completed": 1, "skipped": 2, "failed": 3}


def _waypoints_result(ended: act.ActionResult, goal: Any) -> Response:
    missed = _statuses(ended.waypoints, goal.poses)
    return {**_task_result(ended, goal), "missed_waypoints": missed}


def _through_result(ended: act.ActionResult, goal: Any) -> Response:
    statuses = _statuses(ended.waypoints, _poses(goal))
    return Versioned(**_task_result(ended, goal), waypoint_statuses=statuses)


def _statuses(
    waypoints: Iterable[act.WaypointStatus], poses: Sequence[msg.PoseStamped]
) -> list[Versioned]:
    """With the names of MissedWaypoint, and since Kilted of WaypointStatus."""
    found = []
    for one in waypoints:
        pose: Any = poses[one.index] if 0 <= one.index < len(poses) else {}
        found.append(
            Versioned(
                index=one.index,
                goal=pose,
                waypoint_status=_WAYPOINT_STATUS[one.status],
                waypoint_index=one.index,
                waypoint_pose=pose,
                error_code=one.error_code,
                error_msg=one.error_msg,
            )
        )
    return found


_OfFeedback = Callable[[act.ActionFeedback, Any], Response]
_OfResult = Callable[[act.ActionResult, Any], Response]


def _failed(code: int | None, message: str) -> Response:
    return {
        "error_code": ErrorCode.SEND_GOAL_FAILURE if code is None else code,
        "error_msg": message,
    }


def _cancel(goal_id: str) -> Ask:
    return CANCEL_GOAL, CancelGoal(goal_id=goal_id)


def _cancel_other(task: str) -> Callable[[str | None, int | None], Ask]:
    return lambda goal_id, until_ns: (
        CANCEL_GOAL, CancelGoal(goal_id=goal_id, action=task, accepted_until_ns=until_ns)
    )  # fmt: skip


_Heard = Callable[[act.ActionFeedback | act.ActionResult], Feedback | Ended | None]


def _hearing(goal_id: str, goal: Any, feedback: _OfFeedback, result: _OfResult) -> _Heard:
    def heard(told: act.ActionFeedback | act.ActionResult) -> Feedback | Ended | None:
        if told.goal_id != goal_id:
            return None
        if isinstance(told, act.ActionFeedback):
            return Feedback(feedback(told, goal))
        return Ended(_STATUSES[told.status], result(told, goal))

    return heard


def _taken_up(
    task: str, feedback: _OfFeedback, result: _OfResult
) -> Callable[[act.NavigationCheckpoint], TakenUp | None]:
    def taken_up(told: act.NavigationCheckpoint) -> TakenUp | None:
        if told.goal is None or told.goal.action != task:
            return None
        # Of the goal's message, feedback and results want the poses alone.
        goal = SimpleNamespace(poses=[pose_stamped(p) for p in getattr(told.goal, "poses", ())])
        heard = _hearing(told.goal_id, goal, feedback, result)
        return TakenUp(told.goal_id, told.start_ns, heard)

    return taken_up


def _sent(
    document: Callable[[Any], act.ActionGoal], feedback: _OfFeedback, result: _OfResult
) -> Callable[[Any, str], Course]:
    """Of a goal that the navigator runs, and tells about on topics of its own."""

    def run(message: Any, goal_id: str) -> Course:
        reply = yield SEND_GOAL, act.SendGoal(goal_id=goal_id, goal=document(message))
        if not reply.accepted:
            if reply.error_code == ErrorCode.GOAL_REJECTED:
                raise GoalRejectedError(reply.error_msg)
            raise GoalError(reply.error_code, reply.error_msg)
        yield Running(_hearing(goal_id, message, feedback, result))
        return None

    return run


def _row(
    name: str,
    kind: str,
    document: Callable[[Any], act.ActionGoal],
    feedback: _OfFeedback,
    result: _OfResult,
    about: str,
) -> Action:
    task = name.removeprefix("/")
    return Action(
        name, f"nav2_msgs/action/{kind}", "navigation", _sent(document, feedback, result),
        (ACTION_FEEDBACK, ACTION_RESULT), _cancel, _failed, about, NAVIGATION_CHECKPOINT,
        _taken_up(task, feedback, result), _cancel_other(task),
    )  # fmt: skip


ACTIONS: Final[tuple[Action, ...]] = (
    _row(
        "/navigate_to_pose", "NavigateToPose", _to_pose, _task_feedback, _task_result,
        "drive to a pose",
    ),
    _row(
        "/navigate_through_poses", "NavigateThroughPoses", _through_poses, _through_feedback,
        _through_result, "drive through poses to the last one",
    ),
    _row(
        "/follow_waypoints", "FollowWaypoints", _waypoints, _waypoints_feedback,
        _waypoints_result, "drive to each pose and stop there",
    ),
    _row(
        "/follow_path", "FollowPath", _path, _path_feedback, _task_result,
        "drive along a given path",
    ),
    _row("/spin", "Spin", _spin, _spin_feedback, _behavior_result, "turn on the spot"),
    _row("/backup", "BackUp", _back_up, _straight_feedback, _behavior_result, "drive back"),
    _row(
        "/drive_on_heading", "DriveOnHeading", _on_heading, _straight_feedback, _behavior_result,
        "drive straight",
    ),
    _row("/wait", "Wait", _wait, _wait_feedback, _behavior_result, "stand still"),
    _row(
        "/assisted_teleop", "AssistedTeleop", _assisted, _assisted_feedback, _behavior_result,
        "follow `/cmd_vel_teleop`, slowed before obstacles",
    ),
    _row(
        "/dock_robot", "DockRobot", _dock, _dock_feedback, _dock_result,
        "dock at a marker, by the dock's name or pose",
    ),
    _row(
        "/undock_robot", "UndockRobot", _undock, _no_feedback, _undock_result,
        "leave the dock for its staging pose",
    ),
    Action(
        "/compute_path_to_pose", "nav2_msgs/action/ComputePathToPose", "navigation", _compute,
        (), _cancel, _failed, "compute a path without driving it",
    ),
    *SIMULATION_ACTIONS,
)  # fmt: skip


def actions_of(node: str) -> list[Action]:
    """The actions that a node runs."""
    return [action for action in ACTIONS if action.owner == node]

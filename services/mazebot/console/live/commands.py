"""How what a page asks for is passed on to the services."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable
from typing import Any

import numpy as np

from mazebot.common.client.actions import cancel_goal, rejection_text, send_goal
from mazebot.common.client.robot import Robot, RobotError
from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, MAP_FRAME, quaternion_from_yaw
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as tp
from mazebot.console.live import page_messages as pm
from mazebot.console.live.page_messages import RefusedError

ANSWER_TIMEOUT_S = 10.0
INITIAL_STD_M, INITIAL_STD_RAD = 0.5, 0.26
"""Of a pose set by hand, as RViz: variances of 0.25 m2 and 0.0685 rad2."""


def carry_out(robot: Robot, action: Any) -> str:
    """Pass on what the page asks for; returns what to tell the person. It waits for the reply.

    Raises RefusedError where it is refused or there is no robot.
    """
    try:
        return _HANDLERS[type(action)](robot, action)
    except RobotError as error:
        raise RefusedError(str(error)) from error


def velocity_message(robot: Robot, linear_m_s: float, angular_rad_s: float) -> msg.TwistStamped:
    """A wanted velocity, for CMD_VEL_TELEOP."""
    return msg.TwistStamped(
        header=msg.header(robot.now_ns(), BASE_FOOTPRINT_FRAME),
        twist=msg.Twist(
            linear=msg.Vector3(linear_m_s, 0.0, 0.0), angular=msg.Vector3(0.0, 0.0, angular_rad_s)
        ),
    )


def _ask(robot: Robot, query: tp.Query[Any, Any], message: Any) -> Any:
    return _checked(robot.ask(query, message, ANSWER_TIMEOUT_S))


def _checked(reply: Any) -> Any:
    """The reply. Raises RefusedError where it is an error."""
    error: str = getattr(reply, "error", "")
    if error:
        raise RefusedError(error)
    return reply


def _start(robot: Robot, goal: act.ActionGoal, begun: str) -> str:
    goal_id = f"console-{uuid.uuid4().hex[:12]}"
    reply = send_goal(robot, goal_id, goal, ANSWER_TIMEOUT_S)
    if not reply.accepted:
        raise RefusedError(f"{rejection_text(reply)} (error code {reply.error_code})")
    return begun


def _goal(robot: Robot, action: pm.Goal) -> str:
    goal = act.NavigateToPose(pose=action.pose.planar())
    return _start(robot, goal, f"driving to {_told(action.pose)}")


def _waypoints(robot: Robot, action: pm.Waypoints) -> str:
    poses = tuple(place.planar() for place in action.poses)
    goal = (
        act.FollowWaypoints(poses=poses) if action.stops else act.NavigateThroughPoses(poses=poses)
    )
    count = len(poses)
    return _start(robot, goal, f"driving to {count} waypoint{'s' * (count != 1)}")


def _initial_pose(robot: Robot, action: pm.InitialPose) -> str:
    covariance = np.diag([INITIAL_STD_M**2, INITIAL_STD_M**2, INITIAL_STD_RAD**2])
    pose = msg.PoseWithCovarianceStamped(
        header=msg.header(robot.now_ns(), MAP_FRAME),
        pose=msg.PoseWithCovariance(
            pose=msg.pose_from_se2(action.pose.planar().se2()),
            covariance=msg.planar_covariance(covariance),
        ),
    )
    robot.publish(tp.INITIAL_POSE, pose)
    return f"initial pose {_told(action.pose)} sent"


def _drop_box(robot: Robot, action: pm.DropBox) -> str:
    shape = doc.Shape(name="box", geometry=doc.Box(size_m=action.size_m), material="plain")
    grey = (0.7, 0.7, 0.7, 1.0)
    entity = doc.BodyEntity(
        name="box",
        position_m=(action.pose.x_m, action.pose.y_m, action.size_m[2] / 2.0),
        orientation_xyzw=quaternion_from_yaw(action.pose.yaw_rad),
        mass_kg=action.mass_kg,
        shapes=(shape,),
        materials=(doc.Material(name="plain", ambient=grey, diffuse=grey),),
    )
    reply = _ask(robot, tp.SPAWN_ENTITY, doc.SpawnEntity(entity=entity, allow_renaming=True))
    return f"{reply.name} stands at {_told(action.pose)}"


def _remove(robot: Robot, action: pm.Remove) -> str:
    _ask(robot, tp.DELETE_ENTITY, doc.DeleteEntity(name=action.name))
    return f"{action.name} removed"


def _cancel(robot: Robot, _: pm.Cancel) -> str:
    _checked(cancel_goal(robot, doc.CancelGoal(), ANSWER_TIMEOUT_S))
    return "canceled: the robot stops"


def _pause_task(robot: Robot, action: pm.PauseTask) -> str:
    _ask(robot, tp.PAUSE_GOAL, act.PauseGoal(pause=action.pause))
    return "paused: the robot stops" if action.pause else "the robot goes on"


def _dock(robot: Robot, action: pm.Dock) -> str:
    return _start(robot, act.DockRobot(dock_id=action.dock_id), f"docking at {action.dock_id}")


def _undock(robot: Robot, _: pm.Undock) -> str:
    return _start(robot, act.UndockRobot(), "leaving the dock")


def _spin(robot: Robot, action: pm.Spin) -> str:
    goal = act.Spin(target_yaw_rad=action.angle_rad)
    return _start(robot, goal, f"turning by {math.degrees(action.angle_rad):.0f} degrees")


def _back_up(robot: Robot, action: pm.BackUp) -> str:
    goal = act.BackUp(distance_m=action.distance_m)
    return _start(robot, goal, f"driving back by {action.distance_m:g} m")


def _clear_costmaps(robot: Robot, _: pm.ClearCostmaps) -> str:
    _ask(robot, tp.CLEAR_COSTMAP, act.ClearCostmap())
    return "costmaps cleared"


def _find_robot(robot: Robot, _: pm.FindRobot) -> str:
    _ask(robot, tp.REINITIALIZE_GLOBAL_LOCALIZATION, act.Empty())
    return "searching the robot on the whole map; it moves if it has to"


def _explore(robot: Robot, action: pm.Explore) -> str:
    if "explorer" not in robot.alive():
        raise RefusedError("explore: no explorer service is running")
    robot.publish(tp.EXPLORE_RESUME, msg.Bool(data=action.resume))
    return "the exploration goes on" if action.resume else "the exploration stops here"


def _simulation(robot: Robot, action: pm.Simulation) -> str:
    control = doc.SimulationControl(**action.model_dump(exclude={"do"}, exclude_none=True))
    stats = _ask(robot, tp.SIMULATION_CONTROL, control).stats
    if stats is None:
        return "there is no world yet"
    pace = f"at {stats.speed:g}x real time" if stats.speed else "as fast as possible"
    return f"{'paused' if stats.paused else f'running {pace}'} at {stats.sim_time_s:.2f} s"


def _told(place: pm.Place) -> str:
    return f"({place.x_m:.2f}, {place.y_m:.2f})"


_HANDLERS: dict[type, Callable[[Robot, Any], str]] = {
    pm.Goal: _goal,
    pm.InitialPose: _initial_pose,
    pm.Waypoints: _waypoints,
    pm.DropBox: _drop_box,
    pm.Remove: _remove,
    pm.Cancel: _cancel,
    pm.PauseTask: _pause_task,
    pm.Dock: _dock,
    pm.Undock: _undock,
    pm.Spin: _spin,
    pm.BackUp: _back_up,
    pm.ClearCostmaps: _clear_costmaps,
    pm.FindRobot: _find_robot,
    pm.Explore: _explore,
    pm.Simulation: _simulation,
}

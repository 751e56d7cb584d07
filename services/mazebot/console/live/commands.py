"""How what a page asks for is passed on to the services."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable
from typing import Any

import numpy as np

from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, MAP_FRAME, quaternion_from_yaw
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as tp
from mazebot.console.live import page_messages as pm
from mazebot.console.live.page_messages import RefusedError
from mazebot.console.live.stack import Stack, StackError

ANSWER_TIMEOUT_S = 10.0
INITIAL_STD_M, INITIAL_STD_RAD = 0.5, 0.26
"""Of a pose set by hand, as RViz: variances of 0.25 m2 and 0.0685 rad2."""


def carry_out(stack: Stack, action: Any) -> str:
    """Pass on what the page asks for; returns what to tell the person. It waits for the reply.

    Raises RefusedError where it is refused or there is no stack.
    """
    try:
        return _HANDLERS[type(action)](stack, action)
    except StackError as error:
        raise RefusedError(str(error)) from error


def velocity_message(stack: Stack, linear_m_s: float, angular_rad_s: float) -> msg.TwistStamped:
    """A wanted velocity, for CMD_VEL_TELEOP."""
    return msg.TwistStamped(
        header=msg.header(stack.now_ns(), BASE_FOOTPRINT_FRAME),
        twist=msg.Twist(
            linear=msg.Vector3(linear_m_s, 0.0, 0.0), angular=msg.Vector3(0.0, 0.0, angular_rad_s)
        ),
    )


def _ask(stack: Stack, query: tp.Query[Any, Any], message: Any) -> Any:
    reply = stack.ask(query, message, ANSWER_TIMEOUT_S)
    error: str = getattr(reply, "error", "")
    if error:
        raise RefusedError(error)
    return reply


def _start(stack: Stack, goal: act.ActionGoal, begun: str) -> str:
    goal_id = f"console-{uuid.uuid4().hex[:12]}"
    reply = _ask(stack, tp.SEND_GOAL, act.SendGoal(goal_id=goal_id, goal=goal))
    if not reply.accepted:
        near, text = reply.nearest_free, reply.error_msg
        if near is not None and "nearest" not in text:
            text += f"; the nearest free pose is ({near.x_m:.2f}, {near.y_m:.2f})"
        raise RefusedError(f"{text} (error code {reply.error_code})")
    return begun


def _goal(stack: Stack, action: pm.Goal) -> str:
    goal = act.NavigateToPose(pose=action.pose.planar())
    return _start(stack, goal, f"driving to {_told(action.pose)}")


def _waypoints(stack: Stack, action: pm.Waypoints) -> str:
    poses = tuple(place.planar() for place in action.poses)
    goal = (
        act.FollowWaypoints(poses=poses) if action.stops else act.NavigateThroughPoses(poses=poses)
    )
    count = len(poses)
    return _start(stack, goal, f"driving to {count} waypoint{'s' * (count != 1)}")


def _initial_pose(stack: Stack, action: pm.InitialPose) -> str:
    covariance = np.diag([INITIAL_STD_M**2, INITIAL_STD_M**2, INITIAL_STD_RAD**2])
    pose = msg.PoseWithCovarianceStamped(
        header=msg.header(stack.now_ns(), MAP_FRAME),
        pose=msg.PoseWithCovariance(
            pose=msg.pose_from_se2(action.pose.planar().se2()),
            covariance=msg.planar_covariance(covariance),
        ),
    )
    stack.publish(tp.INITIAL_POSE, pose)
    return f"initial pose {_told(action.pose)} sent"


def _drop_box(stack: Stack, action: pm.DropBox) -> str:
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
    reply = _ask(stack, tp.SPAWN_ENTITY, doc.SpawnEntity(entity=entity, allow_renaming=True))
    return f"{reply.name} stands at {_told(action.pose)}"


def _remove(stack: Stack, action: pm.Remove) -> str:
    _ask(stack, tp.DELETE_ENTITY, doc.DeleteEntity(name=action.name))
    return f"{action.name} removed"


def _cancel(stack: Stack, _: pm.Cancel) -> str:
    _ask(stack, tp.CANCEL_GOAL, doc.CancelGoal())
    return "canceled: the robot stops"


def _pause_task(stack: Stack, action: pm.PauseTask) -> str:
    _ask(stack, tp.PAUSE_GOAL, act.PauseGoal(pause=action.pause))
    return "paused: the robot stops" if action.pause else "the robot goes on"


def _dock(stack: Stack, action: pm.Dock) -> str:
    return _start(stack, act.DockRobot(dock_id=action.dock_id), f"docking at {action.dock_id}")


def _undock(stack: Stack, _: pm.Undock) -> str:
    return _start(stack, act.UndockRobot(), "leaving the dock")


def _spin(stack: Stack, action: pm.Spin) -> str:
    goal = act.Spin(target_yaw_rad=action.angle_rad)
    return _start(stack, goal, f"turning by {math.degrees(action.angle_rad):.0f} degrees")


def _back_up(stack: Stack, action: pm.BackUp) -> str:
    goal = act.BackUp(distance_m=action.distance_m)
    return _start(stack, goal, f"driving back by {action.distance_m:g} m")


def _clear_costmaps(stack: Stack, _: pm.ClearCostmaps) -> str:
    _ask(stack, tp.CLEAR_COSTMAP, act.ClearCostmap())
    return "costmaps cleared"


def _find_robot(stack: Stack, _: pm.FindRobot) -> str:
    _ask(stack, tp.REINITIALIZE_GLOBAL_LOCALIZATION, act.Empty())
    return "searching the robot on the whole map; it moves if it has to"


def _explore(stack: Stack, action: pm.Explore) -> str:
    if "explorer" not in stack.services():
        raise RefusedError("explore: no explorer service is running")
    stack.publish(tp.EXPLORE_RESUME, msg.Bool(data=action.resume))
    return "the exploration goes on" if action.resume else "the exploration stops here"


def _simulation(stack: Stack, action: pm.Simulation) -> str:
    control = doc.SimulationControl(**action.model_dump(exclude={"do"}, exclude_none=True))
    stats = _ask(stack, tp.SIMULATION_CONTROL, control).stats
    if stats is None:
        return "there is no world yet"
    pace = f"at {stats.speed:g}x real time" if stats.speed else "as fast as possible"
    return f"{'paused' if stats.paused else f'running {pace}'} at {stats.sim_time_s:.2f} s"


def _told(place: pm.Place) -> str:
    return f"({place.x_m:.2f}, {place.y_m:.2f})"


_HANDLERS: dict[type, Callable[[Stack, Any], str]] = {
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

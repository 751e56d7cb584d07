"""How what a page asks for is passed on to the services."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable
from typing import Any

from mazebot.common.client.actions import cancel_goal, rejection_text, send_goal
from mazebot.common.client.robot import Robot, RobotError
from mazebot.common.client.user_messages import initial_pose
from mazebot.common.maths.frames import quaternion_from_yaw
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as tp
from mazebot.console.live import page_messages as pm
from mazebot.console.live.arrival import poses_with_headings
from mazebot.console.live.page_messages import RefusedError

ANSWER_TIMEOUT_S = 10.0
INITIAL_STD_M, INITIAL_STD_RAD = 0.5, 0.26
"""Of a pose set by hand, as RViz: variances of 0.25 m2 and 0.0685 rad2."""


def carry_out(robot: Robot, action: Any) -> str:
    """Pass on what the page asks for; returns the text for the user. It waits for the reply.

    Raises RefusedError where it is rejected or no stack is running.
    """
    try:
        return _HANDLERS[type(action)](robot, action)
    except RobotError as error:
        raise RefusedError(str(error)) from error


def _ask(robot: Robot, query: tp.Query[Any, Any], message: Any) -> Any:
    return _checked(robot.ask(query, message, ANSWER_TIMEOUT_S))


def _checked(reply: Any) -> Any:
    """The reply. Raises RefusedError where it is an error."""
    error: str = getattr(reply, "error", "")
    if error:
        raise RefusedError(error)
    return reply


def _start(robot: Robot, goal: act.ActionGoal, text: str) -> str:
    goal_id = f"console-{uuid.uuid4().hex[:12]}"
    reply = send_goal(robot, goal_id, goal, ANSWER_TIMEOUT_S)
    if not reply.accepted:
        raise RefusedError(f"{rejection_text(reply)} (error code {reply.error_code})")
    return text


def _goal(robot: Robot, action: pm.Goal) -> str:
    (pose,) = poses_with_headings(robot, [action.pose], ANSWER_TIMEOUT_S)
    goal = act.NavigateToPose(pose=pose)
    return _start(robot, goal, f"driving to {_text(action.pose)}")


def _waypoints(robot: Robot, action: pm.Waypoints) -> str:
    poses = tuple(poses_with_headings(robot, action.poses, ANSWER_TIMEOUT_S))
    goal = (
        act.FollowWaypoints(poses=poses) if action.stops else act.NavigateThroughPoses(poses=poses)
    )
    count = len(poses)
    return _start(robot, goal, f"driving to {count} waypoint{'s' * (count != 1)}")


def _initial_pose(robot: Robot, action: pm.InitialPose) -> str:
    pose, grid = action.pose.planar().se2(), robot.latest(tp.MAP)
    # Nobody replies to a topic's message: what comes of it is told here.
    if "localization" not in robot.alive():
        raise RefusedError("no localization runs, which takes an initial pose")
    if grid is not None and not msg.grid_contains(grid, pose.x_m, pose.y_m):
        raise RefusedError(f"initial pose {_text(action.pose)}: must be inside the map")
    robot.publish(tp.INITIAL_POSE, initial_pose(robot, pose, INITIAL_STD_M, INITIAL_STD_RAD))
    return f"initial pose {_text(action.pose)} sent"


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
    return f"{reply.name} spawned at {_text(action.pose)}"


def _remove(robot: Robot, action: pm.Remove) -> str:
    _ask(robot, tp.DELETE_ENTITY, doc.DeleteEntity(name=action.name))
    return f"{action.name} removed"


def _cancel(robot: Robot, _: pm.Cancel) -> str:
    reply = _checked(cancel_goal(robot, doc.CancelGoal(), ANSWER_TIMEOUT_S))
    return f"canceled: {'the exploration is paused: ' * reply.explores}the robot stops"


def _pause_task(robot: Robot, action: pm.PauseTask) -> str:
    _ask(robot, tp.PAUSE_GOAL, act.PauseGoal(pause=action.pause))
    return "paused: the robot stops" if action.pause else "resumed: the robot continues"


def _emergency_stop(robot: Robot, action: pm.EmergencyStop) -> str:
    asked = doc.EmergencyStop(stop=action.stop, reason="Stop in the console" * action.stop)
    _ask(robot, tp.EMERGENCY_STOP, asked)
    return "stopped: the robot is held at rest" if action.stop else "cleared: the robot may move"


def _dock(robot: Robot, action: pm.Dock) -> str:
    return _start(robot, act.DockRobot(dock_id=action.dock_id), f"docking at {action.dock_id}")


def _undock(robot: Robot, _: pm.Undock) -> str:
    return _start(robot, act.UndockRobot(), "undocking")


def _spin(robot: Robot, action: pm.Spin) -> str:
    goal = act.Spin(target_yaw_rad=action.angle_rad)
    return _start(robot, goal, f"turning by {math.degrees(action.angle_rad):.0f} degrees")


def _back_up(robot: Robot, action: pm.BackUp) -> str:
    goal = act.BackUp(distance_m=action.distance_m)
    return _start(robot, goal, f"backing up by {action.distance_m:g} m")


def _clear_costmaps(robot: Robot, _: pm.ClearCostmaps) -> str:
    _ask(robot, tp.CLEAR_COSTMAP, act.ClearCostmap())
    return "costmaps cleared"


def _find_robot(robot: Robot, _: pm.FindRobot) -> str:
    _ask(robot, tp.REINITIALIZE_GLOBAL_LOCALIZATION, act.Empty())
    return "global localization started: the robot may move"


def _explore(robot: Robot, action: pm.Explore) -> str:
    if "explorer" not in robot.alive():
        raise RefusedError("explore: no explorer service is running")
    robot.publish(tp.EXPLORE_RESUME, msg.Bool(data=action.resume))
    return "exploration resumed" if action.resume else "exploration paused"


def _simulation(robot: Robot, action: pm.Simulation) -> str:
    control = doc.SimulationControl(**action.model_dump(exclude={"do"}, exclude_none=True))
    stats = _ask(robot, tp.SIMULATION_CONTROL, control).stats
    if stats is None:
        return "no world is loaded yet"
    pace = f"at {stats.speed:g}x real time" if stats.speed else "as fast as possible"
    return f"{'paused' if stats.paused else f'running {pace}'} at {stats.sim_time_s:.2f} s"


def _text(place: pm.Place | pm.Destination) -> str:
    return f"({place.x_m:.2f}, {place.y_m:.2f})"


_HANDLERS: dict[type, Callable[[Robot, Any], str]] = {
    pm.Goal: _goal,
    pm.InitialPose: _initial_pose,
    pm.Waypoints: _waypoints,
    pm.DropBox: _drop_box,
    pm.Remove: _remove,
    pm.Cancel: _cancel,
    pm.PauseTask: _pause_task,
    pm.EmergencyStop: _emergency_stop,
    pm.Dock: _dock,
    pm.Undock: _undock,
    pm.Spin: _spin,
    pm.BackUp: _back_up,
    pm.ClearCostmaps: _clear_costmaps,
    pm.FindRobot: _find_robot,
    pm.Explore: _explore,
    pm.Simulation: _simulation,
}

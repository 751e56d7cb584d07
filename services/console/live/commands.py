"""What a page may ask for, and how it is passed on to the services."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from services.common.config import one_line
from services.common.frames import BASE_FOOTPRINT_FRAME, MAP_FRAME, quaternion_from_yaw
from services.common.node import action_documents as act
from services.common.node import documents as doc
from services.common.node import messages as msg
from services.common.node import topics as tp
from services.console.live.stack import Stack, StackError

MAX_MESSAGE_CHARACTERS = 16_384
MAX_WAYPOINTS = 100
MAX_LINEAR_M_S, MAX_ANGULAR_RAD_S = 0.46, 1.9
"""The robot's own limits."""
ANSWER_TIMEOUT_S = 10.0
INITIAL_STD_M, INITIAL_STD_RAD = 0.5, 0.26
"""Of a pose set by hand, as RViz: variances of 0.25 m2 and 0.0685 rad2."""

Coordinate = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Angle = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
Side = Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class Place(doc.Document):
    """A pose in the map."""

    x_m: Coordinate
    y_m: Coordinate
    yaw_rad: Angle = 0.0

    def planar(self) -> doc.Planar:
        """The same as a message."""
        return doc.Planar(x_m=self.x_m, y_m=self.y_m, yaw_rad=self.yaw_rad)


class Goal(doc.Document):
    """Drive to a pose."""

    do: Literal["goal"]
    pose: Place


class InitialPose(doc.Document):
    """Say where the robot is."""

    do: Literal["initial_pose"]
    pose: Place


class Waypoints(doc.Document):
    """Drive to poses one after the other."""

    do: Literal["waypoints"]
    poses: Annotated[tuple[Place, ...], Field(min_length=1, max_length=MAX_WAYPOINTS)]
    stops: bool = Field(True, description="stop at each, or drive through to the last one")


class DropBox(doc.Document):
    """Put a box on the floor."""

    do: Literal["drop_box"]
    pose: Place
    size_m: tuple[Side, Side, Side] = (0.3, 0.3, 0.3)
    mass_kg: Annotated[float, Field(ge=0.0, le=1000.0, allow_inf_nan=False)] = 0.0


class Remove(doc.Document):
    """Remove an entity."""

    do: Literal["remove"]
    name: Name


class Dock(doc.Document):
    """Dock at a marker."""

    do: Literal["dock"]
    dock_id: Name


class Undock(doc.Document):
    """Leave the dock."""

    do: Literal["undock"]


class Spin(doc.Document):
    """Turn on the spot."""

    do: Literal["spin"]
    angle_rad: Annotated[float, Field(ge=-20.0, le=20.0, allow_inf_nan=False)] = 1.57


class BackUp(doc.Document):
    """Drive straight back."""

    do: Literal["back_up"]
    distance_m: Annotated[float, Field(gt=0.0, le=5.0, allow_inf_nan=False)] = 0.15


class Cancel(doc.Document):
    """Cancel what the robot does."""

    do: Literal["cancel"]


class PauseTask(doc.Document):
    """Pause or resume what the robot does."""

    do: Literal["pause_task"]
    pause: bool


class ClearCostmaps(doc.Document):
    """Forget obstacles that are not seen now."""

    do: Literal["clear_costmaps"]


class FindRobot(doc.Document):
    """Search the robot on the whole map."""

    do: Literal["global_localization"]


class Explore(doc.Document):
    """Let the exploration go on, or stop."""

    do: Literal["explore"]
    resume: bool


class Simulation(doc.Document):
    """Pause, resume, step, reset, change the speed."""

    do: Literal["simulation"]
    pause: bool | None = None
    step: Annotated[int, Field(ge=1, le=2400)] | None = None
    reset: Literal["all", "time"] | None = None
    speed: doc.Speed | None = None


class Drive(doc.Document):
    """The velocity that a person wants, to be sent again and again while it is wanted."""

    do: Literal["drive"]
    linear_m_s: Annotated[float, Field(ge=-MAX_LINEAR_M_S, le=MAX_LINEAR_M_S, allow_inf_nan=False)]
    angular_rad_s: Annotated[
        float, Field(ge=-MAX_ANGULAR_RAD_S, le=MAX_ANGULAR_RAD_S, allow_inf_nan=False)
    ]


class Stop(doc.Document):
    """No velocity is wanted any more."""

    do: Literal["stop"]


class Show(doc.Document):
    """What this page wants to be sent."""

    do: Literal["show"]
    camera: bool


Action = Annotated[
    Goal | InitialPose | Waypoints | DropBox | Remove | Dock | Undock | Spin | BackUp | Cancel
    | PauseTask | ClearCostmaps | FindRobot | Explore | Simulation | Drive | Stop | Show,
    Field(discriminator="do"),
]  # fmt: skip


class PageMessage(doc.Document):
    """A message of the page; its answer has the same id."""

    id: Annotated[int, Field(ge=0, le=2**53)]
    action: Action


class RefusedError(Exception):
    """What the page asked for was refused; the text is one line, in the service's words."""


_MESSAGE: TypeAdapter[PageMessage] = TypeAdapter(PageMessage)


def read_message(text: str) -> PageMessage:
    """Raises RefusedError, in one line, where the text is no message of the page."""
    if len(text) > MAX_MESSAGE_CHARACTERS:
        raise RefusedError(
            f"message: {len(text)} characters: must be at most {MAX_MESSAGE_CHARACTERS}"
        )
    try:
        return _MESSAGE.validate_json(text)
    except ValidationError as error:
        raise RefusedError(f"message: {one_line(error)}"[:300]) from error


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


def _goal(stack: Stack, action: Goal) -> str:
    goal = act.NavigateToPose(pose=action.pose.planar())
    return _start(stack, goal, f"driving to {_told(action.pose)}")


def _waypoints(stack: Stack, action: Waypoints) -> str:
    poses = tuple(place.planar() for place in action.poses)
    goal = (
        act.FollowWaypoints(poses=poses) if action.stops else act.NavigateThroughPoses(poses=poses)
    )
    count = len(poses)
    return _start(stack, goal, f"driving to {count} waypoint{'s' * (count != 1)}")


def _initial_pose(stack: Stack, action: InitialPose) -> str:
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


def _drop_box(stack: Stack, action: DropBox) -> str:
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


def _remove(stack: Stack, action: Remove) -> str:
    _ask(stack, tp.DELETE_ENTITY, doc.DeleteEntity(name=action.name))
    return f"{action.name} removed"


def _cancel(stack: Stack, _: Cancel) -> str:
    _ask(stack, tp.CANCEL_GOAL, doc.CancelGoal())
    return "canceled: the robot stops"


def _pause_task(stack: Stack, action: PauseTask) -> str:
    _ask(stack, tp.PAUSE_GOAL, act.PauseGoal(pause=action.pause))
    return "paused: the robot stops" if action.pause else "the robot goes on"


def _dock(stack: Stack, action: Dock) -> str:
    return _start(stack, act.DockRobot(dock_id=action.dock_id), f"docking at {action.dock_id}")


def _undock(stack: Stack, _: Undock) -> str:
    return _start(stack, act.UndockRobot(), "leaving the dock")


def _spin(stack: Stack, action: Spin) -> str:
    goal = act.Spin(target_yaw_rad=action.angle_rad)
    return _start(stack, goal, f"turning by {math.degrees(action.angle_rad):.0f} degrees")


def _back_up(stack: Stack, action: BackUp) -> str:
    goal = act.BackUp(distance_m=action.distance_m)
    return _start(stack, goal, f"driving back by {action.distance_m:g} m")


def _clear_costmaps(stack: Stack, _: ClearCostmaps) -> str:
    _ask(stack, tp.CLEAR_COSTMAP, act.ClearCostmap())
    return "costmaps cleared"


def _find_robot(stack: Stack, _: FindRobot) -> str:
    _ask(stack, tp.REINITIALIZE_GLOBAL_LOCALIZATION, act.Empty())
    return "searching the robot on the whole map; it moves if it has to"


def _explore(stack: Stack, action: Explore) -> str:
    if "explorer" not in stack.services():
        raise RefusedError("explore: no explorer service is running")
    stack.publish(tp.EXPLORE_RESUME, msg.Bool(data=action.resume))
    return "the exploration goes on" if action.resume else "the exploration stops here"


def _simulation(stack: Stack, action: Simulation) -> str:
    control = doc.SimulationControl(**action.model_dump(exclude={"do"}, exclude_none=True))
    stats = _ask(stack, tp.SIMULATION_CONTROL, control).stats
    if stats is None:
        return "there is no world yet"
    pace = f"at {stats.speed:g}x real time" if stats.speed else "as fast as possible"
    return f"{'paused' if stats.paused else f'running {pace}'} at {stats.sim_time_s:.2f} s"


def _told(place: Place) -> str:
    return f"({place.x_m:.2f}, {place.y_m:.2f})"


_HANDLERS: dict[type, Callable[[Stack, Any], str]] = {
    Goal: _goal, InitialPose: _initial_pose, Waypoints: _waypoints, DropBox: _drop_box,
    Remove: _remove, Cancel: _cancel, PauseTask: _pause_task, Dock: _dock, Undock: _undock,
    Spin: _spin, BackUp: _back_up, ClearCostmaps: _clear_costmaps, FindRobot: _find_robot,
    Explore: _explore, Simulation: _simulation,
}  # fmt: skip

"""`Navigator`: drives the robot from a program, with the method names of Nav2's simple commander.

from mazebot.commander.navigator import Navigator, TaskResult

with Navigator.connect() as navigator:          # or Navigator.in_process(session)
    navigator.waitUntilNav2Active()
    navigator.goToPose((0.5, -0.9, 0.0))
    while not navigator.isTaskComplete():
        print(navigator.getFeedback())
    assert navigator.getResult() == TaskResult.SUCCEEDED
"""

from __future__ import annotations

import functools
import itertools
import logging
import os
import uuid
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from enum import Enum
from pathlib import Path
from typing import Any, Self, TypeVar, cast

from pydantic import BaseModel, ValidationError

from mazebot.common.client.actions import ActionClient, cancel_goal
from mazebot.common.client.arguments import built, checks_arguments, refusal, taken
from mazebot.common.client.robot import Robot, RobotError
from mazebot.common.client.subscription import running_world
from mazebot.common.client.user_messages import initial_pose as pose_message
from mazebot.common.config import ConfigError, one_line
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import NonNegative
from mazebot.common.messages.documents import (
    CancelGoal,
    Location,
    Planar,
    PositiveTime,
    SimulationTime,
)
from mazebot.common.messages.topics import (
    ACTION_RESULT,
    AMCL_POSE,
    CLEAR_COSTMAP,
    COMPUTE_PATH,
    GLOBAL_COSTMAP,
    INITIAL_POSE,
    INPUT_AT_WAYPOINT,
    LOAD_MAP,
    LOCAL_COSTMAP,
    NAVIGATION_STATUS,
    PAUSE_GOAL,
    PHOTO,
    REINITIALIZE_GLOBAL_LOCALIZATION,
    SMOOTH_PATH,
    TOGGLE_COLLISION_MONITOR,
    WORLD,
    Query,
    Topic,
)
from mazebot.common.problems import WorldError
from mazebot.common.ros.values import planar_of
from mazebot.embedded.session import Session

Q = TypeVar("Q")
A = TypeVar("A")

ENDPOINT = "tcp/127.0.0.1:7447"
"""The router of a stack on this machine."""

PoseLike = msg.PoseStamped | Planar | SE2 | Sequence[float]
"""A pose in the map: a PoseStamped, or x, y in metres and yaw in radians (0 where left out)."""

_WATCH: tuple[Topic[Any], ...] = (
    AMCL_POSE, GLOBAL_COSTMAP, LOCAL_COSTMAP, NAVIGATION_STATUS, PHOTO, WORLD,
)  # fmt: skip
_AT_ONCE: dict[Topic[Any], str] = {WORLD: "the world", GLOBAL_COSTMAP: "the global costmap"}
"""Of an active stack, on their way as soon as it is connected to."""
_IN_TIME: dict[Topic[Any], str] = {
    AMCL_POSE: "the robot's pose", LOCAL_COSTMAP: "the local costmap",
}  # fmt: skip
"""Sent as simulation time passes."""
_PAUSED_TICKS = 10
_TICK_S = 0.1
"""`isTaskComplete` lets this much time pass, as Nav2's does."""
_NO_MAP, _BAD_MAP_DATA, _BAD_MAP_METADATA = 1, 2, 3
"""Results of nav2_msgs/srv/LoadMap."""
_MAP_TAKEN_NS = 1_000_000_000
_LOG = logging.getLogger("navigator")


class TaskResult(Enum):
    """How a task ended; values as in Nav2."""

    UNKNOWN = 0
    SUCCEEDED = 1
    CANCELED = 2
    FAILED = 3


_RESULTS = {
    "succeeded": TaskResult.SUCCEEDED,
    "canceled": TaskResult.CANCELED,
    "aborted": TaskResult.FAILED,
}


@checks_arguments(ConfigError)
class Navigator:
    """Sends the robot on tasks. Calls that wait end with an error that names the cause.

    Tasks return True where they were accepted; else `getTaskError` has the reason. Distances are in
    metres, angles in radians, durations in seconds of the robot's clock. After `destroyNode` what
    was received last can be read: whatever sends, asks or waits raises RobotError.
    """

    def __init__(self, robot: Robot, timeout_s: PositiveTime = 10.0, name: str = "") -> None:
        """For a robot, with the longest wait for a reply and a name for its goals."""
        self._any_robot = robot
        self._is_closed = False
        self._timeout_s = timeout_s
        self._name = name or uuid.uuid4().hex[:12]
        self._numbers = itertools.count(1)
        self._error: tuple[int, str] | None = None
        """Of what was asked for since the task began; None: nothing was, or the task counts."""
        self._initial_pose: Planar | None = None
        self._closing = ExitStack()
        self._closing.callback(robot.watch(_WATCH))
        self._action = self._closing.enter_context(ActionClient(robot, ACTION_RESULT))

    @classmethod
    def connect(cls, endpoint: str | None = None, timeout_s: PositiveTime = 10.0) -> Self:
        """To a running stack, by its router's endpoint: without one given, that of the variable
        MAZEBOT_BUS_CONNECT, or tcp/127.0.0.1:7447.

        Raises ConfigError where no router responds.
        """
        from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415

        router = endpoint or os.environ.get("MAZEBOT_BUS_CONNECT") or ENDPOINT
        robot = ZenohRobot(router)
        navigator = cls(robot, timeout_s)
        navigator._closing.callback(robot.close)
        return navigator

    @classmethod
    def in_process(cls, session: Session) -> Self:
        """To a `Session`: its time passes while a method waits."""
        # A random name would make each run another.
        return cls(session, name=f"navigator_{next(session.navigators)}")

    def __enter__(self) -> Self:
        self._check_open()
        return self

    def __exit__(self, *_: object) -> None:
        self.destroyNode()

    def setInitialPose(
        self, initial_pose: PoseLike, std_m: NonNegative = 0.05, std_rad: NonNegative = 0.05
    ) -> None:
        """Set the initial pose for localization, with its standard deviations."""
        pose, robot = _planar(initial_pose, "initial_pose"), self._robot
        robot.publish(INITIAL_POSE, pose_message(robot, pose.se2(), std_m, std_rad))
        self._initial_pose = pose

    def reinitializeGlobalLocalization(self) -> None:
        """Start global localization."""
        self._ask(REINITIALIZE_GLOBAL_LOCALIZATION)

    def goToPose(self, pose: PoseLike, behavior_tree: str = "") -> bool:
        """Drive to a pose."""
        return self._send(act.NavigateToPose, pose=_planar(pose), behavior_tree=behavior_tree)

    def goThroughPoses(self, poses: Sequence[PoseLike], behavior_tree: str = "") -> bool:
        """Drive through poses without stopping, to the last one."""
        through = _planars("poses", poses)
        return self._send(act.NavigateThroughPoses, poses=through, behavior_tree=behavior_tree)

    def followWaypoints(
        self,
        poses: Sequence[PoseLike],
        number_of_loops: int = 0,
        goal_index: int = 0,
        tasks: Sequence[act.WaypointTask] = (),
    ) -> bool:
        """Drive to each pose, stop there and do its task; without tasks, stand for 0.2 s."""
        return self._send(
            act.FollowWaypoints,
            poses=_planars("poses", poses),
            tasks=tasks,
            number_of_loops=number_of_loops,
            goal_index=goal_index,
        )

    def followPath(
        self,
        path: Sequence[PoseLike],
        controller_id: str = "",
        goal_checker_id: str = "",
        progress_checker_id: str = "",
        path_handler_id: str = "",
    ) -> bool:
        """Drive along a path."""
        return self._send(
            act.FollowPath,
            path=_planars("path", path),
            controller_id=controller_id,
            goal_checker_id=goal_checker_id,
            progress_checker_id=progress_checker_id,
            path_handler_id=path_handler_id,
        )

    def spin(
        self,
        spin_dist: float = 1.57,
        time_allowance: NonNegative = 10.0,
        disable_collision_checks: bool = False,
    ) -> bool:
        """Turn on the spot."""
        return self._send(
            act.Spin,
            target_yaw_rad=spin_dist,
            time_allowance_s=time_allowance,
            disable_collision_checks=disable_collision_checks,
        )

    def backup(
        self,
        backup_dist: float = 0.15,
        backup_speed: float = 0.025,
        time_allowance: NonNegative = 10.0,
        disable_collision_checks: bool = False,
    ) -> bool:
        """Drive straight back."""
        return self._send(
            act.BackUp,
            distance_m=backup_dist,
            speed_m_s=backup_speed,
            time_allowance_s=time_allowance,
            disable_collision_checks=disable_collision_checks,
        )

    def driveOnHeading(
        self,
        dist: float = 0.15,
        speed: float = 0.025,
        time_allowance: NonNegative = 10.0,
        disable_collision_checks: bool = False,
    ) -> bool:
        """Drive straight on."""
        return self._send(
            act.DriveOnHeading,
            distance_m=dist,
            speed_m_s=speed,
            time_allowance_s=time_allowance,
            disable_collision_checks=disable_collision_checks,
        )

    def wait(self, duration: NonNegative) -> bool:
        """Stand still."""
        return self._send(act.Wait, duration_s=duration)

    def assistedTeleop(self, time_allowance: NonNegative = 30.0) -> bool:
        """Follow `/cmd_vel_teleop`, slowed before obstacles."""
        return self._send(act.AssistedTeleop, time_allowance_s=time_allowance)

    def dockRobotByPose(
        self, dock_pose: PoseLike, dock_type: str = "", nav_to_dock: bool = True
    ) -> bool:
        """Dock at the marker of the dock whose docked robot has this pose."""
        where = _planar(dock_pose)
        return self._send(act.DockRobot, dock_pose=where, navigate_to_staging_pose=nav_to_dock)

    def dockRobotByID(self, dock_id: str, nav_to_dock: bool = True) -> bool:
        """Dock at a dock by its name, or at a marker by its id."""
        return self._send(act.DockRobot, dock_id=dock_id, navigate_to_staging_pose=nav_to_dock)

    def undockRobot(self, dock_type: str = "") -> bool:
        """Leave the dock."""
        return self._send(act.UndockRobot)

    def cancelTask(self) -> None:
        """Cancel the task: the robot stops. Without a task it does nothing."""
        robot = self._robot
        if self._action.is_active:
            cancel_goal(robot, self._action.goal or CancelGoal(), self._timeout_s)

    def inputAtWaypoint(self) -> None:
        """Send the input for which the robot waits at a waypoint.

        Raises ConfigError where it follows none.
        """
        reply = self._ask(INPUT_AT_WAYPOINT)
        if reply.error:
            raise ConfigError(reply.error)

    def getPhoto(self) -> msg.CompressedImage | None:
        """The newest picture taken at a waypoint, as PNG; None before the first."""
        return self._any_robot.latest(PHOTO)

    def pauseTask(self, pause: bool = True) -> None:
        """Pause the task, with the robot stopped, or resume it."""
        self._ask(PAUSE_GOAL, pause=pause)

    def isTaskComplete(self) -> bool:
        """Whether the task has ended, or there is none; lets up to 0.1 s pass if it has not."""
        self._check_open()
        self._action.update()
        if self._action.is_active:
            self._action.update(_TICK_S)
        return not self._action.is_active

    def getFeedback(self) -> act.ActionFeedback | None:
        """The newest feedback of the task; None before the first."""
        return self._action.feedback

    def getResult(self) -> TaskResult:
        """How the task ended; UNKNOWN while it is active, FAILED where it was not accepted."""
        if self._action.result is not None:
            return _RESULTS[self._action.result.status]
        return TaskResult.FAILED if self.getTaskError()[0] else TaskResult.UNKNOWN

    def getActionResult(self) -> act.ActionResult | None:
        """The whole result, with waypoints and recoveries; None while the task is active."""
        return self._action.result

    def getTaskError(self) -> tuple[int, str]:
        """(error code, text) of the task, or of a path or map asked for since; (0, "") where there
        is none.
        """
        if self._error is not None:
            return self._error
        if self._action.result is not None:
            return self._action.result.error_code, self._action.result.error_msg
        return 0, ""

    def setTaskError(self, error_code: int, error_msg: str) -> None:
        """Set what `getTaskError` returns."""
        self._error = (error_code, error_msg)

    def clearPreviousState(self) -> None:
        """Forget the last task."""
        self._action.forget()
        self._error = None

    def waitUntilNav2Active(
        self,
        navigator: str = "bt_navigator",
        localizer: str = "amcl",
        timeout_s: SimulationTime = 60.0,
    ) -> None:
        """Wait until the robot has a pose and takes goals, and world and costmaps are here. What a
        paused simulation does not send, pose and local costmap, is not waited for.

        Raises TimeoutError, with what it waits for; RobotError where the stack's router is lost.
        """
        now_ns = self._robot.now_ns()
        end_ns = now_ns + round(timeout_s * 1e9)
        if self._initial_pose is not None:
            self.setInitialPose(self._initial_pose)
        still = 0
        while (what := self._missing(is_paused=still >= _PAUSED_TICKS)) is not None:
            if now_ns >= end_ns:
                # It tells where nothing could come.
                self._robot.alive()
                raise TimeoutError(
                    f"waitUntilNav2Active: timed out after {timeout_s:g} s waiting for {what}"
                    f"{self._robot.elsewhere('navigation')}"
                )
            self._robot.wait(_TICK_S)
            before_ns, now_ns = now_ns, self._robot.now_ns()
            still = still + 1 if now_ns == before_ns else 0

    def _missing(self, is_paused: bool) -> str | None:
        """What of an active stack is not there, in words."""
        status = self._robot.latest(NAVIGATION_STATUS)
        if status is None:
            return "the navigation service"
        if not status.navigation_active:
            return "localization"
        awaited = _AT_ONCE if is_paused else _AT_ONCE | _IN_TIME
        return next((awaited[one] for one in awaited if self._robot.latest(one) is None), None)

    def getPath(
        self, start: PoseLike | None, goal: PoseLike, planner_id: str = "", use_start: bool = False
    ) -> list[Planar] | None:
        """A path; from `start` with `use_start`, else from the robot. None: see `getTaskError`.

        Raises ConfigError where `use_start` has no `start`.
        """
        return self.getPathThroughPoses(start, [goal], planner_id, use_start)

    def getPathThroughPoses(
        self,
        start: PoseLike | None,
        goals: Sequence[PoseLike],
        planner_id: str = "",
        use_start: bool = False,
    ) -> list[Planar] | None:
        """A path through all goals to the last one, as `getPath`."""
        reply = self._ask(
            COMPUTE_PATH,
            goals=_planars("goals", goals),
            start=_planar(start, "start") if use_start else None,
            planner_id=planner_id,
        )
        self._error = (reply.error_code, reply.error_msg)
        return None if reply.error_code else list(reply.path)

    def smoothPath(
        self,
        path: Sequence[PoseLike],
        smoother_id: str = "",
        max_duration: float = 2.0,
        check_for_collision: bool = False,
    ) -> list[Planar] | None:
        """A path, smoothed; None: see `getTaskError`.

        `max_duration` has no effect: the smoother's passes are limited, by `smoothing_iterations`.
        """
        reply = self._ask(
            SMOOTH_PATH,
            path=_planars("path", path),
            smoother_id=smoother_id,
            check_for_collisions=check_for_collision,
        )
        self._error = (reply.error_code, reply.error_msg)
        return None if reply.error_code else list(reply.path)

    def changeMap(self, map_filepath: str | Path) -> bool:
        """Replace the world's map by one of map_server's form, by its YAML file here.

        A task ends, and localization restarts. Where it cannot be used, `getTaskError` gives
        the number of nav2_msgs/srv/LoadMap, and the cause.
        """
        from mazebot.common.ros.map_exchange import document_of_map  # noqa: PLC0415
        from mazebot.common.world.map_files import read_map  # noqa: PLC0415 - loads images

        self._check_open()
        path = Path(map_filepath)
        if not path.is_file():
            self._error = (_NO_MAP, f"{path}: no such file")
            return False
        try:
            chart = read_map(path)
        except WorldError as error:
            image = any(problem.field == "image" for problem in error.problems)
            self._error = (_BAD_MAP_DATA if image else _BAD_MAP_METADATA, str(error))
            return False
        if chart.warning:
            _LOG.warning("%s", chart.warning)
        reply = self._robot.ask(LOAD_MAP, document_of_map(chart), self._timeout_s)
        self._error = (reply.result, reply.error)
        if reply.result:
            return False
        # Until navigation has taken the map; it stays active where it is the same one.
        end_ns = self._robot.now_ns() + _MAP_TAKEN_NS
        while self._robot.now_ns() < end_ns:
            status = self._robot.latest(NAVIGATION_STATUS)
            if status is not None and not status.navigation_active:
                break
            self._robot.wait(0.05)
        return True

    def clearAllCostmaps(self) -> None:
        """Clear all obstacles that are not in the map and not seen now."""
        self._clear("all")

    def clearLocalCostmap(self) -> None:
        """As `clearAllCostmaps`, in the local costmap."""
        self._clear("local")

    def clearGlobalCostmap(self) -> None:
        """As `clearAllCostmaps`, in the global costmap."""
        self._clear("global")

    def clearCostmapExceptRegion(self, reset_distance: NonNegative) -> None:
        """Clear obstacles outside a square of this side around the robot."""
        self._clear("all", area="except_region", reset_distance_m=reset_distance)

    def clearCostmapAroundRobot(self, reset_distance: NonNegative) -> None:
        """Clear obstacles in a square of this side around the robot."""
        self._clear("all", area="around_robot", reset_distance_m=reset_distance)

    def clearLocalCostmapAroundPose(self, pose: PoseLike, reset_distance: NonNegative) -> None:
        """Clear obstacles of the local costmap in a square of this side around a pose."""
        where = _planar(pose)
        self._clear("local", area="around_pose", reset_distance_m=reset_distance, pose=where)

    def clearGlobalCostmapAroundPose(self, pose: PoseLike, reset_distance: NonNegative) -> None:
        """Clear obstacles of the global costmap in a square of this side around a pose."""
        where = _planar(pose)
        self._clear("global", area="around_pose", reset_distance_m=reset_distance, pose=where)

    def getGlobalCostmap(self) -> msg.OccupancyGrid | None:
        """The newest global costmap; None before the first."""
        return self._any_robot.latest(GLOBAL_COSTMAP)

    def getLocalCostmap(self) -> msg.OccupancyGrid | None:
        """The newest local costmap; None before the first."""
        return self._any_robot.latest(LOCAL_COSTMAP)

    def toggleCollisionMonitor(self, enable: bool) -> None:
        """Switch the collision monitor on or off."""
        self._ask(TOGGLE_COLLISION_MONITOR, enable=enable)

    def getPose(self) -> SE2 | None:
        """The robot's estimated pose in the map; None before the first."""
        pose = self._any_robot.latest(AMCL_POSE)
        return None if pose is None else msg.se2_from_pose(pose.pose.pose)

    def locations(self) -> dict[str, Location]:
        """The named places of the world. Raises RobotError where no world is received in time."""
        world = self._any_robot.latest(WORLD) or running_world(self._robot, self._timeout_s)
        return {place.name: place for place in world.locations}

    def destroyNode(self) -> None:
        """End the connection; a task continues."""
        self._is_closed = True
        self._closing.close()

    destroy_node = destroyNode
    info: Callable[[str], None] = staticmethod(functools.partial(_LOG.info, "%s"))
    warn: Callable[[str], None] = staticmethod(functools.partial(_LOG.warning, "%s"))
    error: Callable[[str], None] = staticmethod(functools.partial(_LOG.error, "%s"))
    debug: Callable[[str], None] = staticmethod(functools.partial(_LOG.debug, "%s"))

    @property
    def _robot(self) -> Robot:
        """The robot. Raises RobotError where the connection to it was ended."""
        self._check_open()
        return self._any_robot

    def _check_open(self) -> None:
        if self._is_closed:
            raise RobotError("the navigator is closed")

    def _send(self, kind: type[act.ActionGoal], **fields: object) -> bool:
        self._check_open()
        goal = built(kind, fields)
        self.clearPreviousState()
        goal_id = f"{self._name}-{next(self._numbers)}"
        reply = self._action.send(goal_id, goal, self._timeout_s)
        if not reply.accepted:
            self._error = (reply.error_code, reply.error_msg)
        return reply.accepted

    def _clear(self, costmap: str, **fields: object) -> None:
        reply = self._ask(CLEAR_COSTMAP, costmap=costmap, **fields)
        if reply.error:
            raise ConfigError(reply.error)

    def _ask(self, query: Query[Q, A], **fields: object) -> A:
        robot = self._robot
        message = built(cast("type[BaseModel]", query.request), fields)
        return robot.ask(query, cast("Q", message), self._timeout_s)


def _planar(pose: PoseLike | None, name: str = "pose") -> Planar:
    """Raises ConfigError for a pose of another frame, or with numbers that are no pose."""
    if isinstance(pose, msg.PoseStamped):
        try:
            return planar_of(pose)
        except ValidationError as error:
            raise ConfigError(f"{name}: {one_line(error)}") from error
        except (ValueError, TypeError, AttributeError) as error:
            raise ConfigError(f"{name}: {error}") from error
    given = (pose.x_m, pose.y_m, pose.yaw_rad) if isinstance(pose, Planar) else pose
    try:
        numbers = taken(tuple[float, ...], given)
    except ValueError:
        numbers = ()
    if len(numbers) not in (2, 3):
        what = "must be a PoseStamped, or x and y (m), and yaw (rad): finite numbers"
        raise ConfigError(refusal(name, what, pose))
    x_m, y_m, yaw_rad = [*numbers, 0.0][:3]
    return Planar(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)


def _planars(name: str, poses: Sequence[PoseLike]) -> tuple[Planar, ...]:
    return tuple(_planar(pose, name) for pose in poses)

"""Condition nodes, which answer at once; and those that have become actions since Lyrical."""

from __future__ import annotations

import logging
import math

from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.node.log import LEVELS
from mazebot.navigation.behavior.context import TrackingFeedback
from mazebot.navigation.behavior.engine.ports import Port, as_codes
from mazebot.navigation.behavior.engine.tree import Node, NodeStatus
from mazebot.navigation.behavior.nodes.goals import goals_on_blackboard
from mazebot.navigation.errors import NavigationError

RUNNING, SUCCESS, FAILURE = NodeStatus.RUNNING, NodeStatus.SUCCESS, NodeStatus.FAILURE
_LOG = logging.getLogger("navigation")
_FRAMES = (Port("global_frame"), Port("robot_base_frame"))


class Condition(Node):
    """Succeeds where it holds; where the robot's pose is not known, it does not."""

    def _tick(self, now_ns: int) -> NodeStatus:
        try:
            return SUCCESS if self._holds(now_ns) else FAILURE
        except NavigationError:
            return FAILURE

    def _holds(self, now_ns: int) -> bool:
        raise NotImplementedError


class AlwaysSuccess(Node):
    """Succeeds."""

    def _tick(self, now_ns: int) -> NodeStatus:
        return SUCCESS


class AlwaysFailure(Node):
    """Fails."""

    def _tick(self, now_ns: int) -> NodeStatus:
        return FAILURE


class Log(Node):
    """Writes a message to navigation's log; fails where its level is none."""

    ports = (Port("level", required=True), Port("message", required=True))

    def _tick(self, now_ns: int) -> NodeStatus:
        level = LEVELS.get(self.text("level"))
        if level is None:
            names = ", ".join(LEVELS)
            _LOG.error("%s: level is %.20r: must be one of %s", self, self.text("level"), names)
            return FAILURE
        _LOG.log(level, "%s", self.text("message"))
        return SUCCESS


class ScriptNode(Node):
    """Runs a script, and succeeds."""

    ports = (Port("code", "script", required=True),)

    def _tick(self, now_ns: int) -> NodeStatus:
        self.run("code")
        return SUCCESS


class ScriptCondition(Node):
    """Succeeds where a script's value is true, else fails."""

    ports = (Port("code", "script", required=True),)

    def _tick(self, now_ns: int) -> NodeStatus:
        return SUCCESS if self.holds("code") else FAILURE


class Sleep(Node):
    """Succeeds `msec` milliseconds after it was first reached."""

    ports = (Port("msec", "natural", required=True),)
    _start_ns = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        if self.status is not RUNNING:
            self._start_ns = now_ns
        done = now_ns - self._start_ns >= self.natural("msec") * 1_000_000
        return SUCCESS if done else RUNNING


class GoalUpdated(Condition):
    """Holds when the goal has changed since this node was first reached in a row of ticks."""

    _goals: tuple[SE2, ...] = ()
    _last_tick = -2

    def _holds(self, now_ns: int) -> bool:
        goals, tick = goals_on_blackboard(self.place.blackboard), self.place.run.tick_number
        fresh = tick - self._last_tick > 1
        self._last_tick = tick
        if fresh or goals == self._goals:
            self._goals = goals
            return False
        self._goals = goals
        return True


class GlobalUpdatedGoal(Condition):
    """Holds for each goal once: also for the first."""

    _goals: tuple[SE2, ...] | None = None

    def _holds(self, now_ns: int) -> bool:
        goals = goals_on_blackboard(self.place.blackboard)
        if goals == self._goals:
            return False
        self._goals = goals
        return True


class GoalReached(Condition):
    """Holds within 0.25 m and 0.25 rad of a pose."""

    ports = (Port("goal", "pose", required=True), *_FRAMES)

    def _holds(self, now_ns: int) -> bool:
        goal = self.pose("goal")
        if goal is None:
            return False
        pose = self.context.pose()
        return (
            pose.distance_m(goal) <= 0.25 and abs(wrap_angle(pose.yaw_rad - goal.yaw_rad)) <= 0.25
        )


class ArePosesNear(Condition):
    """Holds where two poses are within `tolerance` m."""

    ports = (
        Port("ref_pose", "pose", required=True),
        Port("target_pose", "pose", required=True),
        Port("tolerance", "number", "0.5"),
        Port("global_frame"),
    )

    def _holds(self, now_ns: int) -> bool:
        one, other = self.pose("ref_pose"), self.pose("target_pose")
        if one is None or other is None:
            return False
        return one.distance_m(other) <= self.number("tolerance")


class DistanceTraveled(Condition):
    """Holds each time that the robot has moved by `distance` m in a straight line."""

    ports = (Port("distance", "number", "1.0"), *_FRAMES)

    _start: SE2 | None = None

    def _holds(self, now_ns: int) -> bool:
        pose = self.context.pose()
        if self._start is None or pose.distance_m(self._start) < self.number("distance"):
            self._start = self._start or pose
            return False
        self._start = pose
        return True


class TimeExpired(Condition):
    """Holds each time that `seconds` have passed."""

    ports = (Port("seconds", "number", "1.0"),)

    _start_ns: int | None = None

    def _holds(self, now_ns: int) -> bool:
        if self._start_ns is None:
            self._start_ns = now_ns
        if now_ns - self._start_ns < self.number("seconds") * 1e9:
            return False
        self._start_ns = now_ns
        return True


class TransformAvailable(Condition):
    """Holds for a transform from the map while the robot is localised; for others always."""

    ports = (Port("child", required=True), Port("parent", required=True))

    def _holds(self, now_ns: int) -> bool:
        ends = {self.text("child").strip("/"), self.text("parent").strip("/")}
        return "map" not in ends or self.context.is_localized()


class InitialPoseReceived(Condition):
    """Holds while the robot is localised."""

    ports = (Port("initial_pose_received"),)

    def _holds(self, now_ns: int) -> bool:
        return self.context.is_localized()


class IsStuck(Condition):
    """Holds after 3 s in which the robot moved by less than 5 cm and 0.1 rad.

    Nav2's looks for a braking of more than 10 m/s2, which a small robot never shows.
    """

    _at: SE2 | None = None
    _since_ns = 0

    def _holds(self, now_ns: int) -> bool:
        pose, at = self.context.odom_from_base(), self._at
        if (
            at is None
            or pose.distance_m(at) >= 0.05
            or abs(wrap_angle(pose.yaw_rad - at.yaw_rad)) >= 0.1
        ):
            self._at, self._since_ns = pose, now_ns
            return False
        return now_ns - self._since_ns >= 3_000_000_000


_BATTERY_TOPIC = Port(
    "battery_topic", no_effect="ignored: the battery is heard on /battery_state",
    unless=("/battery_state", "battery_state", "/battery_status", "battery_status"),
)  # fmt: skip


class IsBatteryLow(Condition):
    """Holds while the battery has `min_battery` (0 to 1, or with `is_voltage` volts) or less; not
    before it has said so. `/battery_state` is heard, whatever the topic.
    """

    ports = (
        Port("min_battery", "number", required=True), _BATTERY_TOPIC,
        Port("is_voltage", "flag", "false"),
    )  # fmt: skip

    def _holds(self, now_ns: int) -> bool:
        battery = self.context.battery()
        if battery is None:
            return False
        level = battery.voltage_v if self.flag("is_voltage") else battery.share
        return bool(level <= self.number("min_battery"))


class IsBatteryCharging(Condition):
    """Holds while the battery says that it is being charged."""

    ports = (_BATTERY_TOPIC,)

    def _holds(self, now_ns: int) -> bool:
        battery = self.context.battery()
        return battery is not None and battery.is_charging


class AreErrorCodesPresent(Condition):
    """Holds where an error code is one of a list."""

    ports = (
        Port("error_code", "integer", required=True),
        Port("error_codes_to_check", "codes", required=True),
    )

    def _holds(self, now_ns: int) -> bool:
        code = self.get("error_code")
        wanted = self._read("error_codes_to_check", as_codes)
        return code is not None and self.integer("error_code") in wanted


def _would_help(kind: str, *codes: ErrorCode) -> type[AreErrorCodesPresent]:
    """The condition that a recovery could help against one of some codes."""
    listed = ";".join(str(int(code)) for code in codes)
    ports = (
        Port("error_code", "integer", required=True),
        Port("error_codes_to_check", "codes", default=listed),
    )
    return type(kind, (AreErrorCodesPresent,), {"ports": ports, "__doc__": f"Codes {listed}."})


WouldAControllerRecoveryHelp = _would_help(
    "WouldAControllerRecoveryHelp",
    ErrorCode.CONTROLLER_UNKNOWN,
    ErrorCode.PATIENCE_EXCEEDED,
    ErrorCode.FAILED_TO_MAKE_PROGRESS,
    ErrorCode.NO_VALID_CONTROL,
)
WouldAPlannerRecoveryHelp = _would_help(
    "WouldAPlannerRecoveryHelp",
    ErrorCode.PLANNER_UNKNOWN,
    ErrorCode.PLANNER_TIMEOUT,
    ErrorCode.NO_VALID_PATH,
    ErrorCode.THROUGH_POSES_UNKNOWN,
    ErrorCode.THROUGH_POSES_TIMEOUT,
    ErrorCode.THROUGH_POSES_NO_VALID_PATH,
)
WouldASmootherRecoveryHelp = _would_help(
    "WouldASmootherRecoveryHelp",
    ErrorCode.SMOOTHER_UNKNOWN,
    ErrorCode.SMOOTHER_TIMEOUT,
    ErrorCode.SMOOTHED_PATH_IN_COLLISION,
    ErrorCode.FAILED_TO_SMOOTH_PATH,
)
WouldARouteRecoveryHelp = _would_help(
    "WouldARouteRecoveryHelp",
    ErrorCode.ROUTE_UNKNOWN,
    ErrorCode.ROUTE_TIMEOUT,
    ErrorCode.NO_VALID_ROUTE,
)


class IsWithinPathTrackingBounds(Condition):
    """Holds while the robot is near its path; before the first feedback it holds too."""

    ports = (
        Port("max_error_left", "number", "0.5"),
        Port("max_error_right", "number", "0.5"),
        Port("max_error_heading", "number", "3.14"),
        Port("tracking_feedback"),
    )

    def _holds(self, now_ns: int) -> bool:
        feedback = self.get("tracking_feedback")
        if not isinstance(feedback, TrackingFeedback):
            return True
        off_m = feedback.position_tracking_error_m
        return -self.number("max_error_right") <= off_m <= self.number("max_error_left") and abs(
            feedback.heading_tracking_error_rad
        ) <= self.number("max_error_heading")


class CheckPoseOccupancy(Condition):
    """Holds where the robot would collide at a pose. `IsPoseOccupied` until Kilted."""

    ports = (
        Port("pose", "pose", required=True),
        Port("cost_threshold", "number", "254"),
        Port("use_footprint", "flag", "true"),
        Port("consider_unknown_as_obstacle", "flag", "false"),
        Port("service_name"),
        Port("server_timeout", "number"),
    )

    def _holds(self, now_ns: int) -> bool:
        pose = self.pose("pose")
        if pose is None:
            return False
        cost = self.context.cost_at(pose, self.flag("use_footprint"))
        if cost == _UNKNOWN:
            return self.flag("consider_unknown_as_obstacle")
        return cost >= self.number("cost_threshold")


_UNKNOWN = 255


class CheckStopStatus(Node):
    """Succeeds once the robot has stood for `duration_stopped` ms; fails while it moves.

    `IsStopped` until Kilted.
    """

    ports = (
        Port("velocity_threshold", "number", "0.01"),
        Port("duration_stopped", "number", "1000"),
    )

    _since_ns: int | None = None

    def _tick(self, now_ns: int) -> NodeStatus:
        velocity = self.context.velocity()
        speed = math.hypot(velocity.linear_m_s, velocity.angular_rad_s)
        if speed > self.number("velocity_threshold"):
            self._since_ns = None
            return FAILURE
        if self._since_ns is None:
            self._since_ns = now_ns
        stood_ms = (now_ns - self._since_ns) * 1e-6
        return SUCCESS if stood_ms >= self.number("duration_stopped") else RUNNING

    def _halt(self) -> None:
        self._since_ns = None

"""Nodes of the behaviour server and the docking server."""

from __future__ import annotations

from abc import abstractmethod

from services.common.error_codes import ErrorCode
from services.common.frames import SE2
from services.navigation.behavior.assisted_teleop import AssistedTeleop
from services.navigation.behavior.back_up import BackUp, freer_drive
from services.navigation.behavior.context import FollowRequest
from services.navigation.behavior.docking import (
    Docker,
    DockingStep,
    DockState,
    Undocker,
    staging_pose,
)
from services.navigation.behavior.drive_on_heading import DriveGoal, DriveOnHeading
from services.navigation.behavior.motion import Motion
from services.navigation.behavior.nodes_action import ACTION_PORTS, ActionNode
from services.navigation.behavior.ports import Port, out
from services.navigation.behavior.spin import Spin, SpinGoal, freer_turn_rad
from services.navigation.behavior.tree import NodeStatus, TreeError
from services.navigation.behavior.wait import Wait
from services.navigation.control.collision import Velocity
from services.navigation.errors import NavigationError

RUNNING, SUCCESS = NodeStatus.RUNNING, NodeStatus.SUCCESS
_ALLOWANCE = Port("time_allowance", "number", "10.0")
_UNCHECKED = Port("disable_collision_checks", "flag", "false")


class MotionNode(ActionNode):
    """Steps a behaviour."""

    _motion: Motion | None = None

    def _begin(self, now_ns: int) -> None:
        self._motion = self._make()
        self.place.run.running_motion = self._motion

    def _go_on(self, now_ns: int) -> NodeStatus:
        assert self._motion is not None
        run = self.place.run
        step = self._motion.step(
            now_ns,
            run.control_period_s,
            self.context.odom_from_base(),
            self.context.time_to_collision,
        )
        if step.done:
            self._cancel()
            return SUCCESS
        self.context.drive(step.velocity)
        return RUNNING

    def _fail(self, code: int, message: str) -> None:
        super()._fail(code, message + self.where())

    def _cancel(self) -> None:
        self._motion = self.place.run.running_motion = None
        self.context.stop()

    @abstractmethod
    def _make(self) -> Motion:
        """The behaviour to run."""


class SpinNode(MotionNode):
    """Spin; as a recovery it turns to the side that is freer."""

    action = "Spin"
    ports = (
        Port("spin_dist", "number", "1.57"),
        _ALLOWANCE,
        Port("is_recovery", "flag", "true"),
        _UNCHECKED,
        *ACTION_PORTS,
    )

    def _make(self) -> Motion:
        params = self.place.run.behaviors
        angle_rad, unchecked = self.number("spin_dist"), self.flag("disable_collision_checks")
        if self.place.in_recovery and self.flag("is_recovery") and not unchecked:
            angle_rad = freer_turn_rad(angle_rad, params, self.context.time_to_collision)
        return Spin(params, SpinGoal(angle_rad, self.number("time_allowance"), unchecked))


class BackUpNode(MotionNode):
    """BackUp; as a recovery it drives ahead where only that way is free."""

    action = "BackUp"
    ports = (
        Port("backup_dist", "number", "0.15"),
        Port("backup_speed", "number", "0.025"),
        _ALLOWANCE,
        _UNCHECKED,
        *ACTION_PORTS,
    )

    def _make(self) -> Motion:
        params = self.place.run.behaviors
        goal = DriveGoal(
            self.number("backup_dist"),
            self.number("backup_speed"),
            self.number("time_allowance"),
            self.flag("disable_collision_checks"),
        )
        if self.place.in_recovery and not goal.disable_collision_checks:
            return freer_drive(goal, params, self.context.time_to_collision)
        return BackUp(params, goal)


class DriveOnHeadingNode(MotionNode):
    """DriveOnHeading."""

    action = "DriveOnHeading"
    ports = (
        Port("dist_to_travel", "number", "0.15"),
        Port("speed", "number", "0.025"),
        _ALLOWANCE,
        _UNCHECKED,
        *ACTION_PORTS,
    )

    def _make(self) -> Motion:
        goal = DriveGoal(
            self.number("dist_to_travel"),
            self.number("speed"),
            self.number("time_allowance"),
            self.flag("disable_collision_checks"),
        )
        return DriveOnHeading(self.place.run.behaviors, goal)


class WaitNode(MotionNode):
    """Wait."""

    action = "Wait"
    ports = (Port("wait_duration", "number", "1.0"), *ACTION_PORTS)

    def _make(self) -> Motion:
        return Wait(self.number("wait_duration"))


class AssistedTeleopNode(MotionNode):
    """AssistedTeleop."""

    action = "AssistedTeleop"
    ports = (_ALLOWANCE, Port("is_recovery", "flag", "false"), *ACTION_PORTS)

    def _make(self) -> Motion:
        return AssistedTeleop(self.place.run.behaviors, self.number("time_allowance"))

    def _go_on(self, now_ns: int) -> NodeStatus:
        assert isinstance(self._motion, AssistedTeleop)
        self._motion.ask(self.context.teleop())
        return super()._go_on(now_ns)


class DockRobotNode(ActionNode):
    """Drives to the dock's staging pose if need be, then docks at its marker."""

    action = "DockRobot"
    ports = (
        Port("use_dock_id", "flag", "true"),
        Port("dock_id"),
        Port("dock_pose", "pose"),
        Port("dock_type"),
        Port("max_staging_time", "number", "1000.0"),
        Port("navigate_to_staging_pose", "flag", "true"),
        out("success", "flag"),
        out("num_retries", "integer"),
        *ACTION_PORTS,
    )

    _docker: Docker | None = None
    _dock = SE2(0.0, 0.0, 0.0)
    _began_ns = 0
    _planned_ns: int | None = None

    def _begin(self, now_ns: int) -> None:
        self._began_ns, self._planned_ns, self._docker = now_ns, None, None
        self.put("success", False)
        self.put("num_retries", 0)
        if self.flag("use_dock_id"):
            self._dock = self.context.dock(self.text("dock_id"))
            return
        pose = self.pose("dock_pose")
        if pose is None:
            raise TreeError(f"{self}, port 'dock_pose': there is no pose on the blackboard")
        self._dock = pose

    def _go_on(self, now_ns: int) -> NodeStatus:
        run, context = self.place.run, self.context
        if self._docker is None and not self._is_staged(now_ns):
            run.docking_step = DockingStep(
                DockState.NAV_TO_STAGING_POSE, Velocity(0.0, 0.0), 0, False
            )
            return RUNNING
        odom_from_base = context.odom_from_base()
        if self._docker is None:
            odom_from_map = odom_from_base @ context.pose().inverse()
            self._docker = Docker(run.docking, odom_from_map @ self._dock)
        step = self._docker.step(
            now_ns,
            run.control_period_s,
            odom_from_base,
            context.marker(self.text("dock_id")),
            context.time_to_collision,
        )
        run.docking_step = step
        self.put("num_retries", step.num_retries)
        if step.done:
            context.stop()
            self.put("success", True)
            return SUCCESS
        context.drive(step.velocity)
        return RUNNING

    def _is_staged(self, now_ns: int) -> bool:
        """Whether docking can begin; drives to the staging pose until then."""
        context, docking = self.context, self.place.run.docking
        staging = staging_pose(docking, self._dock)
        near = context.pose().distance_m(staging) <= docking.dock_prestaging_tolerance_m
        if self._planned_ns is None and (near or not self.flag("navigate_to_staging_pose")):
            return True
        if (now_ns - self._began_ns) * 1e-9 > self.number("max_staging_time"):
            raise NavigationError(
                ErrorCode.FAILED_TO_STAGE,
                f"the staging pose was not reached in {self.number('max_staging_time'):.0f} s",
            )
        try:
            if self._planned_ns is None or now_ns - self._planned_ns >= 1_000_000_000:
                self._planned_ns = now_ns
                context.follow(FollowRequest(context.compute_path(None, (staging,), "")))
            if not context.control(now_ns).reached:
                return False
        except NavigationError as error:
            raise NavigationError(
                ErrorCode.FAILED_TO_STAGE, f"the staging pose was not reached: {error.message}"
            ) from None
        context.stop()
        return True

    def _cancel(self) -> None:
        self._docker = self.place.run.docking_step = None
        self.context.stop()


class UndockRobotNode(ActionNode):
    """Drives back from the dock to its staging pose."""

    action = "UndockRobot"
    ports = (
        Port("dock_type"),
        Port("max_undocking_time", "number", "30.0"),
        out("success", "flag"),
        *ACTION_PORTS,
    )

    _undocker: Undocker | None = None

    def _begin(self, now_ns: int) -> None:
        self.put("success", False)
        self._undocker = Undocker(self.place.run.docking, self.number("max_undocking_time"))

    def _go_on(self, now_ns: int) -> NodeStatus:
        assert self._undocker is not None
        step = self._undocker.step(
            now_ns,
            self.place.run.control_period_s,
            self.context.odom_from_base(),
            self.context.time_to_collision,
        )
        if step.done:
            self.context.stop()
            self.put("success", True)
            return SUCCESS
        self.context.drive(step.velocity)
        return RUNNING

    def _cancel(self) -> None:
        self._undocker = None
        self.context.stop()

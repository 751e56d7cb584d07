"""Nodes of the behaviour server and the docking server."""

from __future__ import annotations

import logging
from abc import abstractmethod
from dataclasses import replace

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.context import Dock, MarkerPose
from mazebot.navigation.behavior.docking.dock_estimate import Expected
from mazebot.navigation.behavior.docking.docking import (
    LEAST_STAGING_SHARE,
    Docker,
    DockingParams,
    DockingStep,
    DockState,
    Undocker,
    staging_pose,
)
from mazebot.navigation.behavior.engine.ports import Port, out
from mazebot.navigation.behavior.engine.tree import Errand, NodeStatus, TreeError
from mazebot.navigation.behavior.motions.assisted_teleop import AssistedTeleop
from mazebot.navigation.behavior.motions.back_up import BackUp, freer_drive
from mazebot.navigation.behavior.motions.drive_on_heading import DriveGoal, DriveOnHeading
from mazebot.navigation.behavior.motions.motion import Motion
from mazebot.navigation.behavior.motions.spin import Spin, SpinGoal, freer_turn_rad
from mazebot.navigation.behavior.motions.wait import Wait
from mazebot.navigation.behavior.nodes.nodes_action import ACTION_PORTS, ActionNode
from mazebot.navigation.control.collision import STOP
from mazebot.navigation.errors import NavigationError

_LOG = logging.getLogger("navigation")
RUNNING, SUCCESS = NodeStatus.RUNNING, NodeStatus.SUCCESS
_ALLOWANCE = Port("time_allowance", "number", "10.0")
_UNCHECKED = Port("disable_collision_checks", "flag", "false")
_STAGING_SHARES = (1.0, 0.85, 0.7, 0.6, LEAST_STAGING_SHARE)


class MotionNode(ActionNode):
    """Steps a behaviour."""

    _motion: Motion | None = None

    def _begin(self, now_ns: int) -> None:
        self._motion = self._make()
        self.place.run.running_motion = self._motion

    def _on_running(self, now_ns: int) -> NodeStatus:
        assert self._motion is not None
        run = self.place.run
        step = self._motion.step(
            now_ns,
            run.control_period_s,
            self.context.odom_from_base(),
            self.context.velocity(),
            self.context.time_to_collision,
            self.context.obstacle,
        )
        if step.done:
            self._cancel()
            return SUCCESS
        run.drive(self, step.velocity)
        return RUNNING

    def _fail(self, code: int, message: str) -> None:
        super()._fail(code, message + self.where())

    def _cancel(self) -> None:
        run = self.place.run
        if run.running_motion is self._motion:
            run.running_motion = None
        self._motion = None
        run.drive(self, STOP)

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
        seconds = self.number("wait_duration")
        if seconds < 0.0:
            _LOG.warning("%s: wait_duration is %g: waits for %g s", self, seconds, -seconds)
        return Wait(abs(seconds))


class AssistedTeleopNode(MotionNode):
    """AssistedTeleop."""

    action = "AssistedTeleop"
    ports = (_ALLOWANCE, Port("is_recovery", "flag", "false"), *ACTION_PORTS)

    def _make(self) -> Motion:
        return AssistedTeleop(self.place.run.behaviors, self.number("time_allowance"))

    def _on_running(self, now_ns: int) -> NodeStatus:
        assert isinstance(self._motion, AssistedTeleop)
        self._motion.ask(self.context.teleop())
        return super()._on_running(now_ns)


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
    _dock: Dock
    _docking: DockingParams
    """With as much room before the dock as there is."""
    _began_ns = 0
    _way: Errand | None = None
    """To the staging pose"""
    _expected: Expected | None = None

    def _begin(self, now_ns: int) -> None:
        self._began_ns, self._way, self._docker = now_ns, None, None
        self._expected = None
        self.put("success", False)
        self.put("num_retries", 0)
        self.place.run.docking_step = None
        self._dock = self._chosen()
        self._docking = self._with_room(self._dock.map_from_dock)

    def _chosen(self) -> Dock:
        if self.flag("use_dock_id"):
            return self.context.dock(self.text("dock_id"))
        pose = self.pose("dock_pose")
        if pose is None:
            raise TreeError(f"{self}, port 'dock_pose': no pose on the blackboard")
        return self.context.dock_at(pose)

    def _with_room(self, map_from_dock: SE2) -> DockingParams:
        """Docking from the farthest staging pose to which there is a way.

        Raises NavigationError where the robot cannot stand in the dock or before it.
        """
        context, docking = self.context, self.place.run.docking
        try:
            context.check_goals((map_from_dock,))
        except NavigationError as error:
            raise NavigationError(
                ErrorCode.DOCK_NOT_VALID,
                f"the robot cannot stand in the dock of marker {self._dock.marker_id}: "
                f"{error.message}",
                error.place_m,
            ) from None
        reason = ""
        for share in _STAGING_SHARES:
            shorter_m = share * docking.staging_x_offset
            nearer = docking.model_copy(update={"staging_x_offset": shorter_m})
            try:
                context.check_goals((staging_pose(nearer, map_from_dock),))
            except NavigationError as error:
                reason = reason or error.message
            else:
                return nearer
        raise NavigationError(
            ErrorCode.FAILED_TO_STAGE,
            f"no room before the dock of marker {self._dock.marker_id}: {reason}",
        )

    def _on_running(self, now_ns: int) -> NodeStatus:
        run, context = self.place.run, self.context
        if self._docker is None and not self._is_staged(now_ns):
            run.docking_step = DockingStep(DockState.NAV_TO_STAGING_POSE, STOP, 0, False)
            return RUNNING
        odom_from_base = context.odom_from_base()
        if self._docker is None:
            odom_from_map = odom_from_base @ context.pose().inverse()
            self._docker = Docker(
                self._docking,
                self._dock,
                odom_from_map @ self._dock.map_from_dock,
            )
        step = self._docker.step(
            now_ns,
            run.control_period_s,
            odom_from_base,
            self._sightings(now_ns),
            context.time_to_collision,
            self._marker_expected(odom_from_base),
        )
        run.docking_step = step
        self.put("num_retries", step.num_retries)
        if step.done:
            run.drive(self, STOP)
            self.put("success", True)
            return SUCCESS
        run.drive(self, step.velocity)
        return RUNNING

    def _sightings(self, now_ns: int) -> tuple[MarkerPose, ...]:
        """Those of the marker, with stamps by the task's clock, so that their ages hold."""
        behind_ns = self.context.time_ns() - now_ns
        return tuple(
            replace(one, stamp_ns=one.stamp_ns - behind_ns)
            for one in self.context.sightings(self._dock.marker_id)
        )

    def _marker_expected(self, odom_from_base: SE2) -> Expected | None:
        """Where the marker should be, by the last pose that was known."""
        context = self.context
        if context.is_localized():
            odom_from_map = odom_from_base @ context.pose().inverse()
            self._expected = Expected(
                odom_from_map @ self._dock.map_from_marker, *context.pose_std()
            )
        return self._expected

    def _is_staged(self, now_ns: int) -> bool:
        """Whether docking can begin; drives to the staging pose until then."""
        context, docking = self.context, self._docking
        staging = staging_pose(docking, self._dock.map_from_dock)
        near = context.pose().distance_m(staging) <= docking.dock_prestaging_tolerance
        if self._way is None and (near or not self.flag("navigate_to_staging_pose")):
            return True
        if (now_ns - self._began_ns) * 1e-9 > self.number("max_staging_time"):
            raise NavigationError(
                ErrorCode.FAILED_TO_STAGE,
                f"failed to reach the staging pose within {self.number('max_staging_time'):.0f} s",
            )
        if self._way is None:
            run = self.place.run
            if run.navigate is None:
                raise TreeError(f"{self}: no navigator to drive to the staging pose")
            self._way = run.navigate(staging, run.actions)
        ending = self._way.step(now_ns)
        if ending is None:
            return False
        self._leave_way()
        if ending.code != ErrorCode.NONE:
            raise NavigationError(
                ErrorCode.FAILED_TO_STAGE, f"failed to reach the staging pose: {ending.message}"
            )
        return True

    def _leave_way(self) -> None:
        if self._way is not None:
            self._way.halt()
        self._way = None
        self.place.run.drive(self, STOP)

    def _cancel(self) -> None:
        run = self.place.run
        if run.docking_step is not None:
            # The result tells how often it was tried.
            run.docking_step = replace(run.docking_step, state=DockState.NONE, velocity=STOP)
        self._docker = None
        self._leave_way()


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

    def _on_running(self, now_ns: int) -> NodeStatus:
        assert self._undocker is not None
        run = self.place.run
        step = self._undocker.step(
            now_ns,
            run.control_period_s,
            self.context.odom_from_base(),
            self.context.time_to_collision,
        )
        if step.done:
            run.drive(self, STOP)
            self.put("success", True)
            return SUCCESS
        run.drive(self, step.velocity)
        return RUNNING

    def _cancel(self) -> None:
        self._undocker = None
        self.place.run.drive(self, STOP)

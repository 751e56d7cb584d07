"""The controller server: follows a path by a controller, and notices where it cannot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from pydantic import Field

from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.context import FollowRequest, TrackingFeedback
from mazebot.navigation.behavior.nodes.path_parts import begin_index, piece
from mazebot.navigation.control.collision import Surroundings, Velocity
from mazebot.navigation.control.controller import (
    Control,
    Controller,
    ControllerParams,
    RobotLimits,
    TakesOver,
)
from mazebot.navigation.control.mppi.critic_params import MPPIParams
from mazebot.navigation.control.regulated_pure_pursuit import RegulatedPurePursuitParams
from mazebot.navigation.control.safety.progress_checker import ProgressChecker, ProgressParams
from mazebot.navigation.control.safety.stuck_detector import StuckDetector, StuckDetectorParams
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.path import PlannedPath
from mazebot.navigation.robot.view import View

_NAV2_DEFAULTS = ("", "FollowPath")
"""What Nav2's trees and parameter files call their controller: here, the configured one."""
_SEARCH_M = 1.0
"""The nearest point of the path is looked for within this length of it from the last one, as by
Nav2's max_robot_pose_search_dist.
"""
_GIVES_WAY_M = 1.2
_GIVES_WAY_M_S = 0.1
_GIVES_WAY_NS = 15_000_000_000
"""For so long since its last progress a robot may stand, or drive slowly, with a moving obstacle
this near.
"""

_SLOWEST_SHARE = 0.2
"""A robot that drives at this share of its highest speed makes progress."""
_JUDGED = 2.0
"""The stuck detector compares motion over so many times as long as the motion takes at least."""
_DOUBTED_NS = 5_000_000_000
"""After so long, a pose that scans contradict has been compared with all others, and kept."""


class ControllerServerParams(RobotLimits):
    """The controllers, and when one of them has failed."""

    controller: str = Field(
        "mppi",
        description="mppi, regulated_pure_pursuit, my_package.my_module:MyController or "
        "FILE.py:MyController",
    )
    mppi: MPPIParams = MPPIParams()
    regulated_pure_pursuit: RegulatedPurePursuitParams = RegulatedPurePursuitParams()
    controller_params: dict[str, object] = Field(
        default_factory=dict, description="parameters of a controller of your own"
    )
    failure_tolerance: float = Field(
        0.3,
        ge=0,
        description="s; how long the controller may find no valid command before a recovery begins",
    )
    goal_checker_plugins: tuple[str, ...] = Field(
        ("general_goal_checker", "goal_checker"),
        description="names that FollowPath may give in goal_checker_id; all are the one that there "
        "is",
    )
    progress_checker_plugins: tuple[str, ...] = Field(
        ("progress_checker",), description="names that FollowPath may give in progress_checker_id"
    )
    path_handler_plugins: tuple[str, ...] = Field(
        ("PathHandler", "path_handler"),
        description="names that FollowPath may give in path_handler_id",
    )
    progress_checker: ProgressParams = ProgressParams()
    stuck_detector: StuckDetectorParams = StuckDetectorParams()
    sensor_timeout: float = Field(
        0.5, gt=0, description="s; the robot stops if odometry or the scan is older than this"
    )
    slowdown_ratio: float = Field(
        0.5, gt=0, le=1, description="factor of max_linear_vel while the depth camera is silent"
    )

    def params_of(self, name: str) -> ControllerParams | dict[str, object]:
        """Parameters of the controller of a name."""
        built_in: dict[str, ControllerParams] = {
            "mppi": self.mppi, "regulated_pure_pursuit": self.regulated_pure_pursuit
        }  # fmt: skip
        return built_in.get(name, self.controller_params)

    def limits(self) -> RobotLimits:
        """What every controller keeps to."""
        return RobotLimits(**{name: getattr(self, name) for name in RobotLimits.model_fields})


class ControllerServer:
    """Runs one of the controllers along a path."""

    def __init__(
        self,
        params: ControllerServerParams,
        controllers: Mapping[str, Controller],
        control_period_s: float,
    ) -> None:
        self.control_period_s = control_period_s
        self.params = params
        self.controllers = controllers
        self.controller = controllers[params.controller]
        """The one that was used last."""
        self._asked_for = ""
        """Its name, as it was asked for."""
        self.followed: PlannedPath | None = None
        self.nearest = 0
        """Index of the point of that path nearest to the robot."""
        self._patience = _patience(params)
        self._progress, self._stuck = _checkers(params, self._patience)
        self._made: Velocity | None = None
        """The last command,"""
        self._sent: Velocity | None = None
        """and what was sent of it; None: that is not known."""
        self._let_through = 1.0
        """The share of its speeds that zones of the collision monitor leave."""
        self._blocked_since_ns: int | None = None
        self._controlled_ns = 0
        self._doubted_since_ns: int | None = None
        self.stuck_towards: Velocity | None = None
        """The command that did not move the robot, until somebody takes it."""

    def follow(self, request: FollowRequest, pose: SE2) -> bool:
        """Follow a path from the robot's pose on; whether it is a new one.

        Raises NavigationError with INVALID_CONTROLLER.
        """
        self._check_plugins(request)
        controller, followed = self._named(request.controller_id), self.followed
        continues = (
            controller is self.controller
            and controller.path is not None
            and followed is not None
            and followed.goal == request.path.goal
        )
        last = None
        if controller is not self.controller:
            last = self.controller.velocity
            self.controller.stop()
        if not continues:
            self._forget()
        is_new = followed is not request.path or not continues
        self.controller, self._asked_for = controller, request.controller_id
        self.followed = request.path
        # A path that is kept began further back.
        if continues and followed is request.path:
            first = request.path.nearest(pose.x_m, pose.y_m, self.nearest, _SEARCH_M)
        else:
            first = begin_index(request.path, pose)
        self.nearest = first
        rest = piece(request.path, first, len(request.path.points_m))
        controller.set_path(rest, same_goal=continues)
        if last is not None and isinstance(controller, TakesOver):
            controller.take_over(last)
        return is_new

    def check_name(self, controller_id: str) -> None:
        """Raise NavigationError with INVALID_CONTROLLER where no controller has this name."""
        self._named(controller_id)

    def _check_plugins(self, request: FollowRequest) -> None:
        params = self.params
        for what, name, known in (
            ("goal checker", request.goal_checker_id, params.goal_checker_plugins),
            ("progress checker", request.progress_checker_id, params.progress_checker_plugins),
            ("path handler", request.path_handler_id, params.path_handler_plugins),
        ):
            if name and name not in known:
                raise NavigationError(
                    ErrorCode.INVALID_CONTROLLER,
                    f"{what} {name!r:.60}: must be empty or one of {', '.join(known)}",
                )

    def _named(self, controller_id: str) -> Controller:
        name = self.params.controller if controller_id in _NAV2_DEFAULTS else controller_id
        if name not in self.controllers:
            raise NavigationError(
                ErrorCode.INVALID_CONTROLLER,
                f"controller {name!r:.60}: must be one of {', '.join(sorted(self.controllers))}",
            )
        return self.controllers[name]

    def control(self, now_ns: int, view: View, around: Surroundings) -> Control:
        """The next velocity along the path.

        Raises NavigationError with a code of FollowPath (100s).
        """
        if self.followed is None:
            raise NavigationError(ErrorCode.INVALID_PATH, "no path to follow: it was dropped")
        params, pose = self.params, around.map_from_base
        elapsed_s = (view.now_ns - self._controlled_ns) * 1e-9
        # A late step is followed by one in time: less than a period after it.
        if not 0.0 < elapsed_s < self.control_period_s:
            elapsed_s = self.control_period_s
        self._controlled_ns = view.now_ns
        made = self.controller.step(elapsed_s, around)
        if self._is_doubted(now_ns, view.is_suspect) and made.reached:
            made = replace(made, reached=False)
            self._progress.reset()
        where = f"at ({pose.x_m:.2f}, {pose.y_m:.2f})"
        waits = _gives_way(view, made.velocity) and self._progress.excuse(now_ns, _GIVES_WAY_NS)
        if waits or not made.blocked:
            self._blocked_since_ns = None
        elif self._blocked_since_ns is None:
            self._blocked_since_ns = now_ns
        elif now_ns - self._blocked_since_ns > params.failure_tolerance * 1e9:
            raise NavigationError(
                ErrorCode.NO_VALID_CONTROL, f"every motion along the path collides {where}"
            )
        patience = _patience(params, around.speed_limit_m_s, self._let_through)
        allowance_s = patience.progress_s
        if not self._progress.makes_progress(now_ns, pose, self._patience.progress_s / allowance_s):
            raise NavigationError(
                ErrorCode.FAILED_TO_MAKE_PROGRESS, f"no progress for {allowance_s:.1f} s {where}"
            )
        if not view.is_heard:
            # That it does not move then says nothing of what is around it.
            self._stuck.reset()
        # What changed the last command changes this one.
        sent = self._sent
        driven = made.velocity if sent is None or sent == self._made else sent
        self._made = made.velocity
        stuck = self._stuck.update(now_ns, driven, view.odom_from_base, pose, patience.stuck_s)
        if stuck is not None:
            self._stuck.reset()
            self.stuck_towards = driven
            raise NavigationError(ErrorCode.FAILED_TO_MAKE_PROGRESS, f"{stuck.text} {where}")
        return made

    def take_sent(self, sent: Velocity, let_through: float) -> None:
        """Take what the velocity smoother and the collision monitor made of the last command;
        `let_through`: the share of its speeds that the monitor's zones for slower driving leave.
        """
        self._sent, self._let_through = sent, let_through

    def tracking(self, made: Control, pose: SE2) -> TrackingFeedback:
        """How the robot follows the path, with what the controller made there."""
        path = self.followed
        if path is None:
            return TrackingFeedback(made.reached, made.distance_remaining_m)
        self.nearest = path.nearest(pose.x_m, pose.y_m, self.nearest, _SEARCH_M)
        return TrackingFeedback(
            made.reached,
            made.distance_remaining_m,
            path.foot(self.nearest, pose.x_m, pose.y_m).off_m,
            wrap_angle(float(path.yaws_rad[self.nearest]) - pose.yaw_rad),
            self.nearest,
        )

    def reconfigure(
        self, params: ControllerServerParams, controllers: Mapping[str, Controller]
    ) -> None:
        """Go on along the same path with other parameters, and controllers made by them: those that
        are the same go on as they are.
        """
        before, default = self.controller, controllers[params.controller]
        asked_for = self._asked_for
        controller = default if asked_for in _NAV2_DEFAULTS else controllers.get(asked_for, default)
        if controller is not before and before.path is not None:
            controller.set_path(before.path, same_goal=False)
            if isinstance(controller, TakesOver):
                controller.take_over(before.velocity, before.index, before.xy_reached)
            before.stop()
        patience, was = _patience(params), self._patience
        progress, stuck = _checkers(params, patience)
        if (params.progress_checker, patience.progress_s) != (
            self.params.progress_checker, was.progress_s
        ):  # fmt: skip
            self._progress = progress
        if (params.stuck_detector, patience.stuck_s) != (self.params.stuck_detector, was.stuck_s):
            self._stuck = stuck
        self._patience = patience
        self.params, self.controllers, self.controller = params, controllers, controller

    def interrupt(self) -> None:
        """The robot does something else in this period: that is no failure of the controller."""
        self._forget()

    def _forget(self) -> None:
        """Judge anew whether the robot follows its path."""
        self._progress.reset()
        self._stuck.reset()
        self._blocked_since_ns = None
        self._sent, self._let_through = None, 1.0

    def _is_doubted(self, now_ns: int, is_suspect: bool) -> bool:
        """Whether the robot may be elsewhere than it believes, and that is soon decided."""
        if not is_suspect:
            self._doubted_since_ns = None
            return False
        if self._doubted_since_ns is None:
            self._doubted_since_ns = now_ns
        return now_ns - self._doubted_since_ns <= _DOUBTED_NS

    def stop(self) -> None:
        """Drop the path."""
        self.controller.stop()
        self.followed = None
        self._blocked_since_ns = None


class _Patience(NamedTuple):
    """How long the two checkers wait: longer where the robot is too slow for their parameters."""

    progress_s: float
    stuck_s: float


def _patience(
    params: ControllerServerParams, limit_m_s: float = math.inf, share: float = 1.0
) -> _Patience:
    """Below a speed limit, and with a share of the speeds that are then possible."""
    progress, stuck = params.progress_checker, params.stuck_detector
    progress_s = params.shortest_s(
        progress.required_movement_radius, progress.required_movement_angle, limit_m_s, share
    )
    progress_s /= _SLOWEST_SHARE
    stuck_s = _JUDGED * params.shortest_s(
        stuck.required_distance, stuck.required_angle, limit_m_s, share
    )
    return _Patience(
        max(progress.movement_time_allowance, progress_s), max(stuck.time_allowance, stuck_s)
    )


def _checkers(
    params: ControllerServerParams, patience: _Patience
) -> tuple[ProgressChecker, StuckDetector]:
    allowed = {"movement_time_allowance": patience.progress_s}
    compared = {"time_allowance": patience.stuck_s}
    return (
        ProgressChecker(params.progress_checker.model_copy(update=allowed)),
        StuckDetector(params.stuck_detector.model_copy(update=compared)),
    )


def _gives_way(view: View, velocity: Velocity) -> bool:
    """Whether the robot stands because something that moves is near: for a while, that is no
    failure.
    """
    pose = view.map_from_base
    return (
        abs(velocity.linear_m_s) <= _GIVES_WAY_M_S
        and pose is not None
        and any(
            math.hypot(each.x_m - pose.x_m, each.y_m - pose.y_m) < _GIVES_WAY_M
            for each in (*view.tracks, *view.turning)
        )
    )

"""The newest measurements of the robot, and its pose in the map by them."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.odometry_history import OdometryHistory
from mazebot.common.messages.documents import LocalizationStatus
from mazebot.common.messages.scan import Scan
from mazebot.common.messages.topics import AMCL_POSE, ODOM, SCAN
from mazebot.common.robot.frozen_scans import FrozenScans
from mazebot.navigation.behavior.context import BatteryCharge
from mazebot.navigation.control.collision import STOP, Velocity, stands
from mazebot.navigation.control.safety.collision_monitor import moved_points
from mazebot.navigation.control.tracking import ObstacleTracker
from mazebot.navigation.costmap.layered_costmap import scan_points
from mazebot.navigation.costmap.obstacle_layer import denoised_ranges
from mazebot.navigation.robot.view import View

_SCANS_KEPT = 3
"""A depth image's scan comes one or two of the lidar's after that of its time."""
_TELEOP_NS = 300_000_000
"""A teleoperation command is valid for this long."""
_STARTED_M, _STARTED_RAD = 0.02, 0.05
"""A robot that stood and has moved by more than this obeys again."""
_STATIC_MARGIN_M = 0.05
_SIGMAS = 3.0
"""An echo is a wall's within a cell of it and so many standard deviations of the pose."""
_SILENT_PERIODS = 3.0
"""A camera that has sent none of so many pictures is silent,"""
_SILENT_S = 1.0
"""and after this long at least: recognition may take its time."""
_JUMP_M, _JUMP_RAD = 0.3, 0.3
"""A correction of the pose by more than this is a jump."""
_SLIP_M, _SLIP_RAD = 0.05, 0.05
"""A slip of the wheels by more than this has moved odometry's frame: a cell of the costmap."""
_SLIP_NS = 1_000_000_000
"""So long after the wheels hold again, corrections are still of the slip."""


class Echoes(NamedTuple):
    """The newest scan's echoes, with the odometry at that scan."""

    stamp_ns: int
    odom_from_base: SE2
    base_points_m: Array


class Measurements:
    """The newest of each sensor, and of localization."""

    def __init__(self) -> None:
        self.localization: LocalizationStatus | None = None
        self.emergency_stop = ""
        """Why the robot is held at rest until a person clears it; empty: it is not."""
        self.clear()

    def clear(self) -> None:
        """Drop everything but the state of localization and the emergency stop."""
        self.odom: tuple[int, SE2] | None = None
        self.odometry = OdometryHistory()
        self.velocity = STOP
        self.battery: BatteryCharge | None = None
        self.map_from_odom: tuple[int, SE2] | None = None
        """The newest correction of odometry, with its stamp."""
        self._before_slip: SE2 | None = None
        """The last one before the slip that odometry was not yet corrected of."""
        self._slip_ns: int | None = None
        """When the wheels last slipped."""
        self.echoes: Echoes | None = None
        self._frozen, self._frozen_depth = FrozenScans(), FrozenScans()
        self._scans: deque[tuple[Scan, SE2]] = deque(maxlen=_SCANS_KEPT)
        self._pose_std_m: float | None = None
        self._pose_std_rad = math.inf
        """Of the pose in the map, along the axis of which less is known."""
        self._teleop: tuple[int, Velocity] | None = None
        self._watchdog_stops: int | None = None
        self.is_heard = True
        """Whether commands reach the robot in time, as far as is known."""
        self._stood: SE2 | None = None
        """In odom, where it stood when it heard none."""
        self.sources: dict[str, str] = {}
        """Who sends odometry, the state of localization and the scan: message sources by topic."""
        self.lost: tuple[str, ...] = ()
        """The topics of these whose source is gone: nothing new will come of it."""
        self._depth_ns: int | None = None
        """Stamp of the newest scan of the depth camera."""
        self._depth_period_ns = 0

    def take_localization(self, status: LocalizationStatus) -> bool:
        """Take the state of localization; whether a pose was found where it was sought before."""
        before, self.localization = self.localization, status
        return before is not None and before.wants_motion and status.state == "localized"

    def is_frozen(self, scan: Scan, is_depth: bool = False) -> bool:
        """Whether a scan, of the lidar or of the depth camera, is an earlier one again, and not
        what is there; once odometry is known.
        """
        assert self.odom is not None
        frozen = self._frozen_depth if is_depth else self._frozen
        return frozen.is_frozen(scan, self.odom[1])

    def does_scan_repeat(self, now_ns: int, timeout_s: float) -> bool:
        """Whether the lidar still sends scans, of an earlier turn."""
        frozen_ns = self._frozen.frozen_ns
        return frozen_ns is not None and now_ns - frozen_ns <= timeout_s * 1e9

    def take_scan(self, scan: Scan) -> None:
        """Keep a scan's echoes, once odometry is known."""
        assert self.odom is not None
        points_m = scan_points(replace(scan, ranges_m=denoised_ranges(scan.ranges_m)))
        self.echoes = Echoes(scan.stamp_ns, self.odom[1], points_m)
        self._scans.append((scan, self.odom[1]))

    def take_depth(self, stamp_ns: int) -> None:
        """Note that a scan of the depth camera has come."""
        if self._depth_ns is not None:
            self._depth_period_ns = stamp_ns - self._depth_ns
        self._depth_ns = stamp_ns

    def is_depth_silent(self, now_ns: int) -> bool:
        """Whether the depth camera, which was there, shows nothing new any more."""
        return self._depth_ns is not None and now_ns - self._depth_ns > self._depth_patience_ns

    def does_depth_repeat(self, now_ns: int) -> bool:
        """Whether the depth camera still sends pictures, that show what an earlier one did."""
        frozen_ns = self._frozen_depth.frozen_ns
        return frozen_ns is not None and now_ns - frozen_ns <= self._depth_patience_ns

    @property
    def _depth_patience_ns(self) -> float:
        return max(_SILENT_S * 1e9, _SILENT_PERIODS * self._depth_period_ns)

    def take_teleop(self, now_ns: int, command: Velocity) -> None:
        """Keep a teleoperation command."""
        self._teleop = (now_ns, command)

    def take_watchdog_stops(self, stops: int) -> bool:
        """Take how often the robot has stopped because no command came in time; whether it has
        again.
        """
        again = self._watchdog_stops is not None and stops > self._watchdog_stops
        self._watchdog_stops = stops
        if again:
            self.is_heard, self._stood = False, None
        return again

    def take_odometry(self, stamp_ns: int, odom_from_base: SE2, velocity: Velocity) -> None:
        """Take where the wheels say that the robot is. One that starts again hears commands."""
        self.odom = (stamp_ns, odom_from_base)
        self.odometry.add(stamp_ns, odom_from_base)
        self.velocity = velocity
        if self.is_heard:
            return
        if self._stood is not None:
            self.is_heard = not odom_from_base.is_near(self._stood, _STARTED_M, _STARTED_RAD)
        elif stands(velocity):
            self._stood = odom_from_base

    def take_covariance(self, covariance: Array) -> None:
        """Keep how well the pose is known, from the (36,) covariance of /amcl_pose."""
        self._pose_std_m = math.sqrt(max(covariance[0], covariance[7], 0.0))
        self._pose_std_rad = math.sqrt(max(covariance[35], 0.0))

    def correct(self, stamp_ns: int, map_from_odom: SE2) -> bool:
        """Take a correction of odometry; whether the pose in the map jumps by it."""
        before = self.map_from_odom
        self.map_from_odom = (stamp_ns, map_from_odom)
        status = self.localization
        if status is not None and status.wheel_slip:
            self._slip_ns = stamp_ns
        slipped = self._slip_ns is not None and stamp_ns - self._slip_ns <= _SLIP_NS
        if not slipped or before is None:
            self._before_slip = None
        elif self._before_slip is None:
            self._before_slip = before[1]
        if before is None or self.odom is None:
            return False
        old, new = (one @ self.odom[1] for one in (before[1], map_from_odom))
        return not new.is_near(old, _JUMP_M, _JUMP_RAD)

    def odom_slipped(self, epoch: int | None) -> SE2 | None:
        """Where odometry has what it had at a place before the wheels slipped, odom_from_before;
        None: they have not, or no more than was told.
        """
        before, now = self._before_slip, self.map_from_odom
        if before is None or now is None or self.odom is None or not self.is_localized(epoch):
            return None
        old, new = before @ self.odom[1], now[1] @ self.odom[1]
        if new.is_near(old, _SLIP_M, _SLIP_RAD):
            return None
        self._before_slip = now[1]
        return now[1].inverse() @ before

    def map_from_base(self) -> SE2:
        """The robot's pose, once odometry and its correction are known."""
        assert self.map_from_odom is not None
        assert self.odom is not None
        return self.map_from_odom[1] @ self.odom[1]

    def is_localized(self, epoch: int | None) -> bool:
        """Whether the pose is known and can be trusted in this epoch of the simulation."""
        status = self.localization
        return (
            status is not None
            and status.state == "localized"
            and status.epoch == epoch
            and self.map_from_odom is not None
            and self.odom is not None
            and self.echoes is not None
        )

    def wants_motion(self, epoch: int | None) -> bool:
        """Whether localization needs the robot to move."""
        status = self.localization
        return status is not None and status.wants_motion and status.epoch == epoch

    def wheels_slip(self, epoch: int | None) -> bool:
        """Whether the wheels turn and the robot does not move as they say."""
        status = self.localization
        return status is not None and status.wheel_slip and status.epoch == epoch

    def is_suspect(self, epoch: int | None) -> bool:
        """Whether scans contradict the pose, and it may turn out wrong."""
        status = self.localization
        return status is not None and status.suspect and status.epoch == epoch

    def is_searching(self) -> bool:
        """Whether a global localization was requested: the robot moves without a goal."""
        return self.localization is not None and self.localization.state == "searching"

    def is_blind(self, now_ns: int, timeout_s: float) -> bool:
        """Whether odometry, its correction or the scan is too old, or comes no more."""
        return bool(self.lost) or bool(self.too_old(now_ns, timeout_s))

    def too_old(self, now_ns: int, timeout_s: float) -> tuple[str, ...]:
        """The topics of odometry, its correction and the scan whose newest message is too old."""
        assert self.odom is not None
        oldest_ns = now_ns - timeout_s * 1e9
        # What is not known yet has no age.
        stamps_ns = (
            (ODOM.name, self.odom[0]),
            (SCAN.name, now_ns if self.echoes is None else self.echoes.stamp_ns),
            (AMCL_POSE.name, now_ns if self.map_from_odom is None else self.map_from_odom[0]),
        )
        return tuple(topic for topic, stamp_ns in stamps_ns if stamp_ns < oldest_ns)

    def static_margin_m(self, most_m: float) -> float:
        """How near to a wall of the map an echo is taken for the wall's: by the pose's error."""
        if self._pose_std_m is None:
            return most_m
        return min(_STATIC_MARGIN_M + _SIGMAS * self._pose_std_m, most_m)

    def scan_at(self, stamp_ns: int) -> tuple[Scan, SE2] | None:
        """The scan nearest to a time, with the odometry at it; None: there is none."""
        return min(self._scans, key=lambda one: abs(one[0].stamp_ns - stamp_ns), default=None)

    def view(
        self, now_ns: int, epoch: int | None, tracker: ObstacleTracker, hidden_m: Array
    ) -> View:
        """What the robot knows at this step, once odometry is known.

        Args:
            now_ns: the time of the step.
            epoch: of the simulation.
            tracker: of moving obstacles.
            hidden_m: (n, 2) points in the current base frame on what the lidar does not show.
        """
        assert self.odom is not None
        teleop, echoes_m = self._teleop, self._echoes_now()
        return View(
            now_ns,
            self.map_from_base() if self.is_localized(epoch) else None,
            self.odom[1],
            self.velocity,
            np.concatenate([echoes_m, hidden_m]) if len(hidden_m) else echoes_m,
            tracker.moving(now_ns * 1e-9),
            teleop[1] if teleop and now_ns - teleop[0] <= _TELEOP_NS else None,
            tracker.turning(),
            len(hidden_m),
            self.is_heard,
            self.battery,
            self.is_suspect(epoch),
            self.is_depth_silent(now_ns),
            (math.inf if self._pose_std_m is None else self._pose_std_m, self._pose_std_rad),
        )

    def _echoes_now(self) -> Array:
        """(n, 2) the newest echoes in the current base frame."""
        assert self.odom is not None
        echoes = self.echoes
        if echoes is None:
            return np.empty((0, 2))
        return moved_points(echoes.base_points_m, echoes.odom_from_base, self.odom[1])

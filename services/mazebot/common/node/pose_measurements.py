"""What localization and mapping share of taking measurements: odometry without what slipping wheels
add, scans that are none, and the status that tells of both.
"""

from __future__ import annotations

import logging
from typing import Protocol

from mazebot.common.maths.frames import SE2
from mazebot.common.maths.odometry_history import NO_ODOMETRY
from mazebot.common.messages.documents import LocalizationStatus
from mazebot.common.messages.scan import Scan
from mazebot.common.node.schedule import Schedule
from mazebot.common.robot.frozen_scans import FROZEN, FrozenScans
from mazebot.common.robot.wheel_slip import SlipLog, WheelSlip

_STATUS_PERIOD_NS = 500_000_000


class PoseEstimator(Protocol):
    """What estimates the pose: by corrected odometry and by scans, each in the order of time."""

    def odometry(self, stamp_ns: int, odom_from_base: SE2) -> None:
        """Take in odometry."""

    def has_odometry(self, stamp_ns: int) -> bool:
        """Whether there is odometry at that time."""

    def correct_odometry(self, odom_from_base: SE2) -> None:
        """Replace the latest odometry."""

    def scan(self, scan: Scan) -> object:
        """Take in a scan."""

    def map_from_odom(self) -> SE2:
        """The correction of corrected odometry."""


class PoseMeasurements:
    """The odometry and the scans of a run, as far as they are to be believed."""

    def __init__(self) -> None:
        self.odom: tuple[int, SE2] | None = None
        """The latest odometry as the wheels say: stamp in ns and odom_from_base."""
        self.scanned = False
        """Whether a scan was used."""
        self._slip, self._frozen = WheelSlip(), FrozenScans()

    @property
    def slips(self) -> bool:
        """Whether the wheels slip."""
        return self._slip.slips

    def note_odometry(self, stamp_ns: int, odom_from_base: SE2) -> SE2:
        """Take in odometry; the same, corrected."""
        self.odom = (stamp_ns, odom_from_base)
        return self._slip.odometry(stamp_ns, odom_from_base)

    def add_scan(self, scan: Scan, estimator: PoseEstimator) -> str:
        """Let an estimate take in a scan, and what it tells of slipping wheels; why it does not:
        empty if it does. There must be odometry.
        """
        assert self.odom is not None
        if not estimator.has_odometry(scan.stamp_ns):
            return NO_ODOMETRY
        if self._frozen.is_frozen(scan, self.odom[1]):
            return FROZEN
        if self._slip.scan(scan):
            estimator.correct_odometry(self._slip.corrected)
        estimator.scan(scan)
        self.scanned = True
        return ""

    def map_from_odom(self, estimator: PoseEstimator) -> SE2:
        """The correction of what the wheels say."""
        return self._slip.with_odom(estimator.map_from_odom())


class StatusReports:
    """When /localization/status is due: every half second, and as soon as one of the values changes
    that others wait for. Logs the state and slipping wheels as they change.
    """

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._slip_log = SlipLog(logger)
        self._schedule = Schedule()
        self._state = ""
        self._told: tuple[object, ...] | None = None

    def restart(self) -> None:
        """Let the next one be due at once: the simulation begins anew."""
        self._schedule.clear()

    def is_due(self, now_ns: int, status: LocalizationStatus) -> bool:
        """Whether this one is; it counts as published then. To be called on every step, so that the
        period counts from the last one.
        """
        due = self._schedule.is_due("status", now_ns, _STATUS_PERIOD_NS)
        self._slip_log.update(now_ns, status.wheel_slip)
        told = status.state, status.epoch, status.wheel_slip, status.suspect
        if not due and told == self._told:
            return False
        self._told = told
        if self._state != status.state:
            self._state = status.state
            level = logging.WARNING if status.state == "lost" else logging.INFO
            reason = f": {status.reason}" if status.reason else ""
            self._logger.log(level, "%s%s", status.state, reason)
        return True

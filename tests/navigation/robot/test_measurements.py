"""Whether commands reach the robot, and where its wheels have slipped to, as far as navigation can
know.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import LocalizationStatus
from mazebot.common.messages.scan import Scan
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.robot.measurements import Measurements

DRIVES = Velocity(0.4, 0.0)
NO_ECHO = Scan(
    np.full(360, np.inf, np.float32), 0.0, math.radians(1.0), 0.1, 3.5, SE2(0.0, 0.0, 0.0), 1
)


def test_commands_are_heard_again_once_the_robot_starts_after_it_stood() -> None:
    measured = Measurements()
    # How often it has stopped before is nobody's concern.
    assert not measured.take_watchdog_stops(5)
    measured.take_odometry(1, SE2(0.0, 0.0, 0.0), DRIVES)
    assert measured.is_heard
    assert measured.take_watchdog_stops(6)
    # It rolls on to where it stands.
    for number, (x_m, velocity) in enumerate([(0.05, DRIVES), (0.1, DRIVES), (0.12, STOP)]):
        measured.take_odometry(2 + number, SE2(x_m, 0.0, 0.0), velocity)
        assert not measured.is_heard
    assert not measured.take_watchdog_stops(6)
    measured.take_odometry(9, SE2(0.13, 0.0, 0.0), STOP)
    assert not measured.is_heard
    measured.take_odometry(10, SE2(0.15, 0.0, 0.0), DRIVES)
    assert measured.is_heard


def test_a_turn_is_a_start_too_and_another_stop_counts_anew() -> None:
    measured = Measurements()
    measured.take_watchdog_stops(0)
    measured.take_watchdog_stops(1)
    measured.take_odometry(1, SE2(1.0, 2.0, 3.13), STOP)
    measured.take_odometry(2, SE2(1.0, 2.0, -3.08), Velocity(0.0, 1.0))
    assert measured.is_heard
    measured.take_watchdog_stops(2)
    assert not measured.is_heard
    measured.clear()
    assert measured.is_heard


def slipping(measured: Measurements, number: int, slips: bool, x_m: float) -> SE2 | None:
    """What is told of a slip after the status and the correction of a tenth of a second."""
    status = LocalizationStatus(state="localized", quality=1.0, wheel_slip=slips, epoch=3)
    measured.take_localization(status)
    measured.correct(number * 100_000_000, SE2(x_m, 0.0, 0.0))
    return measured.odom_slipped(3)


def test_a_slip_is_told_once_it_is_a_cell_long() -> None:
    measured = Measurements()
    measured.take_odometry(1, SE2(2.0, 0.0, 0.0), DRIVES)
    measured.take_scan(NO_ECHO)
    assert slipping(measured, 0, False, 0.0) is None
    # Localization corrects drift all the time.
    assert slipping(measured, 1, False, -0.1) is None
    told = [slipping(measured, 2 + i, True, -0.1 - 0.03 * i) for i in range(5)]
    assert [one is not None for one in told] == [False, False, True, False, True]
    assert told[2] is not None
    assert told[2].x_m == pytest.approx(0.06)
    # What the last scans show is corrected after the wheels hold again.
    last = slipping(measured, 8, False, -0.3)
    assert last is not None
    assert last.x_m == pytest.approx(0.08)
    assert slipping(measured, 30, False, -0.5) is None


def test_a_slip_without_a_known_pose_tells_nothing() -> None:
    measured = Measurements()
    measured.take_odometry(1, SE2(2.0, 0.0, 0.0), DRIVES)
    measured.take_scan(NO_ECHO)
    for number, x_m in enumerate((0.0, -0.2)):
        lost = LocalizationStatus(state="lost", quality=0.0, wheel_slip=True, epoch=3)
        measured.take_localization(lost)
        measured.correct(number, SE2(x_m, 0.0, 0.0))
        assert measured.odom_slipped(3) is None

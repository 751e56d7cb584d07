"""Whether commands reach the robot, as far as navigation can know."""

from __future__ import annotations

from mazebot.common.maths.frames import SE2
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.robot.measurements import Measurements

DRIVES = Velocity(0.4, 0.0)


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

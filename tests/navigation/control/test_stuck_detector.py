from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from mazebot.common.maths.frames import SE2
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.safety.progress_checker import ProgressChecker, ProgressParams
from mazebot.navigation.control.safety.stuck_detector import (
    Stuck,
    StuckDetector,
    StuckDetectorParams,
)

PERIOD_NS = 50_000_000
FORWARD, TURN = Velocity(0.2, 0.0), Velocity(0.0, 0.8)


def drive(
    detector: StuckDetector, command: Velocity, odom_share: float, map_share: float, seconds: float
) -> tuple[Stuck | None, float]:
    """The first verdict and when: odometry and localisation move by shares of the command."""
    for i in range(round(seconds * 1e9 / PERIOD_NS)):
        t = i * PERIOD_NS * 1e-9
        x, turn = command.linear_m_s * t, command.angular_rad_s * t
        odom = SE2(x * odom_share, 0.0, turn * odom_share)
        pose = SE2(3.0 + x * map_share, 0.0, turn * map_share)
        found = detector.update(i * PERIOD_NS, command, odom, pose)
        if found is not None:
            return found, t
    return None, seconds


@pytest.mark.parametrize("command", [FORWARD, TURN])
def test_wheels_that_do_not_turn_are_noticed_within_three_seconds(command: Velocity) -> None:
    found, after_s = drive(StuckDetector(StuckDetectorParams()), command, 0.0, 0.0, 10.0)
    assert found is not None
    assert not found.slips
    assert "odometry measured 0.00 m" in found.text
    assert after_s <= 3.0


@pytest.mark.parametrize("command", [FORWARD, TURN])
def test_wheels_that_slip_are_noticed_within_three_seconds(command: Velocity) -> None:
    found, after_s = drive(StuckDetector(StuckDetectorParams()), command, 1.0, 0.05, 10.0)
    assert found is not None
    assert found.slips
    assert "the wheels turned" in found.text
    assert after_s <= 3.0


@pytest.mark.parametrize(
    ("command", "share"), [(FORWARD, 1.0), (FORWARD, 0.5), (TURN, 1.0), (Velocity(0.02, 0.0), 0.0)]
)
def test_a_robot_that_moves_or_hardly_has_to_is_not_stuck(command: Velocity, share: float) -> None:
    assert drive(StuckDetector(StuckDetectorParams()), command, share, share, 10.0)[0] is None


def test_a_stop_and_a_reset_begin_anew() -> None:
    detector = StuckDetector(StuckDetectorParams())
    here = SE2(0.0, 0.0, 0.0)
    found: list[Stuck | None] = []
    for i in range(200):
        if i % 30 == 29:
            found.append(detector.update(i * PERIOD_NS, STOP, here, here))
        elif i % 30 == 14:
            detector.reset()
        else:
            found.append(detector.update(i * PERIOD_NS, FORWARD, here, here))
    assert not any(found)


def test_time_that_goes_back_begins_anew() -> None:
    detector = StuckDetector(StuckDetectorParams())
    here = SE2(0.0, 0.0, 0.0)
    assert detector.update(10 * 10**9, FORWARD, here, here) is None
    assert detector.update(0, FORWARD, here, here) is None
    assert detector.update(10**9, FORWARD, here, here) is None


def test_while_nothing_reached_the_robot_nothing_was_commanded() -> None:
    detector = StuckDetector(StuckDetectorParams())
    x_m, now_ns = 0.0, 0
    found: list[Stuck | None] = []
    for i in range(100):
        # The network is gone for five seconds, in which the robot stands.
        now_ns += 5 * 10**9 if i == 50 else PERIOD_NS
        x_m += FORWARD.linear_m_s * PERIOD_NS * 1e-9
        here = SE2(x_m, 0.0, 0.0)
        found.append(detector.update(now_ns, FORWARD, here, here))
    assert not any(found)


def progress_s(pose_at: Callable[[float], SE2], seconds: float = 30.0) -> float:
    """For how long a robot that moves like this makes progress."""
    checker = ProgressChecker(ProgressParams())
    for i in range(round(seconds * 1e9 / PERIOD_NS)):
        t = i * PERIOD_NS * 1e-9
        if not checker.makes_progress(i * PERIOD_NS, pose_at(t)):
            return t
    return seconds


@pytest.mark.parametrize("swing_rad", [0.15, 0.5, math.pi])
@pytest.mark.parametrize("drift_m", [0.0, 0.08])
def test_turns_to_and_fro_in_one_place_are_no_progress_for_ever(
    swing_rad: float, drift_m: float
) -> None:
    def dithers(t: float) -> SE2:
        return SE2(1.0 + drift_m * math.sin(t), 1.0, swing_rad * math.sin(2.0 * t))

    assert progress_s(dithers) < 10.0


def test_a_turn_by_a_whole_round_and_slow_ways_are_progress() -> None:
    assert 8.0 < progress_s(lambda t: SE2(1.0, 1.0, 1.0 * t)) < 10.0
    assert progress_s(lambda t: SE2(0.05 * t, 1.0, 0.0)) == 30.0
    assert progress_s(lambda t: SE2(0.05 * t, 1.0, math.sin(2.0 * t))) == 30.0

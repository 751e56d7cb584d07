from __future__ import annotations

import math

import numpy as np
import pytest

from services.common.frames import SE2, Array
from services.navigation.behaviors import (
    BackUp,
    Behavior,
    BehaviorStatus,
    Spin,
    Wait,
)
from services.navigation.collision import STOP, Surroundings, Velocity, first_contact_s
from services.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from services.navigation.costmap import Costmap
from tests.navigation.driving import NO_ECHOES, Unicycle, house_costmap

CONFIG = NavigationConfig()
PARAMS = CONFIG.navigator(0.05).behaviors
HOUSE = house_costmap(CONFIG).static
IN_THE_OPEN = SE2(3.0, 2.6, 0.0)
RADIUS_M = 0.23
PERIOD_S = CONTROL_PERIOD_NS * 1e-9


def run(
    behavior: Behavior, robot: Unicycle, echoes_m: Array = NO_ECHOES, costmap: Costmap = HOUSE
) -> tuple[BehaviorStatus, list[Velocity]]:
    commands: list[Velocity] = []
    for i in range(400):
        around = Surroundings(robot.map_from_base, costmap, echoes_m)
        status, velocity = behavior.step(i * CONTROL_PERIOD_NS, PERIOD_S, around)
        if status is not BehaviorStatus.RUNNING:
            assert velocity == STOP
            robot.drive(STOP, 1.0)
            return status, commands
        commands.append(velocity)
        robot.drive(velocity, PERIOD_S)
    raise AssertionError("never ended")


def test_spin_turns_by_a_quarter_and_stays_in_place() -> None:
    robot = Unicycle(IN_THE_OPEN)
    status, commands = run(Spin(PARAMS), robot)
    assert status is BehaviorStatus.SUCCEEDED
    assert robot.map_from_base.yaw_rad == pytest.approx(1.57, abs=0.1)
    assert robot.map_from_base.distance_m(IN_THE_OPEN) == pytest.approx(0.0, abs=1e-9)
    assert np.abs(np.diff([w for _, w in commands])).max() <= 2.0 * 0.05 + 1e-9


def test_back_up_drives_back_its_distance_at_its_speed() -> None:
    robot = Unicycle(IN_THE_OPEN)
    status, commands = run(BackUp(PARAMS), robot)
    assert status is BehaviorStatus.SUCCEEDED
    assert robot.map_from_base.x_m == pytest.approx(IN_THE_OPEN.x_m - 0.3, abs=0.03)
    assert min(v for v, _ in commands) == pytest.approx(-0.15)


def test_back_up_fails_before_a_wall() -> None:
    # Wall_6 is behind, its face at x = 5.41.
    robot = Unicycle(SE2(5.1, 1.5, math.pi))
    status, _ = run(BackUp(PARAMS), robot)
    assert status is BehaviorStatus.FAILED
    assert robot.map_from_base.x_m < 5.16


def test_back_up_fails_before_what_only_the_scan_shows() -> None:
    behind = np.array([[-0.3, 0.0]])
    status, commands = run(BackUp(PARAMS), Unicycle(IN_THE_OPEN), behind)
    assert status is BehaviorStatus.FAILED
    assert commands == []


def test_a_stuck_robot_gives_each_behaviour_up() -> None:
    for behavior in (Spin(PARAMS), BackUp(PARAMS)):
        status, commands = run(behavior, Unicycle(IN_THE_OPEN, stuck=True))
        assert status is BehaviorStatus.FAILED
        assert len(commands) <= 3.1 * 20


def test_wait_stands_for_its_time() -> None:
    status, commands = run(Wait(PARAMS), Unicycle(IN_THE_OPEN))
    assert status is BehaviorStatus.SUCCEEDED
    assert commands == [STOP] * 40


def contact_s(pose: SE2, velocity: Velocity, echoes_m: Array = NO_ECHOES) -> float:
    return first_contact_s(Surroundings(pose, HOUSE, echoes_m), velocity, 3.0, 0.05, RADIUS_M)


def test_time_to_contact_with_a_wall_of_the_map() -> None:
    # The face is 0.81 m ahead; at 0.4 m/s the circle of 0.24 m is there after 1.4 s.
    assert contact_s(SE2(4.6, 1.5, 0.0), Velocity(0.4, 0.0)) == pytest.approx(1.4, abs=0.15)
    assert contact_s(SE2(4.6, 1.5, math.pi / 2), Velocity(0.4, 0.0)) == math.inf


def test_time_to_contact_with_an_echo_on_the_arc() -> None:
    # A quarter circle of radius 0.5 m to the left ends at (0.5, 0.5).
    echo = np.array([[0.5, 0.5]])
    left = contact_s(IN_THE_OPEN, Velocity(0.25, 0.5), echo)
    assert left == pytest.approx((math.pi / 4 - 0.23) / 0.25, abs=0.1)
    assert contact_s(IN_THE_OPEN, Velocity(0.25, -0.5), echo) == math.inf


def test_a_robot_that_is_too_near_may_drive_away_but_not_nearer() -> None:
    echo = np.array([[0.2, 0.0]])
    assert contact_s(IN_THE_OPEN, Velocity(-0.2, 0.0), echo) == math.inf
    assert contact_s(IN_THE_OPEN, Velocity(0.2, 0.0), echo) < 0.2
    assert contact_s(IN_THE_OPEN, Velocity(0.0, 1.0), echo) == math.inf


def test_leaving_the_map_is_a_contact() -> None:
    edge = SE2(HOUSE.frame.origin_x_m + 0.1, 0.0, math.pi)
    assert contact_s(edge, Velocity(0.4, 0.0)) < 0.35

"""The robot drives like its kinematics, within its limits, and stops when nobody commands it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, inverse_matrix, wrap_angle
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import CMD_VEL, GROUND_TRUTH_ODOM, SIMULATION_STATS
from mazebot.physics.bodies.robot_model import robot_model_from_urdf
from mazebot.physics.config import STEPS_PER_SECOND, PhysicsConfig, time_of_step_ns
from mazebot.physics.simulation import Simulation
from tests.physics.driver import Driver, world


@pytest.fixture
def robot() -> Iterator[Driver]:
    driver = Driver().load(world(walls=()))
    yield driver
    driver.node.close()


@pytest.mark.parametrize("speed_m_s", [0.4, -0.4])
def test_drives_two_metres_straight(robot: Driver, speed_m_s: float) -> None:
    robot.drive(speed_m_s, 0.0, 2.0 / abs(speed_m_s))
    robot.drive(0.0, 0.0, 1.0)
    # A ramp down is as long as the ramp up: it adds what that one lost.
    assert robot.pose == pytest.approx((math.copysign(2.0, speed_m_s), 0.0, 0.0), abs=1e-3)


@pytest.mark.parametrize("speed_rad_s", [1.0, -1.0, 1.9])
def test_turns_once_round(robot: Driver, speed_rad_s: float) -> None:
    robot.drive(0.0, speed_rad_s, 2.0 * math.pi / abs(speed_rad_s))
    robot.drive(0.0, 0.0, 1.2)
    turned = sum(message.twist.twist.angular.z / 30.0 for message in robot.all(GROUND_TRUTH_ODOM))
    # Less 0.35 %: the wheels stand 288 mm apart, and the drive assumes 287 mm.
    full = math.copysign(2.0 * math.pi, speed_rad_s) * 287.0 / 288.0
    assert turned == pytest.approx(full, rel=1e-3)
    assert wrap_angle(robot.pose.yaw_rad - full) == pytest.approx(0.0, abs=5e-3)
    assert math.hypot(robot.pose.x_m, robot.pose.y_m) < 1e-3


@pytest.mark.parametrize(("linear", "angular"), [(0.2, 0.4), (0.4, 1.0), (0.3, -0.6)])
def test_drives_along_an_arc(robot: Driver, linear: float, angular: float) -> None:
    robot.drive(linear, angular, 1.0)
    robot.sent.clear()
    robot.drive(linear, angular, 4.0)
    poses = [msg.se2_from_pose(one.pose.pose) for one in robot.all(GROUND_TRUTH_ODOM)]
    radius_m = linear / angular * 288.0 / 287.0
    start = poses[0]
    centre = start @ SE2(0.0, radius_m, 0.0)
    away_m = [pose.distance_m(centre) for pose in poses]
    assert away_m == pytest.approx([abs(radius_m)] * len(poses), abs=2e-3)
    turned = wrap_angle(poses[-1].yaw_rad - start.yaw_rad)
    expected = angular * 287.0 / 288.0 * (len(poses) - 1) / 30.0
    assert wrap_angle(turned - expected) == pytest.approx(0.0, abs=5e-3)


def test_true_speed_is_that_of_the_footprint_in_its_own_axes() -> None:
    robot = Driver().load(world(walls=(), start=(0.0, 0.0, 1.0)))
    robot.drive(0.2, 1.0, 2.0)
    twist = robot.last(GROUND_TRUTH_ODOM).twist.twist
    assert twist.linear.x == pytest.approx(0.2, abs=0.005)
    # The centre of mass, 6 cm behind, goes sideways as the robot turns; the footprint does not.
    assert abs(twist.linear.y) < 0.005
    assert twist.angular.z == pytest.approx(1.0, abs=0.03)


def test_stands_still_for_a_minute() -> None:
    model = robot_model_from_urdf(PhysicsConfig().robot_urdf())
    simulation = Simulation(world(walls=()), model, PhysicsConfig())
    for step in range(1, 60 * STEPS_PER_SECOND + 1):
        simulation.step(time_of_step_ns(step))
        if step % 8 == 0:
            simulation.odometry.update(simulation.wheel_angles_rad, 1.0 / 30.0)
        if step == STEPS_PER_SECOND:
            settled = simulation.bodies.map_from_footprint()
    crept = inverse_matrix(settled) @ simulation.bodies.map_from_footprint()
    assert np.abs(crept - np.eye(4)).max() < 1e-6
    assert simulation.odometry.odom_from_footprint == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    simulation.close()


def test_stands_level_on_its_wheels(robot: Driver) -> None:
    robot.wait(1.0)
    pose = robot.last(GROUND_TRUTH_ODOM).pose.pose
    assert abs(pose.position.z) < 1e-3
    assert abs(pose.orientation.x) < 1e-3
    assert abs(pose.orientation.y) < 1e-3


def test_starts_where_the_world_says() -> None:
    robot = Driver().load(world(walls=(), start=(-1.5, 2.25, 2.0)))
    robot.wait(0.5)
    assert robot.pose.distance_m(SE2(-1.5, 2.25, 0.0)) < 1e-3
    assert robot.pose.yaw_rad == pytest.approx(2.0, abs=1e-3)


def test_clamps_what_is_beyond_the_limits(robot: Driver) -> None:
    robot.drive(3.0, 0.0, 1.5)
    assert robot.speeds[0] == pytest.approx(0.46, abs=0.01)
    robot.drive(-3.0, 0.0, 2.0)
    assert robot.speeds[0] == pytest.approx(-0.46, abs=0.01)
    robot.drive(0.0, 50.0, 2.0)
    assert robot.speeds[1] == pytest.approx(1.9, abs=0.04)


@pytest.mark.parametrize(
    ("axis", "limit", "rate"), [(0, 0.46, 1.0), (1, 1.9, 2.0)], ids=["linear", "angular"]
)
def test_speeds_up_and_down_along_the_ramp(
    robot: Driver, axis: int, limit: float, rate: float
) -> None:
    robot.wait(0.5)
    expected, ramp, speeds = [], 0.0, []
    for target, steps in ((9.0, 300), (-9.0, 500), (0.0, 300)):
        for step in range(steps):
            if step % 12 == 0:
                robot.command(*((target, 0.0) if axis == 0 else (0.0, target)))
            robot.turn()
            speeds.append(robot.speeds[axis])
            goal = max(-limit, min(limit, target))
            ramp += max(-rate / 240.0, min(rate / 240.0, goal - ramp))
            expected.append(ramp)
    assert speeds == pytest.approx(expected, rel=0.004, abs=2e-3)
    assert np.abs(np.diff(speeds)).max() < rate / 240.0 * 1.01
    if axis == 0:
        # Nothing but the robot moves, so that its contacts are solved exactly.
        assert speeds == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("linear", "angular"), [(0.46, 0.0), (-0.46, 0.0), (0.0, 1.9), (0.46, 1.9), (0.3, -1.2)]
)
def test_rests_within_400_ms_of_the_last_command(
    robot: Driver, linear: float, angular: float
) -> None:
    robot.drive(linear, angular, 2.0)
    robot.command(linear, angular)
    robot.turn()
    before = robot.pose
    robot.wait(0.4)
    speed, spin = robot.speeds
    assert abs(speed) < 0.01
    assert abs(spin) < 0.02
    assert robot.pose.distance_m(before) <= 0.15
    robot.wait(1.0)
    assert robot.last(SIMULATION_STATS).watchdog_stops == 1


def test_rests_at_once_where_the_one_who_commands_is_gone(
    robot: Driver, caplog: pytest.LogCaptureFixture
) -> None:
    robot.drive(0.46, 0.0, 2.0)
    robot.inbox.leave("somebody else")
    robot.wait(0.04)
    assert robot.speeds[0] == pytest.approx(0.46, abs=0.01)
    robot.inbox.leave("test")
    robot.wait(0.15)
    assert abs(robot.speeds[0]) < 0.01
    robot.wait(0.2)
    assert robot.last(SIMULATION_STATS).watchdog_stops == 1
    assert [r.getMessage() for r in caplog.records if r.levelname == "WARNING"] == [
        "publisher of velocity commands is gone: stopping the robot"
    ]
    robot.inbox.come_back("test")
    robot.drive(0.3, 0.0, 1.0)
    assert robot.speeds[0] == pytest.approx(0.3, abs=0.01)


def test_one_source_of_commands_holds_the_robot_until_it_is_silent(robot: Driver) -> None:
    for step in range(240):
        # The other one is more often heard, and sometimes in the same step.
        if step % 12 == 0:
            robot.command(0.3, source="first")
        if step % 4 == 0 and step > 0:
            robot.command(-0.4, source="second")
        robot.turn()
    assert robot.speeds[0] == pytest.approx(0.3, abs=0.01)
    assert robot.inbox.counts[CMD_VEL.name].rejected == {"another publisher is in control": 59}
    for step in range(240):
        if step % 12 == 0:
            robot.command(-0.4, source="second")
        robot.turn()
    assert robot.speeds[0] == pytest.approx(-0.4, abs=0.01)


def test_one_that_has_stopped_the_robot_leaves_it_to_others(robot: Driver) -> None:
    robot.drive(0.3, 0.0, 1.0)
    robot.command(0.0)
    robot.turn()
    robot.command(0.2, source="second")
    robot.turn()
    robot.command(0.0)
    robot.wait(0.15)
    assert robot.speeds[0] == pytest.approx(0.2, abs=0.03)
    assert robot.inbox.counts[CMD_VEL.name].rejected == {"another publisher is in control": 1}


def test_where_the_one_who_commands_is_gone_another_one_may_at_once(robot: Driver) -> None:
    robot.drive(0.3, 0.0, 1.0)
    robot.inbox.leave("test")
    robot.command(0.2, source="second")
    robot.turn()
    robot.wait(0.15)
    assert robot.speeds[0] == pytest.approx(0.2, abs=0.03)
    assert not robot.inbox.counts[CMD_VEL.name].rejected


def test_a_command_that_comes_later_than_the_end_of_its_source_moves_nothing(
    robot: Driver, caplog: pytest.LogCaptureFixture
) -> None:
    robot.drive(0.3, 0.0, 1.0)
    robot.inbox.leave("test")
    robot.command(0.3)
    robot.wait(0.15)
    assert robot.speeds[0] == pytest.approx(0.0, abs=0.01)
    assert "publisher of velocity commands is gone" in caplog.text


def test_keeps_going_while_commands_come(robot: Driver) -> None:
    robot.drive(0.3, 0.0, 1.0)
    robot.wait(0.15)
    assert robot.speeds[0] == pytest.approx(0.3, abs=0.01)
    robot.drive(0.3, 0.0, 0.4)
    assert robot.last(SIMULATION_STATS).watchdog_stops == 0


def test_silence_after_a_stop_is_no_watchdog_stop(robot: Driver) -> None:
    robot.drive(0.3, 0.0, 1.0)
    robot.drive(0.0, 0.0, 0.5)
    robot.wait(1.0)
    assert robot.last(SIMULATION_STATS).watchdog_stops == 0


def test_moves_again_at_the_first_fresh_command(robot: Driver) -> None:
    robot.drive(0.4, 0.0, 1.0)
    robot.wait(1.0)
    robot.drive(0.4, 0.0, 1.0)
    assert robot.speeds[0] == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_is_no_command(robot: Driver, value: float) -> None:
    robot.drive(0.3, 0.0, 1.0)
    for _ in range(48):
        robot.command(value, 0.0)
        robot.turn()
        robot.command(0.3, value)
        robot.turn()
    assert robot.inbox.counts[CMD_VEL.name].rejected["not finite"] == 96
    # It did not count as a sign of life either.
    assert abs(robot.speeds[0]) < 0.01
    robot.drive(0.3, 0.0, 1.0)
    assert robot.speeds[0] == pytest.approx(0.3, abs=0.01)


def test_old_and_future_commands_are_refused(robot: Driver) -> None:
    robot.wait(2.0)
    twist = msg.Twist(linear=msg.Vector3(x=0.4, y=0.0, z=0.0), angular=msg.Vector3(0.0, 0.0, 0.0))
    for offset_ns in (-210_000_000, 210_000_000):
        stamp = msg.header(robot.now_ns + offset_ns, "")
        robot.deliver(CMD_VEL, msg.TwistStamped(header=stamp, twist=twist))
        robot.wait(0.1)
        assert abs(robot.speeds[0]) < 1e-3
    rejected = robot.inbox.counts[CMD_VEL.name].rejected
    assert rejected == {"stale": 1, "stamp in the future": 1}
    robot.deliver(CMD_VEL, msg.TwistStamped(header=msg.header(0, ""), twist=twist))
    robot.wait(0.15)
    assert robot.speeds[0] > 0.1


def test_a_command_of_another_world_is_refused(robot: Driver) -> None:
    twist = msg.Twist(linear=msg.Vector3(x=0.4, y=0.0, z=0.0), angular=msg.Vector3(0.0, 0.0, 0.0))
    command = msg.TwistStamped(header=msg.header(0, ""), twist=twist)
    robot.deliver(CMD_VEL, command, world_hash="0123456789abcdef")
    robot.wait(0.2)
    assert abs(robot.speeds[0]) < 1e-3

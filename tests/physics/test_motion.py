"""The robot drives like its kinematics, within its limits, and stops when nobody commands it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from services.common import messages as msg
from services.common.frames import SE2, wrap_angle
from services.common.node import random_generator
from services.common.topics import (
    CMD_VEL,
    GROUND_TRUTH_ODOM,
    IMU,
    JOINT_STATES,
    ODOM,
    SIMULATION_STATS,
    TF,
)
from services.physics.odometry import WheelOdometry
from tests.physics.driver import Driver, world


@pytest.fixture
def robot() -> Iterator[Driver]:
    driver = Driver().load(world(walls=()))
    yield driver
    driver.node.close()


def test_drives_two_metres_straight(robot: Driver) -> None:
    robot.drive(0.4, 0.0, 5.0)
    robot.drive(0.0, 0.0, 1.0)
    # Ramps at 1 m/s2 up and down: 0.4 m/s for 5 s is 2 m.
    assert robot.pose.x_m == pytest.approx(2.0, rel=0.02)
    assert abs(robot.pose.y_m) < 0.02
    assert abs(robot.pose.yaw_rad) < 0.02


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_turns_once_round(robot: Driver, direction: float) -> None:
    robot.drive(0.0, direction, 2.0 * math.pi)
    robot.drive(0.0, 0.0, 1.0)
    assert abs(wrap_angle(robot.pose.yaw_rad)) < 0.03 * 2.0 * math.pi
    turned = sum(message.twist.twist.angular.z / 30.0 for message in robot.all(GROUND_TRUTH_ODOM))
    assert turned == pytest.approx(direction * 2.0 * math.pi, rel=0.03)
    assert math.hypot(robot.pose.x_m, robot.pose.y_m) < 0.02


def test_true_speed_is_that_of_the_footprint_in_its_own_axes() -> None:
    robot = Driver().load(world(walls=(), start=(0.0, 0.0, 1.0)))
    robot.drive(0.2, 1.0, 2.0)
    twist = robot.last(GROUND_TRUTH_ODOM).twist.twist
    assert twist.linear.x == pytest.approx(0.2, abs=0.005)
    # The centre of mass, 6 cm behind, goes sideways as the robot turns; the footprint does not.
    assert abs(twist.linear.y) < 0.005
    assert twist.angular.z == pytest.approx(1.0, abs=0.03)


def test_stands_still_without_creeping(robot: Driver) -> None:
    robot.wait(10.0)
    assert math.hypot(robot.pose.x_m, robot.pose.y_m) < 2e-4
    assert abs(robot.pose.yaw_rad) < 1e-4


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


def test_speeds_up_along_the_ramp(robot: Driver) -> None:
    speeds = []
    for _ in range(12):
        robot.drive(0.4, 0.0, 0.05)
        speeds.append(robot.speeds[0])
    for index, speed in enumerate(speeds):
        assert speed == pytest.approx(min(0.4, 0.05 * (index + 1)), abs=0.015)


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
    assert rejected == {"stale": 1, "from the future": 1}
    robot.deliver(CMD_VEL, msg.TwistStamped(header=msg.header(0, ""), twist=twist))
    robot.wait(0.15)
    assert robot.speeds[0] > 0.1


def test_a_command_of_another_world_is_refused(robot: Driver) -> None:
    twist = msg.Twist(linear=msg.Vector3(x=0.4, y=0.0, z=0.0), angular=msg.Vector3(0.0, 0.0, 0.0))
    command = msg.TwistStamped(header=msg.header(0, ""), twist=twist)
    robot.deliver(CMD_VEL, command, world_hash="0123456789abcdef")
    robot.wait(0.2)
    assert abs(robot.speeds[0]) < 1e-3


def _tour(robot: Driver) -> None:
    robot.drive(0.4, 0.0, 2.0)
    robot.drive(0.2, 1.0, 4.0)
    robot.drive(-0.2, -0.8, 3.0)
    robot.drive(0.0, 0.0, 0.7)


def test_odometry_drifts_a_little_from_the_truth(robot: Driver) -> None:
    _tour(robot)
    odometry = msg.se2_from_pose(robot.last(ODOM).pose.pose)
    drift_m = odometry.distance_m(robot.pose)
    drift_rad = abs(wrap_angle(odometry.yaw_rad - robot.pose.yaw_rad))
    assert 1e-4 < drift_m < 0.05
    assert 1e-4 < drift_rad < 0.05


def test_odometry_starts_at_its_own_origin() -> None:
    robot = Driver().load(world(walls=(), start=(1.0, 2.0, 1.5)))
    robot.wait(0.1)
    odometry = msg.se2_from_pose(robot.last(ODOM).pose.pose)
    assert odometry.distance_m(SE2(0.0, 0.0, 0.0)) < 1e-4
    assert robot.last(ODOM).header.frame_id == "odom"


def test_odometry_is_what_the_wheels_say_and_no_more() -> None:
    robot = Driver().load(world(walls=[("W", 4.0, 0.6, 0.0, math.pi / 2)]))
    robot.drive(0.3, 0.0, 5.0)
    # The wall holds the robot; the wheels spin on.
    assert robot.pose.x_m < 0.5
    angles = robot.last(JOINT_STATES).position
    odometry = msg.se2_from_pose(robot.last(ODOM).pose.pose)
    assert odometry.x_m == pytest.approx(float(angles.mean()) * 0.033, abs=0.02)
    assert odometry.x_m > robot.pose.x_m + 0.3


def test_tf_is_the_odometry(robot: Driver) -> None:
    _tour(robot)
    transform = robot.last(TF).transforms[0]
    pose = robot.last(ODOM).pose.pose
    assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_footprint")
    assert transform.header.stamp == robot.last(ODOM).header.stamp
    assert transform.transform.translation.x == pytest.approx(pose.position.x, abs=1e-12)
    assert transform.transform.rotation.z == pytest.approx(pose.orientation.z, abs=1e-12)


def test_odometry_covariance_covers_the_noise() -> None:
    ends = []
    for seed in range(200):
        random = random_generator(seed, "physics/odometry")
        odometry = WheelOdometry(0.287, 0.033, (0.0, 0.0), 0.02, random)
        # A left turn over 2 m: the right wheel rolls farther.
        for step in range(1, 51):
            odometry.update((step * 0.037 / 0.033, step * 0.043 / 0.033), 1.0 / 30.0)
        ends.append(odometry.odom_from_footprint)
    spread = np.cov(np.array(ends).T)
    expected = odometry.covariance
    assert np.sqrt(np.diag(spread)) == pytest.approx(np.sqrt(np.diag(expected)), rel=0.2)
    assert (np.sign(spread) == np.sign(expected)).all()


def test_odometry_follows_an_arc_exactly() -> None:
    odometry = WheelOdometry(0.287, 0.033, (1.0, 2.0), 0.0, random_generator(1, "physics/odometry"))
    quarter = math.pi / 2.0
    inner, outer = (0.5 - 0.1435) * quarter, (0.5 + 0.1435) * quarter
    odometry.update((1.0 + inner / 0.033, 2.0 + outer / 0.033), 2.0)
    # A quarter of a circle of radius 0.5 m to the left.
    assert odometry.odom_from_footprint == pytest.approx((0.5, 0.5, quarter))
    assert odometry.linear_m_s == pytest.approx(0.5 * quarter / 2.0)
    assert odometry.angular_rad_s == pytest.approx(quarter / 2.0)


def test_imu_feels_gravity_and_turning(robot: Driver) -> None:
    robot.drive(0.0, 1.0, 3.0)
    readings = robot.all(IMU)[-120:]
    spin = sum(reading.angular_velocity.z for reading in readings) / 120
    gravity = sum(reading.linear_acceleration.z for reading in readings) / 120
    assert spin == pytest.approx(robot.speeds[1], abs=0.01)
    assert gravity == pytest.approx(9.8, abs=0.05)
    noise = {reading.angular_velocity.x for reading in readings}
    assert len(noise) == 120


def test_imu_feels_the_ramp(robot: Driver) -> None:
    robot.drive(0.4, 0.0, 0.3)
    forward = [reading.linear_acceleration.x for reading in robot.all(IMU)[6:]]
    assert sum(forward) / len(forward) == pytest.approx(1.0, abs=0.1)

"""Odometry is what the wheels say: it drifts where they slip or are misread, the truth does not."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import GROUND_TRUTH_ODOM, JOINT_STATES, ODOM, TF
from mazebot.common.node.node import random_generator
from mazebot.physics.sensors.odometry import WheelOdometry
from tests.physics.driver import Driver, world


@pytest.fixture
def robot() -> Iterator[Driver]:
    driver = Driver().load(world(walls=()))
    yield driver
    driver.node.close()


def _odometry(robot: Driver) -> SE2:
    return msg.se2_from_pose(robot.last(ODOM).pose.pose)


def _tour(robot: Driver) -> None:
    robot.drive(0.4, 0.0, 2.0)
    robot.drive(0.2, 1.0, 4.0)
    robot.drive(-0.2, -0.8, 3.0)
    robot.drive(0.0, 0.0, 0.7)


def test_drifts_a_little_from_the_truth(robot: Driver) -> None:
    _tour(robot)
    odometry = _odometry(robot)
    drift_m = odometry.distance_m(robot.pose)
    drift_rad = abs(wrap_angle(odometry.yaw_rad - robot.pose.yaw_rad))
    assert 1e-4 < drift_m < 0.05
    assert 1e-4 < drift_rad < 0.05


def test_odometry_starts_at_its_own_origin() -> None:
    robot = Driver().load(world(walls=(), start=(1.0, 2.0, 1.5)))
    robot.wait(0.1)
    odometry = _odometry(robot)
    assert odometry.distance_m(SE2(0.0, 0.0, 0.0)) < 1e-4
    assert robot.last(ODOM).header.frame_id == "odom"


def test_odometry_is_what_the_wheels_say_and_no_more() -> None:
    robot = Driver().load(world(walls=[("W", 4.0, 0.6, 0.0, math.pi / 2)]))
    robot.drive(0.3, 0.0, 5.0)
    # The wall holds the robot; the wheels spin on.
    assert robot.pose.x_m < 0.5
    angles = robot.last(JOINT_STATES).position
    odometry = _odometry(robot)
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
    ends, told = [], []
    for seed in range(300):
        random = random_generator(seed, "physics/odometry")
        odometry = WheelOdometry(0.287, 0.033, (0.0, 0.0), 0.02, random)
        # A left turn over 2 m: the right wheel rolls farther.
        for step in range(1, 51):
            odometry.update((step * 0.037 / 0.033, step * 0.043 / 0.033), 1.0 / 30.0)
        ends.append(odometry.odom_from_footprint)
        told.append(odometry.covariance)
    spread = np.cov(np.array(ends).T)
    # Each run tells the covariance about the way that it has measured.
    expected = np.mean(told, axis=0)
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


@pytest.mark.parametrize("slip", [0.05, 0.3])
def test_wheels_that_slip_roll_less_than_they_tell(slip: float) -> None:
    robot = Driver(wheel_slip=slip).load(world(walls=()))
    robot.drive(0.4, 0.0, 5.0)
    robot.drive(0.0, 0.0, 1.0)
    assert robot.pose.x_m == pytest.approx(2.0 * (1.0 - slip), abs=1e-3)
    assert _odometry(robot).x_m == pytest.approx(2.0, abs=1e-3)
    assert robot.last(JOINT_STATES).position * 0.033 == pytest.approx([2.0, 2.0], abs=1e-3)
    robot.node.close()


def test_slip_takes_its_share_of_a_turn() -> None:
    robot = Driver(wheel_slip=0.1).load(world(walls=()))
    robot.drive(0.0, 1.0, 2.0)
    told, true = robot.last(ODOM).twist.twist.angular.z, robot.speeds[1]
    assert told == pytest.approx(1.0, abs=1e-3)
    # Less 0.35 %, since the wheels stand 288 mm apart and odometry assumes 287 mm.
    assert true == pytest.approx(0.9, rel=0.005)
    robot.node.close()


def _drive_with(**config: object) -> Driver:
    robot = Driver(**config).load(world(walls=()))
    robot.drive(0.4, 0.5, 2.0)
    robot.node.close()
    return robot


def test_noise_of_the_wheels_is_in_odometry_and_never_in_the_truth() -> None:
    exact, noisy = _drive_with(), _drive_with(wheel_noise_m_per_sqrt_m=0.05)
    again, other = (_drive_with(wheel_noise_m_per_sqrt_m=0.05, seed=seed) for seed in (7, 8))
    for robot in (noisy, again, other):
        assert robot.all(GROUND_TRUTH_ODOM) == exact.all(GROUND_TRUTH_ODOM)
    assert _odometry(noisy) == _odometry(again)
    assert _odometry(noisy) != _odometry(other)
    drift_m = _odometry(noisy).distance_m(noisy.pose)
    assert drift_m > 5.0 * _odometry(exact).distance_m(exact.pose)


def test_the_truth_is_the_state_of_the_robot_in_pybullet(robot: Driver) -> None:
    _tour(robot)
    robot.wait(1.0 / 30.0)
    simulation = robot.node._simulation
    assert simulation is not None
    robot.sent.clear()
    while not robot.all(GROUND_TRUTH_ODOM):
        robot.turn()
    pose = simulation.bodies.map_from_footprint()
    told = robot.last(GROUND_TRUTH_ODOM).pose.pose.position
    assert (told.x, told.y, told.z) == pytest.approx(pose[:3, 3], abs=1e-12)

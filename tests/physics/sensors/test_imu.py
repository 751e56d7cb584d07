"""The IMU feels turning, gravity and ramps, with white noise of the stated strength."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pytest

from mazebot.common.maths.frames import SE3, Array, rotation_from_rpy, transform_matrix
from mazebot.common.messages.messages import Imu as Reading
from mazebot.common.messages.topics import IMU
from mazebot.common.node.node import random_generator
from mazebot.physics.bodies.bodies import Bodies, Motion
from mazebot.physics.config import PhysicsConfig
from mazebot.physics.sensors.imu import Imu
from tests.physics.driver import Driver, world

GYRO_RAD_S = PhysicsConfig().gyro_noise_rad_s
ACCELEROMETER_M_S2 = PhysicsConfig().accelerometer_noise_m_s2


class AtRest:
    """What an IMU asks of bodies, with a robot that lies tilted and does not move."""

    def __init__(self, map_from_imu: Array) -> None:
        self.map_from_imu = SE3.from_matrix(transform_matrix(map_from_imu, (0.0, 0.0, 0.0)))

    def com_from(self, footprint_from_frame: Array) -> SE3:
        return SE3.from_matrix(footprint_from_frame)

    def motion_at(self, _: SE3) -> Motion:
        return Motion(self.map_from_imu, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def _values(readings: list[Reading]) -> Array:
    """(n, 6) of gyroscope and accelerometer."""
    return np.array(
        [
            [getattr(vector, axis) for vector in vectors for axis in "xyz"]
            for vectors in ((one.angular_velocity, one.linear_acceleration) for one in readings)
        ]
    )


def _at_rest(roll_rad: float = 0.0, pitch_rad: float = 0.0, count: int = 6_000) -> Array:
    bodies = AtRest(rotation_from_rpy(roll_rad, pitch_rad, 0.4))
    random = random_generator(7, "physics/imu")
    imu = Imu(cast("Bodies", bodies), np.eye(4), GYRO_RAD_S, ACCELEROMETER_M_S2, random)
    return _values([imu.read(0, 1.0 / 120.0) for _ in range(count)])


def test_noise_has_the_stated_sigma_and_no_bias() -> None:
    values = _at_rest()
    sigma = np.array([GYRO_RAD_S] * 3 + [ACCELEROMETER_M_S2] * 3)
    mean = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.8])
    # Four standard errors of each estimate.
    assert (np.abs(values.mean(axis=0) - mean) < 4.0 * sigma / math.sqrt(len(values))).all()
    assert values.std(axis=0) == pytest.approx(sigma, rel=4.0 / math.sqrt(2 * len(values)))


def test_noise_is_white_and_the_axes_know_nothing_of_each_other() -> None:
    values = _at_rest()
    noise = (values - values.mean(axis=0)) / values.std(axis=0)
    bound = 4.5 / math.sqrt(len(noise))
    for lag in range(1, 21):
        assert np.abs((noise[lag:] * noise[:-lag]).mean(axis=0)).max() < bound
    across = noise.T @ noise / len(noise) - np.eye(6)
    assert np.abs(across).max() < bound
    # As strong at every frequency: in each of eight bands an eighth of the power.
    power = np.abs(np.fft.rfft(noise, axis=0)[1:]) ** 2
    bands = np.array([band.mean(axis=0) for band in np.array_split(power, 8)]) / power.mean(axis=0)
    assert np.abs(bands - 1.0).max() < 4.5 / math.sqrt(len(power) / 8)


def test_density_is_that_of_the_docstring() -> None:
    """The spectrum of a minute, in units per square root of a hertz."""
    values = _at_rest(count=7_200)
    spectrum = np.abs(np.fft.rfft(values - values.mean(axis=0), axis=0)[1:]) ** 2
    density = np.sqrt(spectrum.mean(axis=0) / (len(values) * 120.0))
    assert density[:3] == pytest.approx(1.83e-5, rel=0.05)
    assert density[3:] == pytest.approx(1.55e-3, rel=0.05)
    assert all(figure in str(Imu.__doc__) for figure in ("1.83e-5", "1.55e-3"))


@pytest.mark.parametrize(("roll_rad", "pitch_rad"), [(0.0, 0.3), (0.3, 0.0), (-0.2, -0.1)])
def test_gravity_is_felt_along_the_axes_of_a_tilted_robot(
    roll_rad: float, pitch_rad: float
) -> None:
    force = _at_rest(roll_rad, pitch_rad, count=400)[:, 3:].mean(axis=0)
    up = (
        -math.sin(pitch_rad),
        math.cos(pitch_rad) * math.sin(roll_rad),
        math.cos(pitch_rad) * math.cos(roll_rad),
    )
    assert force == pytest.approx(9.8 * np.array(up), abs=5e-3)


def test_feels_gravity_and_turning() -> None:
    robot = Driver().load(world(walls=()))
    robot.drive(0.0, 1.0, 3.0)
    values = _values(robot.all(IMU)[-120:])
    mean = values.mean(axis=0)
    assert mean[2] == pytest.approx(robot.speeds[1], abs=1e-3)
    assert mean[5] == pytest.approx(9.8, abs=0.01)
    assert len(set(values[:, 0])) == 120
    robot.node.close()


def test_feels_the_curve() -> None:
    robot = Driver().load(world(walls=()))
    robot.drive(0.4, 1.0, 3.0)
    mean = _values(robot.all(IMU)[-120:]).mean(axis=0)
    # v w to the left: the IMU sits above the middle of the axle.
    assert mean[3:5] == pytest.approx([0.0, robot.speeds[0] * robot.speeds[1]], abs=0.01)
    robot.node.close()


def test_feels_the_ramp() -> None:
    robot = Driver().load(world(walls=()))
    robot.drive(0.4, 0.0, 0.3)
    forward = _values(robot.all(IMU)[6:])[:, 3]
    assert forward.mean() == pytest.approx(1.0, abs=0.1)
    robot.node.close()


def test_stands_still_no_louder_than_its_noise() -> None:
    robot = Driver().load(world(walls=()))
    robot.wait(4.0)
    spread = _values(robot.all(IMU)[120:]).std(axis=0)
    assert spread[:3] == pytest.approx(GYRO_RAD_S, rel=0.25)
    assert spread[3:] == pytest.approx(ACCELEROMETER_M_S2, rel=0.25)
    robot.node.close()

"""What a robot that tilts makes of its depth images."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    IMU_FRAME,
    Array,
    rotation_from_rpy,
    transform_matrix,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import DEPTH_IMAGE, DEPTH_SCAN, IMU, TF_STATIC
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.node import PerceptionNode
from mazebot.perception.tilt import Tilt
from tests.perception.test_node import PERIOD_NS, Bench, depth_bench, depth_image, tf

READING_NS = 8_333_333
TOLERANCE_RAD = 0.01
AHEAD_DOWN_RAD = math.radians(2.8)
"""Of a robot whose castor is on a sill of 8 mm."""
ON_ITS_SIDE = transform_matrix(rotation_from_rpy(math.pi / 2.0, 0.0, 0.4), (0.0, 0.0, 0.1))


def reading(
    stamp_ns: int, rate_rad_s: float, force_m_s2: tuple[float, float, float], base_from_imu: Array
) -> msg.Imu:
    """Of a robot that tips ahead with this rate."""
    turn = base_from_imu[:3, :3].T
    return msg.Imu(
        header=msg.header(stamp_ns, IMU_FRAME),
        orientation=msg.Quaternion(0.0, 0.0, 0.0, 1.0),
        orientation_covariance=np.zeros(9),
        angular_velocity=msg.Vector3(*(turn @ (0.0, rate_rad_s, 0.7)).tolist()),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=msg.Vector3(*(turn @ force_m_s2).tolist()),
        linear_acceleration_covariance=np.zeros(9),
    )


class Ride:
    """Readings, one after another."""

    def __init__(self, base_from_imu: Array) -> None:
        self.base_from_imu = base_from_imu
        self.now_ns = 0

    def tip(self, by_rad: float, readings: int = 12) -> list[msg.Imu]:
        """Tip evenly, and come to rest."""
        rate = by_rad / (readings * READING_NS * 1e-9)
        return [*self._read(readings, rate, (0.0, 0.0, 9.8)), *self._read(1, 0.0, (0.0, 0.0, 9.8))]

    def stand(self, tilt_rad: float, pushed_m_s2: float = 0.0, readings: int = 40) -> list[msg.Imu]:
        """Stay at a tilt, or accelerate there."""
        ahead = pushed_m_s2 - 9.8 * math.sin(tilt_rad)
        return self._read(readings, 0.0, (ahead, 0.0, 9.8 * math.cos(tilt_rad)))

    def _read(
        self, readings: int, rate_rad_s: float, force_m_s2: tuple[float, float, float]
    ) -> list[msg.Imu]:
        stamps = [self.now_ns + (i + 1) * READING_NS for i in range(readings)]
        self.now_ns = stamps[-1]
        return [reading(at, rate_rad_s, force_m_s2, self.base_from_imu) for at in stamps]


@pytest.mark.parametrize("base_from_imu", [np.eye(4), ON_ITS_SIDE])
def test_the_tilt_is_that_of_the_gyroscope(base_from_imu: Array) -> None:
    tilt, ride = Tilt(TOLERANCE_RAD), Ride(base_from_imu)

    def take(readings: list[msg.Imu]) -> float:
        for one in readings:
            tilt.take(one, base_from_imu)
        return tilt.at(ride.now_ns)

    # Its own acceleration is none.
    assert take(ride.stand(0.0, pushed_m_s2=1.0)) < 1e-6
    assert take(ride.tip(AHEAD_DOWN_RAD)) == pytest.approx(AHEAD_DOWN_RAD, rel=0.01)
    before_ns = ride.now_ns
    assert take(ride.stand(AHEAD_DOWN_RAD)) == pytest.approx(AHEAD_DOWN_RAD, rel=0.01)
    # What a blow has hidden from it does not stay.
    assert take(ride.tip(0.6 * -AHEAD_DOWN_RAD)) > TOLERANCE_RAD
    assert take(ride.stand(0.0)) < 1e-6
    assert tilt.at(before_ns) == pytest.approx(AHEAD_DOWN_RAD, rel=0.01)
    assert tilt.at(ride.now_ns + PERIOD_NS + 1) == 0.0


def test_a_sensor_mounted_badly_with_a_gyroscope_that_drifts_sees_the_true_tilt_alone() -> None:
    off = transform_matrix(rotation_from_rpy(0.02, -0.015, 0.0), (0.0, 0.0, 0.0))
    tilt, ride = Tilt(TOLERANCE_RAD), Ride(off)
    tilts_rad = []
    for round_ in range(600):
        pushed_m_s2 = (0.0, 0.5, 0.0, -0.5)[round_ % 4]
        for one in ride.stand(0.0, pushed_m_s2):
            # It turns in every other round.
            spin = one.angular_velocity if round_ % 2 else msg.Vector3(0.0, 0.0, 0.0)
            one.angular_velocity = msg.Vector3(spin.x + 3e-3, spin.y, spin.z)
            tilt.take(one, np.eye(4))
            tilts_rad.append(tilt.at(ride.now_ns))
    assert max(tilts_rad[len(tilts_rad) // 20 :]) <= TOLERANCE_RAD
    for one in ride.tip(AHEAD_DOWN_RAD):
        tilt.take(one, np.eye(4))
    assert tilt.at(ride.now_ns) == pytest.approx(AHEAD_DOWN_RAD, rel=0.2)


def test_a_robot_that_turned_before_its_mounting_was_known_is_level_when_it_stands() -> None:
    off = transform_matrix(rotation_from_rpy(0.02, -0.015, 0.0), (0.0, 0.0, 0.0))
    tilt, ride = Tilt(TOLERANCE_RAD), Ride(off)
    for one in ride.stand(0.0, readings=540):
        tilt.take(one, np.eye(4))
    assert tilt.at(ride.now_ns) > TOLERANCE_RAD
    for one in ride.stand(0.0, readings=2400):
        one.angular_velocity = msg.Vector3(0.0, 0.0, 0.0)
        tilt.take(one, np.eye(4))
    assert tilt.at(ride.now_ns) <= TOLERANCE_RAD


def scan_of(made: Bench, stamp_ns: int) -> msg.LaserScan:
    made.hear(DEPTH_IMAGE, depth_image(stamp_ns))
    made.step(stamp_ns)
    made.step(stamp_ns + PERIOD_NS)
    (scan,) = [message for name, message in made.said if name == DEPTH_SCAN.name]
    assert isinstance(scan, msg.LaserScan)
    return scan


def test_a_depth_image_of_a_tilted_robot_measures_nothing() -> None:
    made, ride = depth_bench(), Ride(np.eye(4))
    made.hear(TF_STATIC, tf(0, BASE_FOOTPRINT_FRAME, IMU_FRAME, np.eye(4)))
    level = scan_of(made, ride.now_ns)
    assert np.isfinite(level.ranges).any()
    for one in (*ride.stand(0.0), *ride.tip(AHEAD_DOWN_RAD)):
        made.hear(IMU, one)
    tilted = scan_of(made, ride.now_ns)
    assert (tilted.ranges == -np.inf).all()
    assert tilted.angle_min == level.angle_min
    assert tilted.range_max == level.range_max
    assert made.node.warning() == "robot tilted by 2.8 degrees: depth images not used"
    ride.now_ns += 2 * PERIOD_NS
    for one in (*ride.tip(-AHEAD_DOWN_RAD), *ride.stand(0.0)):
        made.hear(IMU, one)
    assert np.isfinite(scan_of(made, ride.now_ns).ranges).any()
    assert not made.node.warning()


@pytest.mark.parametrize("has_camera", [True, False])
def test_without_a_camera_nobody_asks_for_readings(has_camera: bool) -> None:
    node = PerceptionNode(PerceptionConfig(), has_camera=has_camera)
    assert (IMU in node.reads()) == has_camera
    assert TF_STATIC in node.reads()

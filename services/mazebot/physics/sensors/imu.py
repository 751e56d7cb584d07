"""An inertial measurement unit: gyroscope and accelerometer."""

from __future__ import annotations

import numpy as np

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import IMU_FRAME, Array
from mazebot.common.messages import messages as msg
from mazebot.physics.bodies.bodies import GRAVITY_M_S2, Bodies

_DRAWN_AT_ONCE = 64
"""Readings whose noise is drawn together: as many draws cost little more than one."""


class Imu:
    """Angular velocity and specific force at imu_link, in its axes, with white noise.

    The acceleration is the mean over the time since the last reading. At rest the accelerometer
    shows gravity, upwards. There is no estimate of orientation: its covariance begins with -1.

    The standard deviations are those of one reading; over the square root of the rate they are
    densities. At 120 Hz the defaults, 2e-4 rad/s and 1.7e-2 m/s2, are 1.83e-5 rad/s and
    1.55e-3 m/s2 per square root of a hertz. There is no bias and no random walk of one.
    """

    def __init__(
        self,
        bodies: Bodies,
        footprint_from_imu: Array,
        gyro_noise_rad_s: float,
        accelerometer_noise_m_s2: float,
        random: np.random.Generator,
    ) -> None:
        self._bodies = bodies
        self._com_from_imu = bodies.com_from(footprint_from_imu)
        self._random = random
        self._sigma = np.array([gyro_noise_rad_s] * 3 + [accelerometer_noise_m_s2] * 3)
        self._gyro_covariance = _diagonal(portable.square(gyro_noise_rad_s))
        self._accelerometer_covariance = _diagonal(portable.square(accelerometer_noise_m_s2))
        self._no_orientation = _diagonal(0.0)
        self._no_orientation[0] = -1.0
        self._velocity_m_s = bodies.motion_at(self._com_from_imu).velocity_m_s
        self._noise: list[list[float]] = []
        """Noise of the next readings, in reverse order."""

    def read(self, stamp_ns: int, elapsed_s: float) -> msg.Imu:
        """The reading now, `elapsed_s` after the last one."""
        map_from_imu, velocity, spin = self._bodies.motion_at(self._com_from_imu)
        (vx, vy, vz), (ux, uy, uz) = velocity, self._velocity_m_s
        self._velocity_m_s = velocity
        gx, gy, gz = map_from_imu.rotate_back(*spin)
        ax, ay, az = map_from_imu.rotate_back(
            (vx - ux) / elapsed_s, (vy - uy) / elapsed_s, (vz - uz) / elapsed_s + GRAVITY_M_S2
        )
        if not self._noise:
            drawn = (
                portable_kernels.standard_normal(self._random, (_DRAWN_AT_ONCE, 6)) * self._sigma
            )
            self._noise = drawn[::-1].tolist()
        noise = self._noise.pop()
        return msg.Imu(
            header=msg.header(stamp_ns, IMU_FRAME),
            orientation=msg.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=self._no_orientation,
            angular_velocity=msg.Vector3(gx + noise[0], gy + noise[1], gz + noise[2]),
            angular_velocity_covariance=self._gyro_covariance,
            linear_acceleration=msg.Vector3(ax + noise[3], ay + noise[4], az + noise[5]),
            linear_acceleration_covariance=self._accelerometer_covariance,
        )


def _diagonal(variance: float) -> Array:
    return np.ascontiguousarray((np.eye(3) * variance).reshape(9))

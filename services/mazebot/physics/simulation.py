"""One world with the robot in it: bodies, drive and sensors, advanced together."""

from __future__ import annotations

from collections.abc import Mapping

from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    IMU_FRAME,
    SCAN_FRAME,
    PlanarCovariance,
)
from mazebot.common.messages.documents import Contact, SimulationCheckpoint, World
from mazebot.common.node.node import random_generator
from mazebot.common.world.geometry import TriangleMesh
from mazebot.physics.bodies.bodies import Bodies
from mazebot.physics.bodies.robot_model import RobotModel
from mazebot.physics.camera.camera_noise import CameraNoise
from mazebot.physics.camera.image_hash import ImageHash
from mazebot.physics.config import STEPS_PER_SECOND, PhysicsConfig
from mazebot.physics.drive import Drive, DriveLimits
from mazebot.physics.sensors.contacts import ContactEvents
from mazebot.physics.sensors.imu import Imu
from mazebot.physics.sensors.lidar import Lidar, lidar_figures
from mazebot.physics.sensors.odometry import WheelOdometry
from mazebot.physics.state_hash import StateHash

STEP_S = 1.0 / STEPS_PER_SECOND


class Simulation:
    """The simulation of one loaded world."""

    def __init__(
        self,
        world: World,
        model: RobotModel,
        config: PhysicsConfig,
        meshes: Mapping[str, TriangleMesh] | None = None,
    ) -> None:
        """Raises ValueError, in one line, where the world cannot be built."""
        self.world = world
        self.meshes = meshes or {}
        self._model = model
        self._config = config
        self.watchdog_stops_before = 0
        """Watchdog stops before the last rebuild."""
        self._held = False
        self._build()

    def _build(self) -> None:
        config, model = self._config, self._model
        bodies = Bodies(self.world, model, config.wheel_torque_n_m, self.meshes)
        self.bodies = bodies
        self.state_hash = StateHash()
        self.image_hash = ImageHash()
        self.drive = Drive(drive_limits(config))
        if self._held:
            self.drive.hold()
        self.contacts = ContactEvents()
        self.odometry = WheelOdometry(
            config.wheel_separation_m,
            config.wheel_radius_m,
            self.wheel_angles_rad,
            config.wheel_noise_m_per_sqrt_m,
            random_generator(config.seed, "physics/odometry"),
        )
        self.imu = Imu(
            bodies,
            model.transform(BASE_FOOTPRINT_FRAME, IMU_FRAME),
            config.gyro_noise_rad_s,
            config.accelerometer_noise_m_s2,
            random_generator(config.seed, "physics/imu"),
        )
        self.lidar = Lidar(
            bodies,
            model.transform(BASE_FOOTPRINT_FRAME, SCAN_FRAME),
            lidar_figures(config),
            random_generator(config.seed, "physics/scan"),
        )
        self.camera_noise = CameraNoise(
            config.camera_noise,
            3 * config.camera_width_px * config.camera_height_px,
            random_generator(config.seed, "physics/camera"),
        )

    def hold(self) -> None:
        """Stop the robot and hold it at rest, whatever is commanded or rebuilt."""
        self._held = True
        self.drive.hold()

    def release(self) -> None:
        """Let the robot move again."""
        self._held = False
        self.drive.release()

    @property
    def watchdog_stops(self) -> int:
        """Times the velocity watchdog stopped the robot."""
        return self.watchdog_stops_before + self.drive.watchdog_stops

    @property
    def wheel_angles_rad(self) -> tuple[float, float]:
        """Encoder angles of the wheels, left and right. They include slip, while PyBullet turns a
        slipping wheel only by the distance that it rolls.
        """
        left, right = self.bodies.state.wheel_angles_rad
        rolls = 1.0 - self._config.wheel_slip
        return left / rolls, right / rolls

    @property
    def wheel_speeds_rad_s(self) -> tuple[float, float]:
        """Encoder speeds of the wheels, left and right."""
        left, right = self.bodies.state.wheel_speeds_rad_s
        rolls = 1.0 - self._config.wheel_slip
        return left / rolls, right / rolls

    def step(self, now_ns: int) -> list[Contact] | None:
        """Advance by one step to `now_ns`; returns the contacts that began.

        None: PyBullet had brought the robot or a moving body into a state that is not physical,
        and everything was rebuilt as at the start, without entities.
        """
        speeds = self.drive.step(now_ns, STEP_S)
        if speeds is not None:
            rolls = 1.0 - self._config.wheel_slip
            self.bodies.set_wheel_speeds(speeds[0] * rolls, speeds[1] * rolls)
        state = self.bodies.step()
        movers = self.bodies.mover_states
        if not (state.is_sane() and all(mover.is_sane() for mover in movers)):
            self.watchdog_stops_before = self.watchdog_stops
            self.bodies.close()
            self._build()
            self.state_hash.add(self.bodies.state, self.bodies.mover_states)
            return None
        self.state_hash.add(state, movers)
        touches = self.bodies.touches()
        return self.contacts.begun(touches, now_ns, STEP_S) if touches else []

    def restore(self, kept: SimulationCheckpoint) -> None:
        """Go on where another simulation of the same world was, the robot at rest. Entities must
        have been spawned before.
        """
        self.bodies.restore(kept.robot, kept.wheel_angles_rad, kept.movers)
        self.odometry.restore(
            self.wheel_angles_rad,
            kept.odom_from_base.se2(),
            PlanarCovariance(*kept.odom_covariance),
        )
        self.watchdog_stops_before = kept.watchdog_stops

    def restart_clock(self, now_ns: int) -> None:
        """Set the time from `now_ns` back to 0 and reset the hashes; nothing moves."""
        self.drive.restart_clock(now_ns)
        self.contacts.restart_clock(now_ns)
        self.state_hash = StateHash()
        self.image_hash = ImageHash()

    def close(self) -> None:
        """Remove the world. Calling it again does nothing."""
        self.bodies.close()


def drive_limits(config: PhysicsConfig) -> DriveLimits:
    """The drive limits of a configuration."""
    return DriveLimits(
        config.wheel_separation_m,
        config.wheel_radius_m,
        config.max_linear_speed_m_s,
        config.max_linear_acceleration_m_s2,
        config.max_angular_speed_rad_s,
        config.max_angular_acceleration_rad_s2,
        round(config.cmd_vel_timeout_s * 1e9),
        config.watchdog_linear_deceleration_m_s2,
        config.watchdog_angular_deceleration_rad_s2,
    )

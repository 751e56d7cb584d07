"""The simulation's configuration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from mazebot.common.config import ConfigError, ServiceConfig
from mazebot.common.files.root import ROOT
from mazebot.common.robot import waffle
from mazebot.physics.sensor_profiles import (
    CAMERA_PROFILES,
    FAR_M,
    SCAN_PROFILES,
    CameraProfile,
    ScanProfile,
    filled_in,
)

STEPS_PER_SECOND = 240
"""Physics steps in one second of simulation: PyBullet's own rate, for which its solver is tuned."""

_PROFILES: dict[str, Mapping[str, ScanProfile | CameraProfile]] = {
    "scan_profile": SCAN_PROFILES,
    "camera_profile": CAMERA_PROFILES,
}
_LDS01 = SCAN_PROFILES["lds01"]
_D435I = CAMERA_PROFILES["d435i"]


class PhysicsConfig(ServiceConfig):
    """The robot, its limits and its sensors. Defaults are a TurtleBot3 waffle's."""

    robot_model: str = Field(
        "turtlebot3_waffle",
        pattern=r"^[A-Za-z0-9_]+$",
        description="folder of the robot's model in models/; worlds' maps are made for a lidar "
        f"{waffle.LIDAR_HEIGHT_M:g} m above the floor",
    )
    wheel_separation_m: float = Field(
        waffle.WHEEL_SEPARATION_M,
        gt=0.0,
        le=2.0,
        description="distance of the wheels in drive and odometry",
    )
    wheel_radius_m: float = Field(
        waffle.WHEEL_RADIUS_M, gt=0.0, le=1.0, description="radius of a wheel in drive and odometry"
    )
    max_linear_speed_m_s: float = Field(
        waffle.MAX_LINEAR_M_S,
        gt=0.0,
        le=5.0,
        description="commands beyond it are clamped, in both directions",
    )
    max_linear_acceleration_m_s2: float = Field(
        waffle.MAX_LINEAR_ACCELERATION_M_S2,
        gt=0.0,
        le=10.0,
        description="when speeding up and when slowing down",
    )
    max_angular_speed_rad_s: float = Field(
        waffle.MAX_ANGULAR_RAD_S,
        gt=0.0,
        le=20.0,
        description="commands beyond it are clamped, in both directions",
    )
    max_angular_acceleration_rad_s2: float = Field(
        waffle.MAX_ANGULAR_ACCELERATION_RAD_S2,
        gt=0.0,
        le=50.0,
        description="when speeding up and when slowing down",
    )
    cmd_vel_timeout_s: float = Field(
        0.2,
        gt=0.0,
        le=10.0,
        description="the robot stops after this long without a velocity command",
    )
    watchdog_linear_deceleration_m_s2: float = Field(
        4.0, gt=0.0, le=10.0, description="deceleration of the stop after no command"
    )
    watchdog_angular_deceleration_rad_s2: float = Field(
        14.0, gt=0.0, le=50.0, description="deceleration of the stop after no command"
    )
    wheel_torque_n_m: float = Field(
        1.0, gt=0.0, le=20.0, description="highest torque of a wheel's motor"
    )
    wheel_slip: float = Field(
        0.0,
        ge=0.0,
        le=0.9,
        description="share of a wheel's travel that odometry counts but the robot loses to slip; "
        "0: only the slip of PyBullet's contacts",
    )
    wheel_noise_m_per_sqrt_m: float = Field(
        0.0,
        ge=0.0,
        le=0.2,
        description="standard deviation of a wheel's measured travel after one metre; 0: only slip",
    )
    battery_capacity_ah: float = Field(
        1.8, gt=0.0, le=1000.0, description="charge of the full battery; TurtleBot3's: 11.1 V"
    )
    battery_current_a: float = Field(
        0.9,
        ge=0.0,
        le=1000.0,
        description="current that the robot takes: by default the battery lasts for 2 h, as is "
        "expected of a TurtleBot3 waffle. An empty battery does not stop the robot",
    )
    battery_charge_at_start: float = Field(
        1.0,
        ge=0.0,
        le=1.0,
        description="share of the capacity at time 0, and so after each reset",
    )
    gyro_noise_rad_s: float = Field(
        2e-4, ge=0.0, le=1.0, description="standard deviation of each axis of the gyroscope"
    )
    accelerometer_noise_m_s2: float = Field(
        1.7e-2, ge=0.0, le=10.0, description="standard deviation of each axis of the accelerometer"
    )
    scan_profile: Literal["lds01", "lds02", "gazebo"] = Field(
        "lds01", description="lidar model: defaults of the scan_ fields"
    )
    scan_rate_hz: float = Field(
        _LDS01.scan_rate_hz, gt=0.0, description="scans a second; must divide 240"
    )
    scan_samples: int = Field(_LDS01.scan_samples, ge=4, le=10_000, description="rays of a scan")
    scan_range_min_m: float = Field(
        _LDS01.scan_range_min_m, ge=0.0, le=1.0, description="nearer returns are published as -inf"
    )
    scan_range_max_m: float = Field(
        _LDS01.scan_range_max_m,
        gt=1.0,
        le=100.0,
        description="farther returns are published as inf",
    )
    scan_noise_m: float = Field(
        _LDS01.scan_noise_m, ge=0.0, le=1.0, description="standard deviation of a range, at least"
    )
    scan_noise_share: float = Field(
        _LDS01.scan_noise_share,
        ge=0.0,
        le=0.2,
        description="standard deviation of a range as a share of it, where that is more",
    )
    scan_dropout: float = Field(
        0.0,
        ge=0.0,
        le=1.0,
        description="share of the rays that are lost at random: published as inf, as if nothing "
        "were in range",
    )
    scan_resolution_m: float = Field(
        _LDS01.scan_resolution_m,
        ge=0.0,
        le=0.1,
        description="ranges are whole multiples of it; 0: not rounded",
    )
    camera_enabled: bool = Field(True, description="render and publish images")
    renderer: Literal["auto", "gl", "cpu", "tiny", "none"] = Field(
        "auto",
        description=(
            "auto: gl where there is a GPU, else cpu; gl: OpenGL, no display; "
            "cpu: on all cores; tiny: PyBullet's TinyRenderer"
        ),
    )
    camera_profile: Literal["d435i", "waffle", "small"] = Field(
        "d435i", description="camera model: defaults of the camera_ fields"
    )
    camera_rate_hz: float = Field(
        _D435I.camera_rate_hz, gt=0.0, description="images a second; must divide 240"
    )
    camera_width_px: int = Field(
        _D435I.camera_width_px, ge=16, le=4096, description="width of an image"
    )
    camera_height_px: int = Field(
        _D435I.camera_height_px, ge=16, le=4096, description="height of an image"
    )
    camera_horizontal_fov_rad: float = Field(
        _D435I.camera_horizontal_fov_rad, gt=0.1, lt=3.0, description="horizontal field of view"
    )
    camera_noise: float = Field(
        _D435I.camera_noise,
        ge=0.0,
        le=1.0,
        description="standard deviation of a colour as a share of full scale; 0: none",
    )
    camera_depth_enabled: bool = Field(True, description="also publish depth images")
    camera_depth_min_m: float = Field(
        _D435I.camera_depth_min_m, ge=0.0, le=10.0, description="nearer depths are published as NaN"
    )
    camera_depth_max_m: float = Field(
        _D435I.camera_depth_max_m,
        gt=0.0,
        le=FAR_M,
        description="farther depths are published as NaN",
    )
    camera_compressed_enabled: bool = Field(False, description="also publish images as JPEG")
    camera_jpeg_quality: int = Field(80, ge=1, le=100, description="quality of the JPEG images")

    @model_validator(mode="before")
    @classmethod
    def _fill_in_profiles(cls, values: Any) -> Any:
        return filled_in(values, cls.model_fields, _PROFILES)

    @field_validator("scan_rate_hz", "camera_rate_hz")
    @classmethod
    def _divides_the_step_rate(cls, rate_hz: float) -> float:
        if rate_hz > STEPS_PER_SECOND or (STEPS_PER_SECOND / rate_hz) % 1.0 != 0.0:
            raise ValueError(f"must divide {STEPS_PER_SECOND} steps a second")
        return rate_hz

    @model_validator(mode="after")
    def _has_depths(self) -> PhysicsConfig:
        self._check_order("camera_depth_min_m", "camera_depth_max_m", apart=True)
        return self

    def robot_urdf(self) -> str:
        """The text of the robot's URDF.

        Raises ConfigError where there is no such model.
        """
        path = ROOT / "models" / self.robot_model / "model.urdf"
        try:
            return path.read_text(encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"physics: robot_model: {path}: {error.strerror}") from error


def steps_per_period(rate_hz: float) -> int:
    """Steps between two messages of a rate that divides the step rate."""
    return round(STEPS_PER_SECOND / rate_hz)


def time_of_step_ns(step: int) -> int:
    """Simulation time at the end of a step; exact, so that no rounding adds up."""
    return step * 1_000_000_000 // STEPS_PER_SECOND

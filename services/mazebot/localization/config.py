"""Configuration of localisation. Names are AMCL's; lengths are in metres, angles in radians."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.config import ServiceConfig
from mazebot.localization.params import LocalizationParams

STEP_PERIOD_NS = 50_000_000
"""20 Hz: the node's period, at which `map -> odom` is published."""


class LocalizationConfig(LocalizationParams, ServiceConfig):
    """The particle filter and its initial pose."""

    initialize_at_start_pose: bool = Field(
        True,
        description="start at the world's start pose; false: search the whole map, unless "
        "set_initial_pose is true",
    )
    initial_pose_std_m: float = Field(
        0.05, gt=0, description="standard deviation of the initial pose along x and along y"
    )
    initial_pose_std_rad: float = Field(
        0.05, gt=0, description="standard deviation of the initial pose's yaw"
    )
    odometry_drift_ratio: float = Field(
        0.03,
        ge=0,
        description="standard deviation of odometry's error for each metre driven, in m and in rad",
    )

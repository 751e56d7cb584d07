"""Configuration of perception."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, Field

from mazebot.common.config import ServiceConfig
from mazebot.perception.depth_scan import DepthScanParams


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError("must be odd")
    return value


Window = Annotated[int, AfterValidator(_odd)]


class PerceptionConfig(ServiceConfig):
    """Marker detection in images, and the accuracy of marker poses."""

    threshold_window_px: Window = Field(
        13,
        ge=3,
        le=255,
        description="side of the window of the adaptive threshold; odd",
    )
    threshold_contrast: float = Field(
        25.0,
        gt=0.0,
        lt=255.0,
        description="grey levels by which black is darker than its surroundings; markers whose "
        "black and white are less than three times this apart may be missed",
    )
    second_pass: bool = Field(
        True,
        description="run a second pass, with the second window and contrast, if no marker of the "
        "world is found",
    )
    second_pass_every: int = Field(
        3,
        ge=1,
        le=100,
        description="number of images between a second pass that found nothing and the next one",
    )
    second_window_px: Window = Field(
        23, ge=3, le=255, description="side of the second pass's window; odd"
    )
    second_contrast: float = Field(
        7.0, gt=0.0, lt=255.0, description="grey levels of the second pass"
    )
    min_clarity: float = Field(
        6.0,
        ge=0.0,
        le=100.0,
        description="least ratio of the difference between a marker's white and black modules to "
        "the scatter about them; anything below is treated as texture; 0: not checked",
    )
    max_range_m: float = Field(
        6.0, gt=0.0, le=100.0, description="distance up to which a marker must be found"
    )
    max_view_angle_rad: float = Field(
        math.radians(65.0),
        ge=0.0,
        lt=math.pi / 2,
        description="angle to a marker's normal up to which it must be found at that distance",
    )
    corner_sigma_px: float = Field(
        0.1, gt=0.0, description="least standard deviation of a corner's pixel coordinates"
    )
    min_ambiguous_score: float = Field(
        0.01,
        ge=0.0,
        le=0.5,
        description="least share of the likelihood at which a marker's second pose is published",
    )
    transform_tolerance_s: float = Field(
        0.1,
        ge=0.0,
        description="greatest time between an image and the nearest odometry",
    )
    depth_scan: DepthScanParams = DepthScanParams()

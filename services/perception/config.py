"""Configuration of perception."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, Field

from services.common.config import ServiceConfig


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError("must be odd")
    return value


class PerceptionConfig(ServiceConfig):
    """How markers are found in pictures, and what their poses are worth."""

    threshold_window_px: Annotated[int, AfterValidator(_odd)] = Field(
        13,
        ge=3,
        le=255,
        description="side of the square a pixel's brightness is compared with; odd",
    )
    threshold_contrast: float = Field(
        25.0,
        gt=0.0,
        lt=255.0,
        description="grey levels by which black is darker than its surroundings; markers whose "
        "black and white are less than three times this apart may be missed",
    )
    max_range_m: float = Field(
        6.0, gt=0.0, le=100.0, description="distance from which a marker must still be found"
    )
    max_view_angle_rad: float = Field(
        math.radians(65.0),
        ge=0.0,
        lt=math.pi / 2,
        description="angle to a marker's normal from which it must still be found at that distance",
    )
    corner_sigma_px: float = Field(
        0.1, gt=0.0, description="least standard deviation of a corner's pixel coordinates"
    )
    min_ambiguous_score: float = Field(
        0.01,
        ge=0.0,
        le=0.5,
        description="share of the likelihood from which a marker's second pose is published too",
    )
    transform_tolerance_s: float = Field(
        0.1,
        ge=0.0,
        description="how much older or newer than a picture the nearest odometry may be",
    )

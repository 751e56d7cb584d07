"""Configuration of mapping. Names are slam_toolbox's; lengths are in metres, angles in radians."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mazebot.common.config import OptionalPath, ServiceConfig
from mazebot.common.messages.documents import Finite
from mazebot.mapping.params import SlamParams

STEP_PERIOD_NS = 50_000_000
"""20 Hz: the node's period, at which `map -> odom` is published."""


class MappingConfig(SlamParams, ServiceConfig):
    """The map's making, and what it begins with."""

    mode: Literal["mapping", "localization"] = Field(
        "mapping",
        description="mapping: the map grows; localization: the loaded graph stays as it is",
    )
    map_file_name: OptionalPath = Field(
        None, description="a saved graph (*.pose_graph.json) to start from; none: an empty map"
    )
    map_start_pose: tuple[Finite, Finite, Finite] | None = Field(
        None, description="x, y (m) and yaw (rad) of the robot in the map at the start; "
        "none: the world's start pose, and what odometry has measured since"
    )  # fmt: skip

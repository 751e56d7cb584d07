"""The settings of the global and of the local costmap."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.config import Params
from mazebot.navigation.costmap.inflation_layer import InflationParams
from mazebot.navigation.costmap.obstacle_layer import ObstacleParams


class CostmapParams(Params):
    """Names as in Nav2's costmaps."""

    footprint_padding: float = Field(
        0.01, ge=0, description="m; the footprint is larger than the robot by this on every side"
    )
    obstacle_layer: ObstacleParams = ObstacleParams()
    inflation_layer: InflationParams = InflationParams()


class LocalCostmapParams(CostmapParams):
    """The window that moves with the robot."""

    width: float = Field(3.0, gt=0, le=20, description="m; length of the window along x")
    height: float = Field(3.0, gt=0, le=20, description="m; length of the window along y")

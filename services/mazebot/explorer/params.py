"""Parameters of the exploration, under explore_lite's names where it has one."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.world.costmap import INSCRIBED_RADIUS_M, ROBOT_RADIUS_M, START_TOLERANCE_M

Policy = Literal["tour", "nearest", "gain"]


class ExplorerParams(Params):
    """What counts as a frontier, and which one is next."""

    planner_frequency: float = Field(
        1.0, gt=0, le=20, description="Hz of choosing again as the map grows"
    )
    progress_timeout: float = Field(
        20.0, gt=0, description="s without coming closer to a view point: it is set aside"
    )
    min_frontier_size: float = Field(
        0.3, ge=0, description="m; frontiers whose border is shorter are ignored"
    )
    choice: Policy = Field(
        "tour",
        description="tour: the first view point of the shortest tour through all and home; "
        "nearest: to the nearest frontier, to its end; gain: explore_lite's cost",
    )
    potential_scale: float = Field(
        1.0, ge=0, description="of choice gain: weight of the path length in m"
    )
    gain_scale: float = Field(
        1.0, ge=0, description="of choice gain: weight of the frontier's size in m"
    )
    orientation_scale: float = Field(
        0.0, ge=0, description="not used, as in explore_lite: the lidar sees all around"
    )
    hysteresis: float = Field(
        0.2,
        ge=0,
        description="another view point is chosen only if it saves this share of the path to the "
        "current one",
    )
    open_distance: float = Field(
        3.5,
        ge=0,
        description="m; open floor farther than this from all that the lidar has seen is not "
        "explored; before it has seen anything, twice as far from the start; 0: no limit",
    )
    max_distance: float = Field(
        0.0, ge=0, description="m from the start; what is farther is not explored; 0: no limit"
    )
    max_area: float = Field(
        0.0, ge=0, description="m2 of floor seen after which the exploration ends; 0: no limit"
    )
    time_allowance: float = Field(
        0.0, ge=0, description="s of exploring after which it ends; 0: no limit"
    )
    return_to_init: bool = Field(True, description="drive back to the start pose at the end")
    visualize: bool = Field(True, description="publish the frontiers as markers")
    robot_radius: float = Field(
        ROBOT_RADIUS_M, gt=0, description="m; the floor that the robot reaches is for this circle"
    )
    inscribed_radius: float = Field(
        INSCRIBED_RADIUS_M,
        gt=0,
        description="m; half of the narrowest gap through which it looks for more floor, once the "
        "floor for its circle is seen; robot_radius: none is narrower",
    )
    view_clearance: float = Field(
        0.3, gt=0, description="m; distance of view points to obstacles, where there is room"
    )
    max_range: float = Field(3.5, gt=0.5, description="m; how far the lidar sees")
    start_tolerance: float = Field(
        START_TOLERANCE_M,
        ge=0,
        description="m; a robot in inflated cells counts as on the nearest free one within this",
    )

"""Configuration of navigation: Nav2's nodes and plugins, with Nav2's names. Every length is in
metres, every angle in radians.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mazebot.common.config import Params, ServiceConfig
from mazebot.navigation.behavior.bt_navigator import BtNavigatorParams, WaypointFollowerParams
from mazebot.navigation.behavior.docking.docking import DockingParams
from mazebot.navigation.behavior.motions.motion import BehaviorServerParams
from mazebot.navigation.control.safety.back_off import BackOffParams
from mazebot.navigation.control.safety.collision_monitor import CollisionMonitorParams
from mazebot.navigation.control.safety.velocity_smoother import VelocitySmootherParams
from mazebot.navigation.control.tracking import TrackerParams
from mazebot.navigation.control.yielding.giving_way import GivingWayParams
from mazebot.navigation.costmap.params import CostmapParams, LocalCostmapParams
from mazebot.navigation.robot.controller_server import ControllerServerParams
from mazebot.navigation.robot.planner_server import PlannerServerParams, SmootherServerParams

CONTROL_PERIOD_NS = 50_000_000
"""20 Hz, Nav2's controller_frequency: the node's period."""


class MaskServerParams(Params):
    """Names as in Nav2's map server."""

    yaml_filename: str = Field(
        "", description="map_server YAML file of the mask; empty: only the world's zones"
    )


class FilterInfoServerParams(Params):
    """What the values of the speed mask mean; names as in Nav2."""

    type: Literal[1, 2] = Field(
        1, description="what the mask gives: 1 percent of the highest speed, 2 m/s"
    )
    base: float = Field(100.0, description="limit = base + multiplier * value of the mask")
    multiplier: float = Field(-1.0, description="see base")


class NavigationConfig(ServiceConfig):
    """Costmaps, planning, control and recovery, in sections named as Nav2's nodes and plugins."""

    planner_server: PlannerServerParams = PlannerServerParams()
    smoother_server: SmootherServerParams = SmootherServerParams()
    controller_server: ControllerServerParams = ControllerServerParams()
    velocity_smoother: VelocitySmootherParams = VelocitySmootherParams()
    collision_monitor: CollisionMonitorParams = CollisionMonitorParams()
    global_costmap: CostmapParams = CostmapParams()
    local_costmap: LocalCostmapParams = LocalCostmapParams()
    keepout_filter_mask_server: MaskServerParams = MaskServerParams()
    speed_filter_mask_server: MaskServerParams = MaskServerParams()
    speed_costmap_filter_info_server: FilterInfoServerParams = FilterInfoServerParams()
    behavior_server: BehaviorServerParams = BehaviorServerParams()
    bt_navigator: BtNavigatorParams = BtNavigatorParams()
    waypoint_follower: WaypointFollowerParams = WaypointFollowerParams()
    docking_server: DockingParams = DockingParams()
    tracker: TrackerParams = TrackerParams()
    back_off: BackOffParams = BackOffParams()
    giving_way: GivingWayParams = GivingWayParams()

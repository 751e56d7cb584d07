"""Puts navigation together for one map: robot, behaviors, tracker, velocity smoother and collision
monitor.
"""

from __future__ import annotations

import numpy as np

from mazebot.common.world.costmap import Cells
from mazebot.navigation.behavior.bt_navigator import BtNavigator, BtNavigatorParams
from mazebot.navigation.behavior.motions.search_motion import SearchMotionParams
from mazebot.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from mazebot.navigation.control.controllers import make_controller
from mazebot.navigation.control.safety.collision_monitor import (
    CollisionMonitor,
    CollisionMonitorParams,
)
from mazebot.navigation.control.safety.velocity_smoother import VelocitySmoother
from mazebot.navigation.control.tracking import ObstacleTracker
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.layered_costmap import GridFrame, LayeredCostmap, LocalCostmap
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.drive import Drive
from mazebot.navigation.planners import make_planner
from mazebot.navigation.robot.controller_server import ControllerServer
from mazebot.navigation.robot.planner_server import PlannerServer
from mazebot.navigation.robot.robot_context import RobotContext


def made_drive(
    config: NavigationConfig,
    frame: GridFrame,
    cells: Cells,
    random: np.random.Generator,
    zones: Zones | None = None,
) -> Drive:
    """Navigation for a map.

    Args:
        config: its configuration.
        frame: position of the cells.
        cells: (rows, columns) int8 occupancy, 100 occupied, -1 unknown.
        random: the controllers' source of random numbers.
        zones: keepout zones and speed limits on the same grid; None: there are none.

    Raises ConfigError where a controller or a tree that is named cannot be used.
    """
    footprint = WAFFLE.padded(config.footprint_padding)
    costmap = LayeredCostmap(frame, cells, config.inflation(), config.obstacle(), footprint=WAFFLE)
    if zones is not None:
        costmap.set_keepout(zones.costs(costmap.master.inscribed_radius_m))
    local = LocalCostmap(
        frame.resolution_m, config.inflation(), config.obstacle(),
        (config.local_costmap_size, config.local_costmap_size), WAFFLE,
    )  # fmt: skip
    planner = config.planner_params(frame.resolution_m, footprint)
    planners = {
        name: make_planner(name, planner)
        for name in dict.fromkeys((config.planner, "any_angle", "a_star"))
    }
    controllers = {
        name: make_controller(name, config.controller_params_of(name), config.robot(), random)
        for name in dict.fromkeys((config.controller, "mppi", "regulated_pure_pursuit"))
    }
    robot = RobotContext(
        footprint, costmap, local,
        PlannerServer(config.planner_server_params(footprint), costmap, planners, zones),
        ControllerServer(config.controller_server_params(), controllers),
    )  # fmt: skip
    params = BtNavigatorParams(
        localization_tolerance_s=config.localization_tolerance,
        control_period_s=CONTROL_PERIOD_NS * 1e-9,
    )
    return Drive(
        robot, BtNavigator(params, robot), ObstacleTracker(config.tracker),
        VelocitySmoother(config.smoother_params()),
        CollisionMonitor(
            CollisionMonitorParams(source_timeout_s={"scan": config.sensor_timeout}), WAFFLE
        ),
        SearchMotionParams(control_period_s=CONTROL_PERIOD_NS * 1e-9), cells,
        config.sensor_timeout, config.obstacle_static_margin,
    )  # fmt: skip

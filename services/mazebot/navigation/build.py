"""Puts navigation together for one map: robot, behaviors, tracker, velocity smoother and collision
monitor.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from mazebot.common.world.costmap import Cells
from mazebot.navigation.behavior.bt_navigator import BtNavigator, NavigatorParams
from mazebot.navigation.behavior.motions.search_motion import SearchMotionParams
from mazebot.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from mazebot.navigation.control.controller import Controller, Robot
from mazebot.navigation.control.controllers import CONTROLLERS, make_controller
from mazebot.navigation.control.safety.back_off import BackOff
from mazebot.navigation.control.safety.bumps import Bumps
from mazebot.navigation.control.safety.collision_monitor import CollisionMonitor
from mazebot.navigation.control.safety.velocity_smoother import VelocitySmoother
from mazebot.navigation.control.tracking import ObstacleTracker
from mazebot.navigation.control.yielding.giving_way import GivingWay
from mazebot.navigation.control.yielding.newcomers import Newcomers
from mazebot.navigation.costmap.footprint import WAFFLE, Footprint
from mazebot.navigation.costmap.layered_costmap import GridFrame, LayeredCostmap, LocalCostmap
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.drive import DepthSources, Drive
from mazebot.navigation.own_class import OwnController
from mazebot.navigation.planners import make_planner
from mazebot.navigation.planning.interface import PlannerParams
from mazebot.navigation.robot.controller_server import ControllerServer
from mazebot.navigation.robot.planner_server import PlannerServer
from mazebot.navigation.robot.robot_context import RobotContext, Told

_PERIOD_S = CONTROL_PERIOD_NS * 1e-9


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
    costmap = LayeredCostmap(
        frame, cells, config.global_costmap.inflation_layer, config.global_costmap.obstacle_layer,
        footprint=WAFFLE,
    )  # fmt: skip
    if zones is not None:
        costmap.set_keepout(zones.costs(costmap.master.inscribed_radius_m))
    settings = config.local_costmap
    local = LocalCostmap(
        frame.resolution_m, settings.inflation_layer, settings.obstacle_layer,
        (settings.width, settings.height), WAFFLE,
    )  # fmt: skip
    server, period_s = config.controller_server, _PERIOD_S
    controllers = _made_controllers(config, random)
    robot = RobotContext(
        WAFFLE.padded(settings.footprint_padding), costmap, local,
        made_planner_server(config, costmap, zones),
        ControllerServer(server, controllers, period_s),
        told=Told(config.collision_monitor.enabled),
    )  # fmt: skip
    params = NavigatorParams(
        config.bt_navigator, config.waypoint_follower, config.behavior_server,
        config.docking_server,
    )  # fmt: skip
    return Drive(
        robot, BtNavigator(params, robot), ObstacleTracker(config.tracker),
        VelocitySmoother(config.velocity_smoother, server),
        CollisionMonitor(config.collision_monitor, WAFFLE),
        SearchMotionParams(control_period_s=period_s), cells, server.sensor_timeout,
        config.global_costmap.obstacle_layer.static_margin,
        _depth_sources(config),
        BackOff(config.back_off, WAFFLE), Bumps(WAFFLE),
        GivingWay(config.giving_way, WAFFLE), Newcomers(config.tracker),
    )  # fmt: skip


def reconfigure(
    drive: Drive, before: NavigationConfig, config: NavigationConfig, random: np.random.Generator
) -> None:
    """Drive on with other parameters of the controller server, the velocity smoother and the
    collision monitor, and begin behaviours and docking with theirs. What has the same parameters as
    before goes on as it is.

    Raises ConfigError, and changes nothing, where a controller that is named cannot be used.
    """
    server, robot = config.controller_server, drive.robot
    kept = {
        name: one
        for name, one in robot.controller_server.controllers.items()
        if server.params_of(name) == before.controller_server.params_of(name)
        and server.limits() == before.controller_server.limits()
    }
    robot.controller_server.reconfigure(server, _made_controllers(config, random, kept))
    drive.navigator.reconfigure(config.behavior_server, config.docking_server)
    smoother = VelocitySmoother(config.velocity_smoother, server)
    smoother.reset(drive.smoother.last)
    drive.smoother = smoother
    if config.collision_monitor != before.collision_monitor:
        drive.monitor = CollisionMonitor(config.collision_monitor, WAFFLE)
    drive.sensor_timeout_s = server.sensor_timeout
    drive.depth_sources = _depth_sources(config)


def _made_controllers(
    config: NavigationConfig,
    random: np.random.Generator,
    kept: Mapping[str, Controller] = MappingProxyType({}),
) -> dict[str, Controller]:
    """The controllers by name: those that are kept, and new ones."""
    server = config.controller_server
    made = Robot(server.limits(), control_period_s=_PERIOD_S)
    return {
        name: kept[name] if name in kept else _checked_controller(
            name, make_controller(name, server.params_of(name), made, random)
        )
        for name in dict.fromkeys((server.controller, "mppi", "regulated_pure_pursuit"))
    }  # fmt: skip


def _depth_sources(config: NavigationConfig) -> DepthSources:
    return DepthSources(*(
        "depth" in params.observation_sources
        for params in (
            config.local_costmap.obstacle_layer, config.global_costmap.obstacle_layer,
            config.collision_monitor,
        )
    ))  # fmt: skip


def _checked_controller(name: str, controller: Controller) -> Controller:
    """A controller, whose calls are checked if it is a user's own."""
    return controller if name in CONTROLLERS else OwnController(name, controller)


def made_planner_server(
    config: NavigationConfig, costmap: LayeredCostmap, zones: Zones | None
) -> PlannerServer:
    """The planners on a costmap. Raises ConfigError where one that is named cannot be used."""
    footprint = WAFFLE.padded(config.global_costmap.footprint_padding)
    params = planner_params(config, costmap.frame.resolution_m, footprint)
    planners = {
        name: make_planner(name, params)
        for name in dict.fromkeys((config.planner_server.planner, "any_angle", "a_star"))
    }
    return PlannerServer(
        config.planner_server, config.smoother_server, footprint, costmap, planners, zones
    )


def planner_params(
    config: NavigationConfig, map_resolution_m: float, footprint: Footprint
) -> PlannerParams:
    """What the planners on a map are made with; paths are as fine as its cells."""
    return PlannerParams(
        config.planner_server.GridBased, map_resolution_m,
        config.smoother_server.smoothing_iterations, footprint=footprint,
    )  # fmt: skip

"""Puts navigation together for one map: robot, behaviours, tracker and collision monitor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from services.common.frames import SE2, Array
from services.common.node import messages as msg
from services.common.world.costmap import Cells
from services.navigation.behavior.bt_navigator import BtNavigator, BtNavigatorParams
from services.navigation.behavior.context import MarkerPose
from services.navigation.behavior.docking import DockingParams
from services.navigation.behavior.search_motion import SearchMotionParams
from services.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from services.navigation.control.collision_monitor import (
    Action,
    CollisionMonitor,
    CollisionMonitorParams,
)
from services.navigation.control.controllers import make_controller
from services.navigation.control.tracking import ObstacleTracker
from services.navigation.costmap.footprint import WAFFLE
from services.navigation.costmap.layered_costmap import GridFrame, LayeredCostmap, LocalCostmap
from services.navigation.messages import marker_pose_in_base
from services.navigation.planners import make_planner
from services.navigation.robot import RobotContext

State = Literal["planning", "controlling", "recovering"]


@dataclass
class Drive:
    """Everything that drives in one map."""

    robot: RobotContext
    navigator: BtNavigator
    tracker: ObstacleTracker
    monitor: CollisionMonitor
    docking: DockingParams
    search: SearchMotionParams
    cells: Cells
    monitor_told: tuple[Action, str] = (Action.DO_NOTHING, "")
    """Action and polygon of the monitor's state last published."""

    def state(self) -> State:
        """What the task does in this step."""
        if self.robot.controlled:
            return "controlling"
        return "planning" if self.robot.command is None else "recovering"

    def see_markers(
        self, stamp_ns: int, seen: msg.Detection3DArray, base_from_camera: Array, odom: SE2
    ) -> None:
        """Keep sightings of markers, by id; the likelier of two solutions."""
        for detection in seen.detections:
            if not detection.results:
                continue
            best = max(detection.results, key=lambda result: float(result.hypothesis.score))
            name = best.hypothesis.class_id
            camera_from_marker = msg.matrix_from_pose(best.pose.pose)
            sighting = marker_pose_in_base(base_from_camera, camera_from_marker)
            self.robot.markers[name] = MarkerPose(stamp_ns, sighting, odom)


def made_drive(
    config: NavigationConfig, frame: GridFrame, cells: Cells, random: np.random.Generator
) -> Drive:
    """Navigation for a map.

    Args:
        config: its configuration.
        frame: position of the cells.
        cells: (rows, columns) int8 occupancy, 100 occupied, -1 unknown.
        random: the controllers' source of random numbers.

    Raises ConfigError where a controller or a tree that is named cannot be used.
    """
    footprint = WAFFLE.padded(config.footprint_padding)
    costmap = LayeredCostmap(frame, cells, config.inflation(), config.obstacle(), footprint=WAFFLE)
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
    robot = RobotContext(config.robot_params(footprint), costmap, local, planners, controllers)
    params = BtNavigatorParams(
        localization_tolerance_s=config.localization_tolerance,
        control_period_s=CONTROL_PERIOD_NS * 1e-9,
    )
    return Drive(
        robot, BtNavigator(params, robot), ObstacleTracker(config.tracker),
        CollisionMonitor(
            CollisionMonitorParams(source_timeout_s={"scan": config.sensor_timeout}), WAFFLE
        ),
        params.docking, SearchMotionParams(control_period_s=CONTROL_PERIOD_NS * 1e-9), cells,
    )  # fmt: skip

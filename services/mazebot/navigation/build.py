"""Puts navigation together for one map: robot, behaviours, tracker, velocity smoother and collision
monitor.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.world.costmap import Cells, Clearance
from mazebot.common.world.grids import distance_cells
from mazebot.navigation.behavior.bt_navigator import BtNavigator, BtNavigatorParams
from mazebot.navigation.behavior.context import MarkerPose, planar_marker
from mazebot.navigation.behavior.docking.docking import DockingParams
from mazebot.navigation.behavior.motions.search_motion import SearchMotionParams
from mazebot.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from mazebot.navigation.control.controllers import make_controller
from mazebot.navigation.control.mppi.batch_pace import BatchPace
from mazebot.navigation.control.safety.collision_monitor import (
    Action,
    CollisionMonitor,
    CollisionMonitorParams,
)
from mazebot.navigation.control.safety.velocity_smoother import VelocitySmoother
from mazebot.navigation.control.tracking import ObstacleTracker
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.layered_costmap import GridFrame, LayeredCostmap, LocalCostmap
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.planners import make_planner
from mazebot.navigation.robot import RobotContext

State = Literal["planning", "controlling", "recovering"]


@dataclass
class Drive:
    """Everything that drives in one map."""

    robot: RobotContext
    navigator: BtNavigator
    tracker: ObstacleTracker
    smoother: VelocitySmoother
    monitor: CollisionMonitor
    docking: DockingParams
    search: SearchMotionParams
    cells: Cells
    pace: BatchPace = field(default_factory=lambda: BatchPace(CONTROL_PERIOD_NS))
    known_m: Clearance | None = None
    """(rows, columns) distance from walls and from unknown cells of a map that grows; None: it does
    not.
    """
    monitor_told: tuple[Action, str] = (Action.DO_NOTHING, "")
    """Action and polygon of the monitor's state last published."""

    def state(self) -> State:
        """What the task does in this step."""
        if self.robot.controlled:
            return "controlling"
        return "planning" if self.robot.command is None else "recovering"

    def take_map(
        self, frame: GridFrame, cells: Cells, margin_m: float, zones: Zones | None
    ) -> None:
        """Drive on in a map that has grown or changed."""
        self.robot.take_map(frame, cells, margin_m, zones)
        self.cells = cells
        # What stands where the map shows nothing yet is no obstacle that moves.
        unknown_m = distance_cells(np.asarray(cells < 0)) * frame.resolution_m
        static = self.robot.costmap.static
        self.known_m = np.minimum(static.distance_m, unknown_m).astype(np.float32)

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
            base_from_marker = portable.product(base_from_camera, camera_from_marker)
            with suppress(ValueError):
                # One that lies flat is no dock.
                sighting = planar_marker(base_from_marker)
                self.robot.markers[name] = MarkerPose(stamp_ns, sighting, odom)


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
        config.robot_params(footprint), costmap, local, planners, controllers, zones
    )
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
        params.docking, SearchMotionParams(control_period_s=CONTROL_PERIOD_NS * 1e-9), cells,
    )  # fmt: skip

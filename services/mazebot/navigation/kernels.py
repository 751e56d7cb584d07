"""Compiles navigation's kernels before the robot moves."""

from __future__ import annotations

import functools
import logging
import math
from dataclasses import replace

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.common.node.node import random_generator
from mazebot.common.robot import frozen_scans
from mazebot.navigation.behavior.actions import NavigateToPose
from mazebot.navigation.behavior.bt_navigator import without_own_nodes
from mazebot.navigation.behavior.context import PathCheck
from mazebot.navigation.behavior.motions.search_motion import SearchMotion
from mazebot.navigation.build import made_drive
from mazebot.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.controller import Robot
from mazebot.navigation.control.controllers import CONTROLLERS
from mazebot.navigation.control.mppi.mppi_kernels import compile_mppi_kernels
from mazebot.navigation.control.ray_evidence import RayMemory, Rays
from mazebot.navigation.control.safety.collision_kernels import compile_collision_kernels
from mazebot.navigation.control.safety.collision_monitor import SourcePoints, moved_points
from mazebot.navigation.control.yielding.warm_up import compile_yielding_kernels
from mazebot.navigation.costmap.layered_costmap import frame_of, scan_points
from mazebot.navigation.costmap.obstacle_layer import denoised_ranges
from mazebot.navigation.drive import Drive
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planners import PLANNERS
from mazebot.navigation.planning.warm_up import run_planning_kernels
from mazebot.navigation.robot.hidden import hidden_from
from mazebot.navigation.robot.view import View

_LOG = logging.getLogger("navigation")
_NOWHERE = SE2(0.0, 0.0, 0.0)


def check_parts(config: NavigationConfig) -> None:
    """Raises ConfigError where a controller, planner or tree that is named cannot be used."""
    _in_a_room(config)


def compile_kernels(config: NavigationConfig) -> None:
    """Run all parts once in a small room, so that nothing is compiled while the robot moves."""
    _compile_whatever_the_configuration()
    _check_own_classes(config)
    drive = _in_a_room(_with_built_in_classes(config))
    level = _LOG.level
    _LOG.setLevel(logging.CRITICAL)
    try:
        _drive(drive)
    except NavigationError:
        # The robot is too large for the room; everything else is compiled.
        pass
    finally:
        _LOG.setLevel(level)


@functools.cache
def _compile_whatever_the_configuration() -> None:
    """What is compiled once stays so: a second navigation in the same process starts at once."""
    frozen_scans.compile_kernels()
    compile_collision_kernels()
    run_planning_kernels()
    config = NavigationConfig()
    costmap = _in_a_room(config).robot.costmap.static
    compile_mppi_kernels(costmap, SE2(1.0, 1.0, 0.0), Robot(config.controller_server))


def _check_own_classes(config: NavigationConfig) -> None:
    """Raises ConfigError where a class or a tree that is named cannot be used."""
    _in_a_room(config)


def _with_built_in_classes(config: NavigationConfig) -> NavigationConfig:
    """The configuration without a user's own classes: they are called in the run alone."""
    default = NavigationConfig()
    changes: dict[str, object] = {}
    server, planner, trees = config.controller_server, config.planner_server, config.bt_navigator
    if server.controller not in CONTROLLERS:
        name = default.controller_server.controller
        changes["controller_server"] = server.model_copy(update={"controller": name})
    if planner.planner not in PLANNERS:
        name = default.planner_server.planner
        changes["planner_server"] = planner.model_copy(update={"planner": name})
    changes["bt_navigator"] = without_own_nodes(trees)
    return config.model_copy(update=changes)


def _in_a_room(config: NavigationConfig) -> Drive:
    cells = np.zeros((60, 60), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
    cells[30, 20:40] = 100
    frame = frame_of(0.05, _NOWHERE, cells)
    return made_drive(config, frame, cells, random_generator(0, "navigation/warm"))


def _drive(drive: Drive) -> None:
    robot, start = drive.robot, SE2(1.0, 1.0, 0.0)
    ranges = np.full(360, 1.2, np.float32)
    ranges[40:60] = 0.6
    scan = Scan(denoised_ranges(ranges), 0.0, math.tau / 360, 0.1, 3.5, _NOWHERE)
    points_m = moved_points(scan_points(scan), _NOWHERE, _NOWHERE)
    for i in range(3):
        now_ns = i * CONTROL_PERIOD_NS
        robot.local_costmap.move(SE2(0.1 * i, 0.0, 0.0))
        for costmap in (robot.local_costmap, robot.costmap):
            costmap.update(
                start,
                replace(scan, ranges_m=ranges, stamp_ns=now_ns),
                map_from_base=start,
                moving_m=np.array([[2.0, 2.0, 0.2]]),
            )
        drive.tracker.update(
            now_ns * 1e-9, points_m + np.array([1.0 + 0.02 * i, 1.0]),
            robot.costmap.static.distance_m, robot.costmap.frame,
            rays=Rays(now_ns * 1e-9, start, scan),
        )  # fmt: skip
    hidden_from(points_m, start, scan, start)
    rays = RayMemory(1.0)
    rays.take(Rays(0.0, start, scan))
    rays.has_moved(0.0, points_m, points_m)
    moving = drive.tracker.tracks(0.1)
    robot.cost_at(start, use_footprint=True)
    robot.costmap.clear_around(start, 1.0)
    robot.costmap.clear()
    for name, controller in robot.controller_server.controllers.items():
        robot.begin(View(0, start, start, STOP, points_m, moving))
        path = robot.compute_path(None, [SE2(2.0, 2.3, 0.0)], "any_angle")
        robot.compute_path(start, [SE2(2.0, 2.3, 0.0)], "a_star")
        robot.collisions(path, PathCheck())
        robot.gaps.look_at(View(0, start, start, STOP, points_m), path, (1.2, 1.0))
        controller.set_path(path, same_goal=False)
        for velocity in (STOP, Velocity(0.2, 0.1)):
            controller.step(0.05, robot.around())
            robot.time_to_collision(velocity)
        controller.stop()
        _LOG.debug("compiled %s", name)
    if drive.giving_way.is_enabled:
        compile_yielding_kernels(robot.costmap.master, start, robot.footprint)
    sources = {"scan": SourcePoints(0, points_m)}
    drive.monitor.step(0, Velocity(0.4, 0.2), Velocity(0.3, 0.1), sources)
    SearchMotion(drive.search, look_around=False).step(start, points_m, robot.time_to_collision)
    drive.navigator.start(0, NavigateToPose(SE2(2.0, 2.3, 0.0)))
    drive.navigator.step(0)
    drive.navigator.cancel(0)

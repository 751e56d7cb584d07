"""Judges a controller by what the robot does: a unicycle, exact walls, and the planner's paths."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.scan import Scan
from mazebot.navigation.build import planner_params
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.control.collision import Surroundings, Velocity
from mazebot.navigation.control.controller import Controller
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.layered_costmap import Costmap, scan_points
from mazebot.navigation.planning.path import PlannedPath
from mazebot.navigation.planning.planner import Planner
from tests.navigation.driving import Unicycle
from tests.navigation.house_tour import (
    ANGLE_INCREMENT_RAD,
    BASE_FROM_SCAN,
    RANGE_MIN_M,
    as_ranges,
    cast,
)

PERIOD_S = 0.05
NO_TRACKS: tuple[Track, ...] = ()


@dataclass
class Drive:
    """What happened on the way to one goal, one entry a control period."""

    reached: bool = False
    shortest_m: float = 0.0
    poses: list[SE2] = field(default_factory=list)
    commands: list[Velocity] = field(default_factory=list)
    clearances_m: list[float] = field(default_factory=list)
    blocked: int = 0

    @property
    def seconds(self) -> float:
        """Time taken."""
        return len(self.poses) * PERIOD_S

    @property
    def length_m(self) -> float:
        """Way driven."""
        points = np.array([pose[:2] for pose in self.poses])
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    @property
    def spl(self) -> float:
        """Success weighted by path length."""
        return self.reached * self.shortest_m / max(self.length_m, self.shortest_m, 1e-9)

    def jerk(self) -> tuple[float, float]:
        """Mean of the second difference of the speeds after a mean of five, linear and angular."""
        speeds = np.array(self.commands)
        smooth = np.stack([np.convolve(column, np.full(5, 0.2), "valid") for column in speeds.T])
        second = np.diff(smooth, 2, axis=1) / PERIOD_S**2
        linear, angular = np.abs(second).mean(axis=1)
        return float(linear), float(angular)

    def reversals(self) -> int:
        """How often the turn or the drive changes its sign."""
        speeds = np.array(self.commands)
        count = 0
        for column, least in zip(speeds.T, (0.02, 0.15), strict=True):
            signs = np.sign(column[np.abs(column) > least])
            count += int((np.diff(signs) != 0).sum())
        return count


def outline(pose: SE2) -> shapely.Polygon:
    """The robot's true outline."""
    c, s = np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
    turned = WAFFLE.points_m @ np.array([[c, s], [-s, c]])
    return shapely.Polygon(turned + np.array(pose[:2]))


def walls_of(segments: Array) -> shapely.MultiLineString:
    """The faces of walls as one shape."""
    return shapely.MultiLineString([((a, b), (c, d)) for a, b, c, d in segments.tolist()])


def plan(costmap: Costmap, start: SE2, goal: SE2) -> PlannedPath:
    """The planner's path."""
    params = planner_params(NavigationConfig(), costmap.frame.resolution_m, WAFFLE.padded(0.01))
    return Planner(params).plan(costmap, start, goal)


def drive(
    controller: Controller,
    costmap: Costmap,
    robot: Unicycle,
    goal: SE2,
    segments: Array,
    limit_s: float = 60.0,
    path: PlannedPath | None = None,
    tracks: Callable[[float], Sequence[Track]] = lambda _: NO_TRACKS,
    extra: Callable[[float], Array] = lambda _: np.empty((0, 4)),
    costmap_at: Callable[[float], Costmap] | None = None,
    noise: np.random.Generator | None = None,
    speed_limit_m_s: Callable[[float], float] = lambda _: math.inf,
    echoes: bool = True,
) -> Drive:
    """Drive to a goal with an exact pose and a scan at 10 Hz."""
    path = path or plan(costmap, robot.map_from_base, goal)
    controller.set_path(path, same_goal=False)
    told, shape = Drive(shortest_m=path.length_m), walls_of(segments)
    points = np.empty((0, 2))
    for i in range(int(limit_s / PERIOD_S)):
        now_s = i * PERIOD_S
        pose = robot.map_from_base
        moving = extra(now_s)
        if echoes and i % 2 == 0:
            all_m = np.concatenate([segments, moving])
            ranges = as_ranges(cast(pose @ BASE_FROM_SCAN, all_m), noise)
            points = scan_points(
                Scan(ranges, 0.0, ANGLE_INCREMENT_RAD, RANGE_MIN_M, 1.5, BASE_FROM_SCAN)
            )
            seen_at = pose
        if echoes:
            now_from_then = pose.inverse() @ seen_at
            c, s = np.cos(now_from_then.yaw_rad), np.sin(now_from_then.yaw_rad)
            here = points @ np.array([[c, s], [-s, c]]) + np.array(now_from_then[:2])
        else:
            here = points
        now_map = costmap if costmap_at is None else costmap_at(now_s)
        around = Surroundings(
            pose,
            now_map,
            here,
            tracks=tuple(tracks(now_s)),
            velocity=robot.velocity,
            min_echoes=3,
            speed_limit_m_s=speed_limit_m_s(now_s),
        )
        control = controller.step(PERIOD_S, around)
        told.poses.append(pose)
        told.commands.append(control.velocity)
        told.blocked += control.blocked
        body = outline(pose)
        away_m = float(body.distance(shape))
        if len(moving):
            away_m = min(away_m, float(body.distance(walls_of(moving))))
        told.clearances_m.append(away_m)
        if control.reached:
            told.reached = True
            break
        robot.drive(control.velocity, PERIOD_S)
    return told

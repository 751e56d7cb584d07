"""Docking at a marker, judged where the robot really stands at the end."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mazebot.bench.navigation.courses import bench_worlds
from mazebot.bench.navigation.courses.bench_worlds import BenchWorld
from mazebot.bench.navigation.courses.course import Course
from mazebot.bench.navigation.scenario import Options, Row, skipped
from mazebot.bench.navigation.surroundings import Surroundings
from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, CAMERA_OPTICAL_FRAME, SE2, wrap_angle
from mazebot.common.messages.action_documents import DockRobot, UndockRobot
from mazebot.common.messages.topics import CAMERA_INFO, ENTITIES, TF_STATIC
from mazebot.common.node.frame_tree import FrameTree
from mazebot.common.node.node import random_generator
from mazebot.navigation.behavior.context import Dock
from mazebot.navigation.behavior.docking.docking import LEAST_STAGING_SHARE, DockingParams
from mazebot.navigation.behavior.docking.docks import Docks
from mazebot.navigation.messages import camera_view

SIDEWAYS_M, IN_ALL_M, TURN_DEG = 0.02, 0.03, 1.5
_LIMIT_S = 120.0
_CLEARANCE_M = 0.30
_DOCK_CLEARANCE_M = 0.22
_TRIES = 200
"""Starts tried before one marker"""
_SHIPPED = ("enhanced", "markers", "slam")


class _Starts(NamedTuple):
    """Where the robot may start, from the dock."""

    away_m: tuple[float, float]
    bearing_deg: float


def docking(name: str, seed: int, options: Options) -> list[Row]:
    """The robot starts 1 to 2.2 m from the dock of a marker, within 35 degrees of its axis, facing
    any way, and is asked to dock, then to undock. The docked pose is the one that navigation
    computes from what the camera can see, before the marker's true place.
    """
    return _docking(name, seed, options, bench_worlds.docks(), _Starts((1.0, 2.2), 35.0))


def docking_shipped(name: str, seed: int, options: Options) -> list[Row]:
    """The same at any marker of a shipped world before which there is room, from 0.5 to 2.2 m and
    within 60 degrees.
    """
    place = BenchWorld(_SHIPPED[seed % len(_SHIPPED)])
    return _docking(name, seed, options, place, _Starts((0.5, 2.2), 60.0))


def _docking(
    name: str, seed: int, options: Options, place: BenchWorld, starts: _Starts
) -> list[Row]:
    if not options.camera:
        return skipped(name, seed, "needs the camera")
    random = random_generator(seed, "bench/docking")
    with Course(name, place, seed, options, camera=True) as course:
        docks = _docks(course)
    loaded = place.load()
    around = Surroundings(loaded)
    dock, start = _choice(docks, around, loaded.world.start.se2(), starts, random)
    with Course(name, place.starting_at(start), seed, options, camera=True) as course:
        return [_dock(course, dock)]


def _docks(course: Course) -> tuple[Dock, ...]:
    """The docks as navigation knows them, by the camera's true place and intrinsics."""
    session, frames = course.session, FrameTree()
    while session.latest(CAMERA_INFO) is None:
        course.tick()
    static, info, entities = (
        session.latest(TF_STATIC), session.latest(CAMERA_INFO), session.latest(ENTITIES)
    )  # fmt: skip
    assert static is not None
    assert info is not None
    assert entities is not None
    frames.add(static)
    base_from_camera = frames.chain(BASE_FOOTPRINT_FRAME, CAMERA_OPTICAL_FRAME)
    assert base_from_camera is not None
    docks = Docks()
    docks.learn(entities.markers, camera_view(info, base_from_camera))
    return tuple(docks.known[marker.name] for marker in entities.markers)


def _choice(
    docks: tuple[Dock, ...],
    around: Surroundings,
    home: SE2,
    starts: _Starts,
    random: np.random.Generator,
) -> tuple[Dock, SE2]:
    """A dock with room before it, and a start."""
    params = DockingParams()
    while True:
        dock = docks[int(random.integers(len(docks)))]
        docked = dock.map_from_dock
        staged = docked @ SE2(LEAST_STAGING_SHARE * params.staging_x_offset, 0.0, 0.0)
        if min(around.point_clearance_m(*pose[:2]) for pose in (docked, staged)) < (
            _DOCK_CLEARANCE_M
        ):
            continue
        for _ in range(_TRIES):
            bearing = float(random.uniform(-1.0, 1.0)) * math.radians(starts.bearing_deg)
            away_m = float(random.uniform(*starts.away_m))
            spot = docked @ SE2(-away_m * math.cos(bearing), away_m * math.sin(bearing), 0.0)
            start = SE2(spot.x_m, spot.y_m, float(random.uniform(-math.pi, math.pi)))
            if around.point_clearance_m(*start[:2]) < _CLEARANCE_M:
                continue
            # The marker is seen from there: no wall stands between.
            shortest_m = around.shortest_m(start, docked, 0.0)
            if shortest_m is None or shortest_m > 1.02 * start.distance_m(docked):
                continue
            if around.shortest_m(home, start, 0.0) is not None:
                return dock, start


def _dock(course: Course, dock: Dock) -> Row:
    course.wait_until_active()
    start_s = course.now_s
    row = course.row()
    result = course.act(DockRobot(dock_id=dock.marker_id), row, _LIMIT_S)
    course.run_for(0.5)
    row.time_s = course.now_s - start_s
    docked = course.pose
    off = dock.map_from_dock.inverse() @ docked
    degrees = math.degrees(abs(wrap_angle(off.yaw_rad)))
    row.goal_error_m = math.hypot(off.x_m, off.y_m)
    row.extra = {"marker": int(dock.marker_id),
                 "dock_m": dock.marker_from_dock.x_m,
                 "start": course.loaded.world.start.model_dump(),
                 "sideways_m": abs(off.y_m), "along_m": off.x_m, "off_m": row.goal_error_m,
                 "turned_deg": degrees}  # fmt: skip
    row.reached = result is not None and row.error_code == 0
    near = abs(off.y_m) <= SIDEWAYS_M and row.goal_error_m <= IN_ALL_M and degrees <= TURN_DEG
    row.success = row.reached and near and _undocks(course, docked, row)
    contacts = course.witness.contacts
    row.contacts_robot = sum(one.by_robot for one in contacts)
    row.way = course.witness.truth_between(0.0, math.inf)[::3, 1:3]
    row.success = row.success and not row.contacts_robot
    return row


def _undocks(course: Course, docked: SE2, row: Row) -> bool:
    """Whether the robot goes back from its dock when it is asked to."""
    result = course.act(UndockRobot(), row, _LIMIT_S)
    course.run_for(0.5)
    row.extra["undocked_m"] = docked.distance_m(course.pose)
    least_m = -LEAST_STAGING_SHARE * DockingParams().staging_x_offset
    return result is not None and row.error_code == 0 and row.extra["undocked_m"] > least_m - 0.05

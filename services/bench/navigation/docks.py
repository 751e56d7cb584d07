"""Docking at a marker, judged where the robot really stands at the end."""

from __future__ import annotations

import math

import numpy as np

from services.bench.navigation import bench_worlds
from services.bench.navigation.course import Course
from services.bench.navigation.scenario import Options, Row, skipped
from services.bench.navigation.surroundings import Surroundings
from services.common.frames import SE2, pose_matrix, wrap_angle
from services.common.node.action_documents import DockRobot, SendGoal
from services.common.node.documents import MarkerEntity
from services.common.node.node import random_generator
from services.common.node.topics import ACTION_RESULT, ENTITIES, SEND_GOAL
from services.navigation.behavior.docking import DockingParams
from services.navigation.messages import marker_pose

SIDEWAYS_M, IN_ALL_M, TURN_DEG = 0.02, 0.03, 1.5
_LIMIT_S = 120.0
_CLEARANCE_M = 0.30
_GOAL_ID = "bench"


def docking(name: str, seed: int, options: Options) -> list[Row]:
    """The robot starts 1 to 2.2 m from the dock of a marker, within 35 degrees of its axis, facing
    any way, and is asked to dock. The docked pose is that of the default parameters before the
    marker's true place.
    """
    if not options.camera:
        return skipped(name, seed, "needs the camera")
    place = bench_worlds.docks()
    random = random_generator(seed, "bench/docking")
    with Course(name, place, seed, options) as course:
        entities = course.session.latest(ENTITIES)
        markers = entities.markers if entities is not None else ()
    around = Surroundings(place.load())
    home = place.load().world.start.se2()
    marker, dock, start = _choice(markers, around, home, random)
    with Course(name, place.starting_at(start), seed, options, camera=True) as course:
        return [_dock(course, marker, dock)]


def _choice(
    markers: tuple[MarkerEntity, ...], around: Surroundings, home: SE2, random: np.random.Generator
) -> tuple[MarkerEntity, SE2, SE2]:
    """A marker, the pose of the robot docked at it, and a start."""
    marker_from_dock = DockingParams().marker_from_dock
    while True:
        marker = markers[int(random.integers(len(markers)))]
        dock = marker_pose(pose_matrix(marker)) @ marker_from_dock
        bearing = float(random.uniform(-1.0, 1.0)) * math.radians(35.0)
        away_m = float(random.uniform(1.0, 2.2))
        spot = dock @ SE2(-away_m * math.cos(bearing), away_m * math.sin(bearing), 0.0)
        start = SE2(spot.x_m, spot.y_m, float(random.uniform(-math.pi, math.pi)))
        if around.point_clearance_m(*start[:2]) < _CLEARANCE_M:
            continue
        # The marker is seen from there: no wall stands between.
        shortest_m = around.shortest_m(start, dock, 0.0)
        if shortest_m is None or shortest_m > 1.02 * start.distance_m(dock):
            continue
        if around.shortest_m(home, start, 0.0) is not None:
            return marker, dock, start


def _dock(course: Course, marker: MarkerEntity, dock: SE2) -> Row:
    course.wait_until_active()
    start_s = course.now_s
    row = Row(course.scenario, course.place.shown, course.seed, 0, scene=course.around.outlines())
    goal = DockRobot(dock_id=str(marker.marker_id))
    reply = course.session.ask(SEND_GOAL, SendGoal(goal_id=_GOAL_ID, goal=goal))
    row.error_code, row.error_msg = reply.error_code, reply.error_msg
    if reply.accepted:
        with course.session.watching(ACTION_RESULT) as results:
            while not results and course.now_s - start_s < _LIMIT_S:
                course.tick()
        row.error_msg = "" if results else f"no result within {_LIMIT_S:.0f} s"
        if results:
            row.error_code, row.error_msg = results[0].error_code, results[0].error_msg
    course.run_for(0.5)
    row.time_s = course.now_s - start_s
    off = dock.inverse() @ course.pose
    degrees = math.degrees(abs(wrap_angle(off.yaw_rad)))
    row.goal_error_m = math.hypot(off.x_m, off.y_m)
    row.extra = {"marker": marker.marker_id, "start": course.loaded.world.start.model_dump(),
                 "sideways_m": abs(off.y_m), "along_m": off.x_m, "off_m": row.goal_error_m,
                 "turned_deg": degrees}  # fmt: skip
    contacts = course.witness.contacts
    row.contacts_robot = sum(one.by_robot for one in contacts)
    row.way = course.witness.truth_between(0.0, math.inf)[::3, 1:3]
    row.reached = reply.accepted and row.error_code == 0 and not row.error_msg
    near = abs(off.y_m) <= SIDEWAYS_M and row.goal_error_m <= IN_ALL_M and degrees <= TURN_DEG
    row.success = row.reached and near and not row.contacts_robot
    return row

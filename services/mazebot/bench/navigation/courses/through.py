"""Drives through poses, some of them in dead ends, without a stop."""

from __future__ import annotations

import itertools
import math

import numpy as np

from mazebot.bench.navigation.courses.bench_worlds import BenchWorld
from mazebot.bench.navigation.courses.course import Course
from mazebot.bench.navigation.courses.tours import random_poses
from mazebot.bench.navigation.measure import Leg, fill_in
from mazebot.bench.navigation.scenario import Options, Row
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.action_documents import NavigateThroughPoses
from mazebot.common.messages.documents import Planar
from mazebot.common.robot.waffle import MAX_LINEAR_M_S

_POSES = 4
_PASSED_M = 0.75
"""A pose counts as passed within 0.7 m, as in Nav2's behaviour tree."""


def through_poses(name: str, seed: int, options: Options) -> list[Row]:
    """Four reachable poses at random, in the house or in rooms and corridors."""
    size = ("maze.rows=7", "maze.columns=7", f"maze.seed={seed}")
    place = BenchWorld("original") if seed % 2 else BenchWorld("maze_rooms", size)
    with Course(name, place, seed, options) as course:
        return [_through(course, random_poses(course, seed, _POSES))]


def _through(course: Course, poses: list[SE2]) -> Row:
    course.wait_until_active()
    start_s, start = course.now_s, course.pose
    pieces_m = [
        course.around.shortest_m(before, after, start_s) or before.distance_m(after)
        for before, after in itertools.pairwise([start, *poses])
    ]
    row = course.row()
    goal = NavigateThroughPoses(poses=tuple(map(Planar.of, poses)))
    course.act(goal, row, 45.0 + 3.0 * sum(pieces_m) / MAX_LINEAR_M_S)
    leg = Leg(start_s, course.now_s, start, poses[-1], sum(pieces_m))
    fill_in(row, leg, course.witness, course.around)
    way = course.witness.truth_between(leg.start_s, leg.end_s)[:, 1:3]
    nearest_m = [
        float(np.hypot(*(way - np.array(pose[:2])).T).min(initial=math.inf)) for pose in poses
    ]
    row.extra["passed_m"] = max(nearest_m)
    row.success = row.reached and max(nearest_m) <= _PASSED_M and not row.contacts_robot
    return row

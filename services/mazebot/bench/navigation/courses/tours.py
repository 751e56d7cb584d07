"""Drives in still worlds: tours, random goals, mazes, narrow corridors, halls and yards."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from mazebot.bench.navigation.courses import bench_worlds
from mazebot.bench.navigation.courses.bench_worlds import BenchWorld
from mazebot.bench.navigation.courses.course import Course
from mazebot.bench.navigation.scenario import Options, Row, RunSeed
from mazebot.bench.whole.soak import reachable_goals
from mazebot.common.maths.frames import SE2
from mazebot.common.node.node import random_generator

NARROW_M = (0.5, 0.6, 0.7)
_RANDOM_GOALS = 4
DEGRADED: dict[str, Any] = {"scan_noise_m": 0.05, "scan_dropout": 0.3, "wheel_slip": 0.1}


def drive_all(course: Course, goals: Iterator[SE2] | list[SE2]) -> list[Row]:
    """One row for each goal in turn."""
    return [course.drive(goal) for goal in goals]


def tour_of(course: Course) -> list[SE2]:
    """The world's locations in order, then home."""
    return [
        *(place.se2() for place in course.loaded.world.locations),
        course.loaded.world.start.se2(),
    ]


def tour(world: str, camera: bool = False, **physics: Any) -> RunSeed:
    """The tour of a world's locations."""

    def run(name: str, seed: int, options: Options) -> list[Row]:
        with Course(name, BenchWorld(world), seed, options, camera, **physics) as course:
            return drive_all(course, tour_of(course))

    return run


def random_goals(name: str, seed: int, options: Options) -> list[Row]:
    """Four reachable goals at random in each shipped world."""
    rows = []
    for world in bench_worlds.SHIPPED:
        with Course(name, BenchWorld(world), seed, options) as course:
            rows += drive_all(course, random_poses(course, seed, _RANDOM_GOALS))
    return rows


def random_poses(course: Course, seed: int, count: int) -> list[SE2]:
    """Reachable poses at random."""
    found = itertools.islice(reachable_goals(course.loaded, seed), count)
    return [one.se2() for one in found]


def maze(name: str, seed: int, options: Options) -> list[Row]:
    """A maze of 10 x 10 cells with loops, to its goal and back."""
    place = BenchWorld(
        "maze", ("maze.rows=10", "maze.columns=10", "maze.braiding=0.5", f"maze.seed={seed}")
    )
    with Course(name, place, seed, options) as course:
        return drive_all(course, tour_of(course))


def narrow(corridor_m: float) -> RunSeed:
    """A maze of 6 x 6 cells with corridors of one width, to its goal."""

    def run(name: str, seed: int, options: Options) -> list[Row]:
        place = bench_worlds.narrow_maze(corridor_m, seed)
        with Course(name, place, seed, options) as course:
            goals = [one.se2() for one in course.loaded.world.locations]
            return drive_all(course, goals[:1])

    return run


def wide(world: Callable[[], BenchWorld], goals: tuple[tuple[float, float, float], ...]) -> RunSeed:
    """Goals in a place where the lidar sees little; the start's heading and the goals' order are
    chosen by the seed.
    """

    def run(name: str, seed: int, options: Options) -> list[Row]:
        random = random_generator(seed, "bench/wide")
        place = world()
        begin = place.load().world.start
        turned = SE2(begin.x_m, begin.y_m, float(random.uniform(-math.pi, math.pi)))
        order = random.permutation(len(goals)).tolist()
        with Course(name, place.starting_at(turned), seed, options) as course:
            return drive_all(course, [SE2(*goals[index]) for index in order])

    return run


def near_things(name: str, seed: int, options: Options) -> list[Row]:
    """Goals whose middle is 0.25 to 0.31 m from the nearest thing, where the robot can stand."""
    with Course(name, BenchWorld("slam"), seed, options) as course:
        return [course.drive(goal) for goal in _near(course, seed, 3)]


def _near(course: Course, seed: int, count: int) -> list[SE2]:
    random = random_generator(seed, "bench/near")
    xs, ys = zip(*((one.x_m, one.y_m) for one in random_poses(course, seed, 200)), strict=True)
    low, high = np.array([min(xs), min(ys)]) - 0.3, np.array([max(xs), max(ys)]) + 0.3
    start, found = course.loaded.world.start.se2(), list[SE2]()
    while len(found) < count:
        x_m, y_m = random.uniform(low, high).tolist()
        if not 0.25 <= course.around.point_clearance_m(x_m, y_m) <= 0.31:
            continue
        goal = SE2(x_m, y_m, float(random.uniform(-math.pi, math.pi)))
        if course.around.shortest_m(start, goal, 0.0) is not None:
            found.append(goal)
    return found


def start_in_inflation(name: str, seed: int, options: Options) -> list[Row]:
    """A start whose outline is 1 to 6 cm from a wall, where the circle around the robot does not
    fit, to a goal with room.
    """
    place = BenchWorld("original")
    loaded = place.load()
    with Course(
        name, place.starting_at(_close_start(loaded.world.start.se2(), seed)), seed, options
    ) as course:
        (goal,) = random_poses(course, seed, 1)
        row = course.drive(goal)
        row.extra["start_clearance_m"] = float(
            course.around.clearance_m(
                np.zeros(1), np.array([tuple(course.loaded.world.start.se2())])
            )[0]
        )
        return [row]


def _close_start(home: SE2, seed: int) -> SE2:
    from mazebot.bench.navigation.surroundings import Surroundings  # noqa: PLC0415

    loaded = BenchWorld("original").load()
    around, random = Surroundings(loaded), random_generator(seed, "bench/close")
    while True:
        x_m, y_m = random.uniform([-2.5, -2.0], [5.4, 4.3]).tolist()
        pose = SE2(x_m, y_m, float(random.uniform(-math.pi, math.pi)))
        if not 0.13 <= around.point_clearance_m(x_m, y_m) <= 0.235:
            continue
        clearance_m = float(around.clearance_m(np.zeros(1), np.array([tuple(pose)]))[0])
        if 0.01 <= clearance_m <= 0.06 and around.shortest_m(home, pose, 0.0) is not None:
            return pose


CORRIDOR_GOALS = ((13.5, 0.0, 0.0), (-13.5, 0.0, math.pi), (0.0, 0.3, 0.0))
HALL_GOALS = ((8.0, 8.0, 0.0), (-8.0, 8.0, 1.57), (8.0, -8.0, -1.57), (2.5, 2.5, 0.0))
YARD_GOALS = ((7.5, -7.5, 1.57), (7.5, 7.5, 3.14), (-7.5, 7.5, -1.57), (0.0, -4.0, 0.0))

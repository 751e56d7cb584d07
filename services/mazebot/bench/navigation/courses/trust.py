"""Whether a claimed pose can be trusted: beside things that the map does not have, at the first
verdict on an initial pose, and where the map shows nothing.
"""

from __future__ import annotations

import math
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from mazebot.bench.navigation.courses import bench_worlds
from mazebot.bench.navigation.courses.bench_worlds import BenchWorld
from mazebot.bench.navigation.courses.course import Course, pose_apart
from mazebot.bench.navigation.measure import Leg, alarm_count
from mazebot.bench.navigation.scenario import Options, Row, scratch_folder
from mazebot.bench.whole.soak import reachable_goals
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.topics import LOCALIZATION_STATUS
from mazebot.common.node.node import random_generator
from mazebot.common.world.costmap import Cells
from mazebot.common.world.map_files import write_map
from mazebot.worldgen.recipe.loaded_world import LoadedWorld

OFF_M = (0.0, 0.3, 0.9, 5.0)
"""How far initial poses are from the true ones."""
RIGHT_M, RIGHT_RAD = 0.25, 0.25
"""A claim within both is right."""
_FOUND_WITHIN_S = 60.0
_NOT_FOUND_FOR_S = 30.0
_BESIDE_S = 12.0
_PILLARS_APART_M = 5.0


def beside_boxes(name: str, seed: int, options: Options) -> list[Row]:
    """Three boxes are put around a robot in a hall, which then drives out by the open side: a pose
    that is right must not be given up.
    """
    random = random_generator(seed, "bench/beside_boxes")
    place = bench_worlds.hall(pillars=bool(seed % 2)).starting_at(_start_in_hall(random))
    with Course(name, place, seed, options) as course:
        course.wait_until_active()
        start_s, start = course.now_s, course.pose
        gap_m = float(random.uniform(0.55, 1.0))
        for side, turn_rad in (("ahead", 0.0), ("left", math.pi / 2.0), ("right", -math.pi / 2.0)):
            there = start @ SE2(0.0, 0.0, turn_rad) @ SE2(gap_m + 0.15, 0.0, 0.0)
            course.put_box(side, there, (0.3, 2.0 * gap_m))
        course.run_for(_BESIDE_S)
        out = start @ SE2(-1.5, 0.0, 0.0)
        row = course.drive(SE2(out.x_m, out.y_m, start.yaw_rad))
        leg = Leg(start_s, course.now_s, start, out, None)
        truth = course.witness.truth_between(start_s, course.now_s)
        row.alarms = alarm_count(leg, truth, course.witness)
        row.success &= not row.alarms
        return [row]


def _start_in_hall(random: np.random.Generator) -> SE2:
    """Off the walls and the pillars by more than the boxes take."""
    while True:
        x_m, y_m = random.uniform(-7.5, 7.5, 2).tolist()
        off = [
            abs(value - _PILLARS_APART_M * round(value / _PILLARS_APART_M)) for value in (x_m, y_m)
        ]
        if math.hypot(*off) > 2.0:
            return SE2(x_m, y_m, float(random.uniform(-math.pi, math.pi)))


def first_verdict(name: str, seed: int, options: Options) -> list[Row]:
    """Starts with an initial pose that is right or not, and one on the map of another world: the
    first pose that is called localized has to be right, and on that map there must be none.
    """
    random = random_generator(seed, "bench/first_verdict")
    house, maze = BenchWorld("original"), BenchWorld("maze_rooms")
    true, _ = _free_poses(house.load(), seed, 2)
    rows = list[Row]()
    for trial, off_m in enumerate(OFF_M):
        angle = float(random.uniform(-math.pi, math.pi))
        given = SE2(
            true.x_m + off_m * math.cos(angle), true.y_m + off_m * math.sin(angle), true.yaw_rad
        )
        rows.append(_first_verdict(name, house.starting_at(true), seed, options, given, None))
        rows[-1].trial, rows[-1].extra["off_m"] = trial, off_m
    other = maze.load()
    (given, _) = _free_poses(other, seed, 2)
    chart = _map_file(f"other_{seed}", other, np.array(other.map_cells, np.int8))
    rows.append(_first_verdict(name, house.starting_at(true), seed, options, given, chart))
    rows[-1].trial = len(OFF_M)
    return rows


def _first_verdict(
    name: str, place: BenchWorld, seed: int, options: Options, given: SE2, chart: Path | None
) -> Row:
    """One start at `given`, on another world's map where `chart` names one."""
    initial = dict(zip(("x", "y", "yaw"), (float(value) for value in given), strict=True))
    settings = {"localization": {"set_initial_pose": True, "initial_pose": initial}}
    more: dict[str, Any] = {} if chart is None else {"map_file": chart}
    limit_s = _FOUND_WITHIN_S if chart is None else _NOT_FOUND_FOR_S
    with Course(name, place, seed, options.with_settings(settings), **more) as course:
        row = Row(name, place.shown, seed, 0, scene=course.around.outlines())
        while course.now_s < limit_s:
            course.tick()
            status = course.session.latest(LOCALIZATION_STATUS)
            claim = course.witness.claimed()
            if status is None or status.state != "localized" or claim is None:
                continue
            error_m, error_rad = pose_apart(claim, course.pose)
            row.extra = {"verdict_s": round(course.now_s, 2), "error_m": round(error_m, 3)}
            row.reached = chart is None and error_m <= RIGHT_M and error_rad <= RIGHT_RAD
            row.error_msg = "" if row.reached else f"wrong by {error_m:.2f} m: {status.reason}"
            break
        else:
            row.error_msg = "" if chart is not None else f"no verdict within {limit_s:.0f} s"
        _finish(course, row)
        row.success = not row.error_msg and not row.contacts_robot
        return row


def unmapped_part(name: str, seed: int, options: Options) -> list[Row]:
    """A robot that searches for its pose starts in a half of the house that was cut from the map:
    while it is there, no pose is right.
    """
    place = BenchWorld("original")
    loaded = place.load()
    cells = np.array(loaded.map_cells, np.int8)
    middle = cells.shape[1] // 2
    cut = slice(0, middle) if seed % 2 else slice(middle, None)
    cells[:, cut] = -1
    border_m = (loaded.map_origin @ SE2(middle * loaded.world.map_resolution_m, 0.0, 0.0)).x_m
    away = next(
        pose
        for pose in _free_poses(loaded, seed, 500)
        if (pose.x_m < border_m - 0.5 if seed % 2 else pose.x_m > border_m + 0.5)
    )
    chart = _map_file(f"half_{seed}", loaded, cells)
    settings = options.with_settings({"localization": {"initialize_at_start_pose": False}})
    with Course(name, place.starting_at(away), seed, settings, map_file=chart) as course:
        row = Row(name, place.shown, seed, 0, scene=course.around.outlines())
        wrong_s = 0.0
        while course.now_s < _FOUND_WITHIN_S:
            course.tick()
            claim = course.witness.claimed()
            if claim is not None and course.is_active():
                wrong_s += 0.05 * (pose_apart(claim, course.pose)[0] > RIGHT_M)
        _finish(course, row)
        row.extra = {"wrong_and_active_s": round(wrong_s, 2)}
        row.error_msg = f"trusted a wrong pose for {wrong_s:.1f} s" if wrong_s else ""
        row.reached = not wrong_s
        row.success = row.reached and not row.contacts_robot
        return [row]


def _finish(course: Course, row: Row) -> None:
    row.time_s = course.now_s
    row.contacts_robot = sum(one.by_robot for one in course.witness.contacts)
    row.way = course.witness.truth_between(0.0, np.inf)[::3, 1:3]


def _free_poses(loaded: LoadedWorld, seed: int, count: int) -> list[SE2]:
    return [one.se2() for one in islice(reachable_goals(loaded, seed + 3_000), count)]


def _map_file(name: str, loaded: LoadedWorld, cells: Cells) -> Path:
    return write_map(
        scratch_folder(), name, cells, loaded.world.map_resolution_m, loaded.map_origin
    )

"""Doors that are shut or too narrow, some with another way."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from mazebot.bench.navigation.courses.bench_worlds import BenchWorld, fenced, made, start, wall
from mazebot.bench.navigation.courses.course import Course, rectangle
from mazebot.bench.navigation.courses.moving import ROOM_M, nearest_named_m, place_on, widest_across
from mazebot.bench.navigation.scenario import Options, Row
from mazebot.bench.navigation.surroundings import Surroundings
from mazebot.bench.whole.soak import reachable_goals
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.node.node import random_generator
from mazebot.common.robot.waffle import MAX_LINEAR_M_S
from mazebot.recorder.judging.goals.shortest_path import ShortestPath
from mazebot.worldgen.recipe.loaded_world import LoadedWorld

_THIN_M = 0.1
"""No robot of this radius gets past a shut door."""
_NOT_NEAR_M = 0.45
"""A door does not shut on the robot."""
_TRIES = 2_000
SHUT_WORLDS = ("maze_rooms", "maze", "original")


@dataclass(frozen=True)
class Door:
    """A door to be shut on the shortest way, and what is left then."""

    pose: SE2
    size_m: tuple[float, float]
    direct_m: float
    detour_m: float
    begin: SE2
    goal: SE2


def shut_door(name: str, seed: int, options: Options) -> list[Row]:
    """A door on the shortest way is shut where another way is free: once between two rooms with two
    doors, behind corners of all kinds, once in a shipped world. For even seeds it is shut before
    the goal is sent, for odd ones when the robot comes near.
    """
    random = random_generator(seed, "bench/shut_door")
    shipped = BenchWorld(SHUT_WORLDS[seed // 2 % len(SHUT_WORLDS)])
    if shipped.name.startswith("maze"):
        shipped = BenchWorld(shipped.name, (f"maze.seed={seed}",))
    if shipped.name == "maze":
        shipped = BenchWorld("maze", (*shipped.overrides, "maze.braiding=0.6"))
    return [
        _past(name, seed, place, random, ends, options)
        for place, ends in (
            (rooms_with_two_doors(seed), _between_rooms),
            (shipped, _anywhere),
        )
    ]


Ends = Callable[[LoadedWorld, np.random.Generator], tuple[SE2, SE2]]


def _past(
    name: str, seed: int, place: BenchWorld, random: np.random.Generator, ends: Ends,
    options: Options,
) -> Row:  # fmt: skip
    loaded = place.load()
    door = _door(Surroundings(loaded), lambda: ends(loaded, random), random)
    while_driving = seed % 2 == 1
    shut_at_m = float(random.uniform(0.8, 3.0))
    shut = list[float]()

    def on_tick(course: Course, elapsed_s: float) -> None:
        here_m = course.pose.distance_m(door.pose)
        if not shut and _NOT_NEAR_M < here_m <= shut_at_m and course.put_box(
            "door", door.pose, door.size_m, 1.0
        ):  # fmt: skip
            shut.append(elapsed_s)

    with Course(name, place.starting_at(door.begin), seed, options) as course:
        course.wait_until_active()
        if not while_driving and course.put_box("door", door.pose, door.size_m, 1.0):
            shut.append(0.0)
        limit_s = 45.0 + 3.0 * (door.direct_m + door.detour_m) / MAX_LINEAR_M_S
        row = course.drive(door.goal, [on_tick] * while_driving, limit_s=limit_s)
    row.extra |= {
        "shut": bool(shut), "while_driving": while_driving, "width_m": round(door.size_m[1], 2),
        "direct_m": round(door.direct_m, 2), "detour_m": round(door.detour_m, 2),
        "detour_ratio": round(row.driven_m / (door.direct_m + door.detour_m), 3),
    }  # fmt: skip
    row.success = row.success and bool(shut)
    return row


def _door(
    around: Surroundings, ends: Callable[[], tuple[SE2, SE2]], random: np.random.Generator
) -> Door:
    """A door across the shortest way between two ends, which leaves another way."""
    for _ in range(_TRIES):
        begin, goal = ends()
        way = around.paths(0.0).path(begin[:2], goal[:2])
        if way is None:
            continue
        thick_m = float(random.uniform(0.05, 0.3))
        share = float(random.uniform(0.2, 0.85))
        spot, across = place_on(way, share)
        if math.dist(spot, begin[:2]) < 0.8 or math.dist(spot, goal[:2]) < 0.8:
            continue
        sides = widest_across(around, spot, across, 0.0)
        if sides is None or not 0.5 <= math.dist(*sides) <= 1.85:
            continue
        (ax, ay), (bx, by) = sides
        pose = SE2((ax + bx) / 2.0, (ay + by) / 2.0, math.atan2(by - ay, bx - ax) - math.pi / 2.0)
        size_m = (thick_m, math.dist(*sides) - 0.02)
        leaf = rectangle(pose, size_m)
        if any(shapely.intersects(one, leaf) for one in around.solids):
            continue
        shut = np.array([*around.solids, leaf], object)
        detour_m = ShortestPath(shut, ROOM_M).length_m(begin[:2], goal[:2])
        direct_m = around.shortest_m(begin, goal, 0.0)
        thin_m = ShortestPath(shut, _THIN_M).length_m(begin[:2], goal[:2])
        if detour_m is None or direct_m is None or thin_m is None:
            continue
        # Nothing gets past it on either side.
        if thin_m < 0.85 * detour_m or not direct_m + 0.8 <= detour_m <= direct_m + 15.0:
            continue
        return Door(pose, size_m, direct_m, detour_m, begin, goal)
    raise ValueError(f"no door within {_TRIES} tries")


def _anywhere(loaded: LoadedWorld, random: np.random.Generator) -> tuple[SE2, SE2]:
    begin, goal = itertools.islice(reachable_goals(loaded, int(random.integers(1 << 30))), 2)
    return begin.se2(), goal.se2()


def _between_rooms(_: LoadedWorld, random: np.random.Generator) -> tuple[SE2, SE2]:
    return _in_room(random, -3.2, -0.9), _in_room(random, 0.9, 3.2)


def _in_room(random: np.random.Generator, low_m: float, high_m: float) -> SE2:
    return SE2(
        float(random.uniform(low_m, high_m)), float(random.uniform(-1.7, 1.7)),
        float(random.uniform(-math.pi, math.pi)),
    )  # fmt: skip


def rooms_with_two_doors(seed: int) -> BenchWorld:
    """Two rooms of 4 by 4.4 m, joined by two doors 0.6 to 1 m wide. Before some of them a short
    wall stands out on one side or both, so that they are seen past a corner.
    """
    random = random_generator(seed, "bench/two_doors")
    widths_m = random.uniform(0.6, 1.0, 2).tolist()
    south_m, north_m = float(random.uniform(-1.5, -0.9)), float(random.uniform(0.9, 1.5))
    edges_m = [-2.2]
    walls: list[dict[str, Any]] = []
    for middle_m, width_m in zip((south_m, north_m), widths_m, strict=True):
        low_m, high_m = middle_m - width_m / 2.0, middle_m + width_m / 2.0
        edges_m += [low_m, high_m]
        for y_m, outward in ((low_m, -1.0), (high_m, 1.0)):
            if random.uniform() < 0.5:
                long_m = float(random.uniform(0.3, 1.0))
                side = 1.0 if random.uniform() < 0.5 else -1.0
                at = SE2(side * (long_m + 0.15) / 2.0, y_m + outward * 0.075, 0.0)
                walls.append(wall(f"wing_{len(walls)}", at, long_m))
    walls += _wall_with_doors([*edges_m, 2.2])
    return made(
        f"bench_two_doors_{seed}", {"walls": [*fenced(8.0, 4.4), *walls], "start": start(-3.0, 0.0)}
    )


def _wall_with_doors(edges_m: list[float]) -> list[dict[str, Any]]:
    """The pieces of a wall along y, each from one edge to the next, with doors between them."""
    return [
        wall(f"middle_{number}", SE2(0.0, (low_m + high_m) / 2.0, math.pi / 2.0), high_m - low_m)
        for number, (low_m, high_m) in enumerate(zip(edges_m[::2], edges_m[1::2], strict=True))
    ]


NARROW_M = (0.2, 0.3)
PASSABLE_M = (0.45, 0.7)
"""Doors through which the robot, 0.306 m wide, does not fit, and through which it has to drive."""
REFUSED_WITHIN_S = 15.0
"""With the way to where the robot can see it."""
_WIDTH = re.compile(r"(\d+\.\d+) m wide")


def narrow_door(name: str, seed: int, options: Options) -> list[Row]:
    """A door that is too narrow, on the map, half shut, or a little wider on the map, first as the
    only way: 208 without a contact, with the place and the width. Then the same with another way,
    which has to be taken, and one that is wide enough.
    """
    random = random_generator(seed, "bench/narrow_door")
    narrow_m, wide_m = float(random.uniform(*NARROW_M)), float(random.uniform(*PASSABLE_M))
    y_m = float(random.uniform(-0.6, 0.6))
    rows = list[Row]()
    for width_m, other in ((narrow_m, False), (narrow_m, True), (wide_m, False)):
        begin = _in_room(random, -3.2, -1.0)
        goal = _in_room(random, 1.0, 3.2)
        on_map_m = (width_m, 1.0, max(width_m + 0.1, 0.4))[seed % 3]
        opening = Opening(y_m, width_m, on_map_m, math.copysign(1.5, -y_m) if other else None)
        row = _through(name, seed, opening, begin, goal, random, options)
        row.trial = len(rows)
        rows.append(row)
    return rows


@dataclass(frozen=True)
class Opening:
    """A door between two rooms."""

    y_m: float
    width_m: float
    on_map_m: float
    """Its width on the map: what is more than the width is shut by leaves that the map does not
    have.
    """
    other_y_m: float | None
    """Where another door of 0.8 m is."""


def _through(
    name: str, seed: int, opening: Opening, begin: SE2, goal: SE2, random: np.random.Generator,
    options: Options,
) -> Row:  # fmt: skip
    width_m, y_m, on_map_m = opening.width_m, opening.y_m, opening.on_map_m
    edges_m = sorted(
        edge_m
        for middle_m, wide_m in ((y_m, on_map_m), (opening.other_y_m, 0.8))
        if middle_m is not None
        for edge_m in (middle_m - wide_m / 2.0, middle_m + wide_m / 2.0)
    )
    walls = _wall_with_doors([-2.2, *edges_m, 2.2])
    spare_m = on_map_m - width_m
    low_m = float(random.uniform(0.0, spare_m))
    place = made("bench_narrow", {"walls": [*fenced(8.0, 4.4), *walls], "start": start(-3.0, 0.0)})
    with Course(name, place.starting_at(begin), seed, options) as course:
        course.wait_until_active()
        for number, leaf_m in enumerate((low_m, spare_m - low_m)):
            if leaf_m > 0.03:
                side = (-1.0, 1.0)[number]
                at_m = y_m + side * (on_map_m - leaf_m) / 2.0
                # A gap of 1 cm at the wall: what touches is refused.
                course.put_box(f"leaf_{number}", SE2(0.0, at_m - side * 0.005, 0.0),
                               (0.05, leaf_m - 0.01), 1.0)  # fmt: skip
        gap_y_m = y_m - on_map_m / 2.0 + low_m + width_m / 2.0
        row = course.drive(goal, limit_s=120.0)
    row.extra |= {"width_m": round(width_m, 3), "on_map_m": round(on_map_m, 2),
                  "other_way": opening.other_y_m is not None}  # fmt: skip
    if width_m <= NARROW_M[1] and opening.other_y_m is None:
        found = _WIDTH.search(row.error_msg)
        told_m = None if found is None else float(found[1])
        named = nearest_named_m(row.error_msg, (0.0, gap_y_m))
        row.extra |= {"named_m": named, "told_width_m": told_m, "refused_s": row.time_s}
        row.success = (
            row.error_code == ErrorCode.NO_VALID_PATH and "too narrow" in row.error_msg
            and named is not None and named <= 0.35
            and told_m is not None and abs(told_m - width_m) <= 0.06
            and not row.contacts_robot and row.time_s <= REFUSED_WITHIN_S
        )  # fmt: skip
    return row

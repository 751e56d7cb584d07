"""Things that the lidar does not see: low boxes, sills, table tops and panes, on the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from mazebot.bench.navigation.courses import bench_worlds
from mazebot.bench.navigation.courses.course import Course, rectangle
from mazebot.bench.navigation.scenario import Options, Row, RunSeed
from mazebot.bench.navigation.surroundings import PutThing
from mazebot.common.maths.frames import SE2, quaternion_from_yaw
from mazebot.common.messages.documents import BodyEntity, Box, Shape
from mazebot.common.node.node import random_generator
from mazebot.common.robot.waffle import LIDAR_HEIGHT_M

_VISIBLE, _GLASS = "plain", ""
"""Materials: what has none, the camera does not see."""
_SLIT_M = 0.01
"""Half the height of a slit through which the lidar looks past a pane."""
_PANE_M = 0.02
_PANE_TOP_M = 1.0
_BEYOND_M = 0.35
"""A robot that has come this far beyond a thing has passed it."""
_WITHIN_S = 20.0
"""After a contact with what nothing sees, the goal must have ended or the thing be passed."""
_LIMIT_S = 120.0

Part = tuple[tuple[float, float, float], tuple[float, float, float], str]
"""Sides of a box, its middle in the body's frame, and its material."""
Parts = Callable[[np.random.Generator], tuple[tuple[float, float], list[Part]]]
"""Draws a thing: its length and width, and its parts."""


def low_box(random: np.random.Generator) -> tuple[tuple[float, float], list[Part]]:
    """A box that ends below the lidar's plane."""
    x, y = (float(side) for side in random.uniform(0.15, 0.4, 2))
    height_m = float(random.uniform(0.05, LIDAR_HEIGHT_M - 0.02))
    return (x, y), [((x, y, height_m), (0.0, 0.0, height_m / 2.0), _VISIBLE)]


def sill(random: np.random.Generator) -> tuple[tuple[float, float], list[Part]]:
    """A bar of 3 cm across the way."""
    x, y = float(random.uniform(0.05, 0.12)), float(random.uniform(0.6, 1.4))
    return (x, y), [((x, y, 0.03), (0.0, 0.0, 0.015), _VISIBLE)]


def table_top(random: np.random.Generator) -> tuple[tuple[float, float], list[Part]]:
    """A board whose lower face is above the lidar's plane and below the robot's top, on legs."""
    x, y = (float(side) for side in random.uniform(0.35, 0.6, 2))
    under_m = LIDAR_HEIGHT_M + float(random.uniform(0.005, 0.012))
    board: Part = ((x, y, 0.03), (0.0, 0.0, under_m + 0.015), _VISIBLE)
    legs: list[Part] = [
        ((0.03, 0.03, under_m), (a * (x / 2.0 - 0.02), b * (y / 2.0 - 0.02), under_m / 2.0),
         _VISIBLE)
        for a in (1.0, -1.0) for b in (1.0, -1.0)
    ]  # fmt: skip
    return (x, y), [board, *legs]


def pane(width_m: float, framed: bool) -> list[Part]:
    """Glass that neither lidar nor camera sees; framed, it has a rail of 6 cm on the floor."""
    foot_m = 0.06 if framed else 0.0
    low, high = LIDAR_HEIGHT_M - _SLIT_M, LIDAR_HEIGHT_M + _SLIT_M
    spans = [(foot_m, low), (high, _PANE_TOP_M)]
    glass: list[Part] = [
        ((_PANE_M, width_m, top - bottom), (0.0, 0.0, (top + bottom) / 2.0), _GLASS)
        for bottom, top in spans
    ]
    rail: list[Part] = [((0.04, width_m, foot_m), (0.0, 0.0, foot_m / 2.0), _VISIBLE)]
    return [*glass, *rail] if framed else glass


def on_the_way(draw: Parts, count: int) -> RunSeed:
    """Drives through a room of 8 by 4 m, there and back, in which things of a kind lie on the
    straight way that the map shows.
    """

    def run(name: str, seed: int, options: Options) -> list[Row]:
        random = random_generator(seed, f"bench/{name}")
        place = bench_worlds.made(
            "bench_low", {"walls": bench_worlds.fenced(8.0, 4.0),
                          "start": bench_worlds.start(-3.2, 0.0)}
        )  # fmt: skip
        begin = SE2(-3.2, float(random.uniform(-1.0, 1.0)), float(random.uniform(-0.5, 0.5)))
        goal = SE2(3.2, float(random.uniform(-1.0, 1.0)), float(random.uniform(-math.pi, math.pi)))
        with Course(name, place.starting_at(begin), seed, options, camera=True) as course:
            put = [
                _lay(course, f"thing_{number}", _between(begin, goal, share, random), draw(random))
                for number, share in enumerate(np.linspace(0.3, 0.75, count).tolist())
            ]
            rows = [_drive(course, goal, put, options), _drive(course, begin, put, options)]
            for row in rows:
                row.extra["things"] = len(put)
            return rows

    return run


def panes(name: str, seed: int, options: Options) -> list[Row]:
    """The nearer one of two doors is closed by a pane, which for even seeds has a rail that the
    camera sees, and for odd seeds nothing that any sensor does.
    """
    random = random_generator(seed, "bench/panes")
    framed = seed % 2 == 0
    middle = [
        bench_worlds.wall(part, SE2(0.0, y_m, math.pi / 2.0), length_m)
        for part, y_m, length_m in (
            ("south", -1.9, 0.2),
            ("between", 0.0, 1.6),
            ("north", 1.9, 0.2),
        )
    ]
    place = bench_worlds.made(
        "bench_panes", {"walls": [*bench_worlds.fenced(8.0, 4.0), *middle],
                        "start": bench_worlds.start(-3.0, 0.0)}
    )  # fmt: skip
    side = 1.0 if random.uniform() < 0.5 else -1.0
    begin = SE2(-3.0, side * float(random.uniform(0.7, 1.5)), float(random.uniform(-0.5, 0.5)))
    goal = SE2(
        3.0, side * float(random.uniform(0.3, 1.5)), float(random.uniform(-math.pi, math.pi))
    )
    with Course(name, place.starting_at(begin), seed, options, camera=True) as course:
        at = SE2(0.0, side * 1.3, 0.0)
        thing = _put(course, "pane", at, (_PANE_M, 1.0), pane(1.0, framed))
        row = _drive(course, goal, [thing], options, visible=framed)
        row.extra["framed"] = framed
        return [row]


def _between(a: SE2, b: SE2, share: float, random: np.random.Generator) -> SE2:
    """A place near a share of the way between two, turned a little about the way's direction."""
    x, y = a.x_m + share * (b.x_m - a.x_m), a.y_m + share * (b.y_m - a.y_m)
    aside_m, turn = float(random.uniform(-0.1, 0.1)), float(random.uniform(-0.4, 0.4))
    return SE2(x, y + aside_m, math.atan2(b.y_m - a.y_m, b.x_m - a.x_m) + turn)


def _lay(course: Course, name: str, at: SE2, thing: tuple[tuple[float, float], list[Part]]) -> SE2:
    return _put(course, name, at, *thing)


def _put(
    course: Course, name: str, at: SE2, size_m: tuple[float, float], parts: Sequence[Part]
) -> SE2:
    """Spawn a body of boxes; its pose."""
    shapes = tuple(
        Shape(
            name=f"part_{number}", geometry=Box(size_m=sides_m), position_m=middle_m,
            material=material,
        )
        for number, (sides_m, middle_m, material) in enumerate(parts)
    )  # fmt: skip
    entity = BodyEntity(
        name=name, position_m=(at.x_m, at.y_m, 0.0), shapes=shapes,
        orientation_xyzw=quaternion_from_yaw(at.yaw_rad),
        materials=course.loaded.world.materials,
    )  # fmt: skip
    course.session.spawn(entity)
    course.around.put.append(PutThing(name, rectangle(at, size_m), course.now_s))
    return at


def _drive(
    course: Course, goal: SE2, things: Sequence[SE2], options: Options, visible: bool = True
) -> Row:
    """Drive to a goal. Where a sensor shows the things, without a contact; else with one at most,
    after which the goal ends or the thing is passed within 20 s.
    """
    visible &= options.camera
    touched, passed = list[float](), list[float]()
    begin = course.pose
    before = len(course.witness.contacts)

    def on_tick(course: Course, elapsed_s: float) -> None:
        if not touched and len(course.witness.contacts) > before:
            touched.append(elapsed_s)
        if touched and not passed:
            ahead = goal.x_m - begin.x_m
            x_m = course.pose.x_m
            place = course.witness.contacts[before].place_m
            if (x_m - place[0]) * ahead > 0.0 and abs(x_m - place[0]) > _BEYOND_M:
                passed.append(elapsed_s)

    row = course.drive(goal, [on_tick], limit_s=_LIMIT_S)
    row.extra |= {"contact_m_s": _contact_speed_m_s(course, before)}
    if not visible:
        freed_s = min([*passed, row.time_s]) - touched[0] if touched else 0.0
        row.extra["freed_s"] = round(freed_s, 2)
        ended = row.reached or row.error_code is not None
        row.success = row.contacts_robot <= 1 and ended and freed_s <= _WITHIN_S
    return row


def _contact_speed_m_s(course: Course, before: int) -> float | None:
    """The robot's true speed just before its first contact since; None: there was none."""
    contacts = course.witness.contacts[before:]
    if not contacts:
        return None
    rows = course.witness.truth_between(contacts[0].time_s - 0.2, contacts[0].time_s)
    return round(float(np.abs(rows[:, 4]).max(initial=0.0)), 3)

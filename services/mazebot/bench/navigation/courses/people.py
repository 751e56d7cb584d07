"""People who walk towards the robot in a corridor, and posts that push it to a wall."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from mazebot.bench.navigation.courses.bench_worlds import (
    BenchWorld,
    fenced,
    made,
    start,
    wall,
)
from mazebot.bench.navigation.courses.course import Course
from mazebot.bench.navigation.courses.lost import ask_for_search
from mazebot.bench.navigation.measure import Leg, fill_in
from mazebot.bench.navigation.scenario import Options, Row, Settings
from mazebot.common.client.user_messages import initial_pose
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.topics import INITIAL_POSE
from mazebot.common.node.node import random_generator

PERSON_M = 0.25
"""Radius of a person."""
_LENGTH_M, _ROOM_M = 6.0, 2.6
"""Of the corridor, and the sides of the rooms at its ends"""
_THICK_M = 0.15
_DOOR_M, _DEEP_M = 0.9, 1.0
"""Width of a side room's opening, and how far it reaches from the corridor"""
_BESIDE_WALL_M = 0.04
"""Between a person who walks on a side and the wall"""
_TOUCH_M = 0.01
"""The outline touches what is this near."""
_WIDTH_M, _DEPTH_M = 5.0, 3.6
"""Of the room with the posts"""
_FROM_M, _NEAR_WALL_M = 1.3, 0.75
"""How far away posts begin, and how far from a wall the robot is that one comes for"""
_MOST_POSTS, _ATTACKED_S = 3, 30.0
TRUTHS_PER_S = 30.0
KINDS = ("driving", "standing", "relocalising")
"""What the robot does when a post comes: by the seed, in turn"""
_GIVES_WAY: Settings = {"navigation": {"giving_way": {"enabled": True}}}


class _Walk(NamedTuple):
    width_m: float
    side_rooms: bool
    behind: bool
    speed_m_s: float
    offset_m: float
    """Of the person's way from the corridor's middle"""


def head_on(name: str, seed: int, options: Options) -> list[Row]:
    """A corridor of 6 m between two rooms, and a person who walks to and fro through it and stops
    for nobody: towards the robot first, or from behind it.
    """
    walk = _walk_of(seed)
    place = corridor_with_rooms(walk.width_m, walk.side_rooms)
    half_m = _LENGTH_M / 2.0
    far = half_m + _THICK_M + _ROOM_M - PERSON_M - 0.3
    begin = SE2(-half_m - 1.4, 0.0 if walk.behind else 0.7, 0.0)
    if walk.behind:
        begin = SE2(-half_m + 0.6, 0.0, 0.0)
    goal = SE2(half_m + 1.2, -0.85, 0.0)
    ends = [(-far, walk.offset_m), (far, walk.offset_m)]
    if not walk.behind:
        ends.reverse()
    with Course(name, place.starting_at(begin), seed, options.with_settings(_GIVES_WAY)) as course:
        course.wait_until_active()
        course.put_post("person", ends[0], [ends[1]], walk.speed_m_s, False, PERSON_M)
        row = course.drive(goal, limit_s=150.0)
        row.extra |= walk._asdict()
        return [row]


def _walk_of(seed: int) -> _Walk:
    random = random_generator(seed, "bench/head_on")
    width_m = round(float(random.uniform(1.0, 1.5)), 2)
    aside_m = width_m / 2.0 - PERSON_M - _BESIDE_WALL_M
    behind = seed % 4 == 3
    return _Walk(
        width_m,
        bool(seed // 2 % 2),
        behind,
        # One who is slower than the robot does not come up with it.
        round(float(random.uniform(0.48 if behind else 0.3, 0.6)), 2),
        round(float(random.choice([-1.0, 0.0, 1.0])) * aside_m, 3),
    )


def corridor_with_rooms(width_m: float, side_rooms: bool) -> BenchWorld:
    """A corridor along x between two rooms, with or without a room on each of its sides."""
    half_m, side_m = _LENGTH_M / 2.0, width_m / 2.0 + _THICK_M / 2.0
    end_m = half_m + _THICK_M / 2.0
    walls: list[dict[str, Any]] = []
    for x, west in ((-end_m, True), (end_m, False)):
        jamb_m = (_ROOM_M - width_m) / 2.0
        for sign in (-1.0, 1.0):
            middle_m = sign * (width_m + jamb_m) / 2.0
            label = f"jamb_{'west' if west else 'east'}_{'south' if sign < 0.0 else 'north'}"
            walls.append(wall(label, SE2(x, middle_m, math.pi / 2.0), jamb_m))
    for sign, label in ((-1.0, "south"), (1.0, "north")):
        if not side_rooms:
            walls.append(wall(f"side_{label}", SE2(0.0, sign * side_m, 0.0), _LENGTH_M))
            continue
        at_m = sign * _LENGTH_M / 6.0
        low_m, high_m = at_m - _DOOR_M / 2.0, at_m + _DOOR_M / 2.0
        for part, a, b in (("west", -half_m, low_m), ("east", high_m, half_m)):
            middle = SE2((a + b) / 2.0, sign * side_m, 0.0)
            walls.append(wall(f"side_{label}_{part}", middle, b - a))
        back_m = sign * (width_m / 2.0 + _DEEP_M + _THICK_M / 2.0)
        walls.append(wall(f"back_{label}", SE2(at_m, back_m, 0.0), _DOOR_M + 2.0 * _THICK_M))
        for part, x in (("west", low_m - _THICK_M / 2.0), ("east", high_m + _THICK_M / 2.0)):
            middle = SE2(x, sign * (width_m + _DEEP_M) / 2.0, math.pi / 2.0)
            walls.append(wall(f"cheek_{label}_{part}", middle, _DEEP_M))
    length_m = _LENGTH_M + 2.0 * (_THICK_M + _ROOM_M)
    depth_m = max(_ROOM_M, width_m + 2.0 * (_DEEP_M + _THICK_M) if side_rooms else 0.0)
    outer = fenced(length_m, depth_m)
    name = f"bench_head_on_{round(100 * width_m)}_{'rooms' if side_rooms else 'plain'}"
    return made(name, {"walls": [*outer, *walls], "start": start(-half_m, 0.0)})


def crushing_post(name: str, seed: int, options: Options) -> list[Row]:
    """Posts come one after another at 0.2 to 0.4 m/s to where the robot is beside a wall, or will
    be, and on to the wall: while it drives, stands, or has lost its pose and searches for it. The
    goal is then driven to without them.
    """
    random = random_generator(seed, "bench/crushing")
    kind = KINDS[seed % len(KINDS)]
    beside_m, yaw_rad = float(random.uniform(0.25, 0.45)), float(random.uniform(-math.pi, math.pi))
    if kind == "driving":
        yaw_rad = 0.0
    x_m = -1.9 if kind == "driving" else float(random.uniform(-1.0, 1.0))
    begin = SE2(x_m, _DEPTH_M / 2.0 - beside_m, yaw_rad)
    goal = SE2(1.9, _DEPTH_M / 2.0 - beside_m, 0.0)
    place = room(pillars=kind != "relocalising").starting_at(begin)
    posts = _Posts(random, kind)
    with Course(name, place, seed, options.with_settings(_GIVES_WAY)) as course:
        course.wait_until_active()
        start_s, here = course.now_s, course.pose
        if kind == "driving":
            row = course.drive(goal, [posts], limit_s=90.0)
        else:
            if kind == "relocalising":
                ask_for_search(course)
            while course.now_s - start_s < _ATTACKED_S:
                course.tick()
                posts(course, course.now_s - start_s)
            posts.end(course)
            if kind == "relocalising":
                _tell_pose(course)
            row = course.drive(goal, limit_s=90.0)
        leg = Leg(start_s, course.now_s, here, goal, row.shortest_m)
        fill_in(row, leg, course.witness, course.around)
        pinned_s = _pinned_s(course, posts.names, start_s)
        row.extra |= {"kind": kind, "posts": len(posts.names), "pinned_s": round(pinned_s, 2)}
        row.success = row.reached and not row.contacts_robot and pinned_s == 0.0
        return [row]


class _Posts:
    """Sends posts, one at a time, each from 1.3 m away through the robot's place to the wall that
    is nearest.
    """

    def __init__(self, random: np.random.Generator, kind: str) -> None:
        self._random, self._kind = random, kind
        self._gone_s = 0.0
        self._there = False
        self.names: list[str] = []

    def __call__(self, course: Course, elapsed_s: float) -> None:
        """See OnTick."""
        if self._there and course.now_s >= self._gone_s:
            self.end(course)
        if not self._there and len(self.names) < _MOST_POSTS and course.now_s > self._gone_s + 0.5:
            self._send(course)

    def end(self, course: Course) -> None:
        """Take away the one that is there."""
        if self._there:
            course.take_post_away(self.names[-1])
            self._there, self._gone_s = False, course.now_s

    def _send(self, course: Course) -> None:
        here = course.pose
        speed_m_s = float(self._random.uniform(0.2, 0.4))
        radius_m = float(self._random.uniform(0.12, 0.25))
        aside_m = float(self._random.uniform(-0.08, 0.08))
        walls = [
            (_WIDTH_M / 2.0 - here.x_m, (1.0, 0.0)),
            (here.x_m + _WIDTH_M / 2.0, (-1.0, 0.0)),
            (_DEPTH_M / 2.0 - here.y_m, (0.0, 1.0)),
            (here.y_m + _DEPTH_M / 2.0, (0.0, -1.0)),
        ]
        wall_m, (nx, ny) = min(walls)
        if wall_m > _NEAR_WALL_M:
            return
        if self._kind == "driving":
            # Where the robot will be when it comes.
            aside_m += 0.4 * (_FROM_M - radius_m - 0.15) / speed_m_s
        at_x, at_y = here.x_m + abs(ny) * aside_m, here.y_m + abs(nx) * aside_m
        first = at_x - _FROM_M * nx, at_y - _FROM_M * ny
        on_m = wall_m - radius_m - 0.03
        last = at_x + on_m * nx, at_y + on_m * ny
        inside = max(abs(first[0]), abs(last[0])) < _WIDTH_M / 2.0 - radius_m
        if not inside or max(abs(first[1]), abs(last[1])) >= _DEPTH_M / 2.0 - radius_m:
            return
        name = f"post_{len(self.names)}"
        if course.put_post(name, first, [last], speed_m_s, False, radius_m):
            self.names.append(name)
            self._there = True
            self._gone_s = course.now_s + (_FROM_M + on_m) / speed_m_s + 0.3


def _tell_pose(course: Course) -> None:
    """Give localization the true pose, as a user does."""
    course.session.publish(INITIAL_POSE, initial_pose(course.session, course.pose, 0.1, 0.1))
    course.run_for(1.0)


def _pinned_s(course: Course, posts: list[str], from_s: float) -> float:
    """For how long the robot's outline touched a post and a wall at once."""
    truth = course.witness.truth_between(from_s, math.inf)
    times_s, poses = truth[:, 0], truth[:, 1:4]
    at_wall = course.around.distance_to_m("walls", from_s, poses) <= _TOUCH_M
    at_post = np.zeros(len(truth), np.bool_)
    for name in posts:
        at_post |= course.around.distances_to_post_m(name, times_s, poses) <= _TOUCH_M
    return float(np.count_nonzero(at_post & at_wall)) / TRUTHS_PER_S


def room(pillars: bool) -> BenchWorld:
    """A room of 5 by 3.6 m; with pillars no pose in it looks like another, without them each looks
    like the one opposite, so that no search for a pose ends.
    """
    recipe: dict[str, Any] = {"walls": fenced(_WIDTH_M, _DEPTH_M), "start": start(0.0, 0.0)}
    if pillars:
        recipe["cylinders"] = [
            {"name": "pillar_a", "x_m": -2.1, "y_m": -1.3, "radius_m": 0.2, "height_m": 1.0},
            {"name": "pillar_b", "x_m": 0.9, "y_m": -1.6, "radius_m": 0.12, "height_m": 1.0},
        ]
    return made(f"bench_crushing_{'pillars' if pillars else 'empty'}", recipe)

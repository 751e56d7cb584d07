"""Things that are dropped on the way, taken away, or go to and fro across it; doors that close."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import shapely

from mazebot.bench.navigation.courses import bench_worlds
from mazebot.bench.navigation.courses.bench_worlds import DOOR_WIDTH_M, BenchWorld
from mazebot.bench.navigation.courses.course import Course, rectangle
from mazebot.bench.navigation.courses.tours import random_poses, tour_of
from mazebot.bench.navigation.scenario import Options, Row, RunSeed, Settings
from mazebot.bench.navigation.surroundings import Surroundings
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import GLOBAL_COSTMAP, PLAN
from mazebot.common.node.node import random_generator
from mazebot.recorder.judging.goals.shortest_path import ShortestPath

AHEAD_M = 1.2
ROOM_M = 0.28
"""Half of the width that a way round a dropped box must have: a circle of this radius passes."""
APART_M = 1.2
"""Least distance between the places where two posts cross the way."""
_LETHAL = 100


def _mppi(prediction: bool) -> Settings:
    server = {"controller": "mppi", "mppi": {"prediction": prediction}}
    return {"navigation": {"controller_server": server}}


PREDICTED, UNPREDICTED = _mppi(True), _mppi(False)
DOOR = "door"
CLOSED_CODES = (208, 106, 105, 104)
"""Codes that say that there is no way: of the planner, or of the controller before the door."""


def dropped_boxes(name: str, seed: int, options: Options) -> list[Row]:
    """The tour of the original world; on each leg a box of 0.2 to 0.35 m falls on the robot's path
    1.2 m ahead of it, where it leaves a way round. Boxes are taken away after the leg.
    """
    random = random_generator(seed, "bench/boxes")
    with Course(name, BenchWorld("original"), seed, options) as course:
        rows = []
        for number, goal in enumerate(tour_of(course)[:4]):
            drop = _Drop(f"box_{number}", goal, random)
            row = course.drive(goal, [drop])
            row.extra["dropped"] = drop.place is not None
            if drop.place is not None:
                course.take_away(drop.name)
                course.run_for(1.0)
            rows.append(row)
        return rows


class _Drop:
    """Drops one box on the path, as soon as there is room for a way round."""

    def __init__(self, name: str, goal: SE2, random: np.random.Generator) -> None:
        self.name, self._goal = name, goal
        self.place: SE2 | None = None
        self._side_m = float(random.uniform(0.2, 0.35))
        self._yaw_rad = float(random.uniform(0.0, math.pi / 2.0))
        self._after_m = float(random.uniform(0.3, 1.5))
        self._start: SE2 | None = None
        self._tried_s = 0.0

    def __call__(self, course: Course, elapsed_s: float) -> None:
        """See OnTick."""
        here = course.pose
        self._start = self._start or here
        far = here.distance_m(self._start) >= self._after_m
        if self.place is not None or not far or elapsed_s - self._tried_s < 0.2:
            return
        self._tried_s = elapsed_s
        spot = _on_path(course, here)
        if spot is None or math.dist(spot, self._goal[:2]) < 0.7:
            return
        pose = SE2(*spot, self._yaw_rad)
        size_m = (self._side_m, self._side_m)
        solids = np.array([*course.around.solids, rectangle(pose, size_m)], object)
        if ShortestPath(solids, ROOM_M).length_m(here[:2], self._goal[:2]) is None:
            return
        if course.put_box(self.name, pose, size_m):
            self.place = pose


def _on_path(course: Course, here: SE2) -> tuple[float, float] | None:
    """The place on the robot's own path that is 1.2 m ahead of it along the path."""
    plan = course.session.latest(PLAN)
    if plan is None or len(plan.poses) < 2:
        return None
    way = np.array([(one.pose.position.x, one.pose.position.y) for one in plan.poses])
    nearest = int(np.argmin(np.hypot(*(way - here[:2]).T)))
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way[nearest:], axis=0).T))])
    if along_m[-1] < AHEAD_M:
        return None
    x_m, y_m = (float(np.interp(AHEAD_M, along_m, column)) for column in way[nearest:].T)
    return x_m, y_m


def box_removed(name: str, seed: int, options: Options) -> list[Row]:
    """A box stands in view of a robot at rest, and is taken away: how long the global costmap still
    has it.
    """
    random = random_generator(seed, "bench/removed")
    place = BenchWorld("original")
    with Course(name, place, seed, options) as course:
        course.wait_until_active()
        course.run_for(1.0)
        row = Row(name, place.shown, seed, 0)
        spot = _spot_in_view(course, random)
        # A return marks the cell that it is in, whose centre may lie before the face.
        cells = rectangle(spot, (0.3, 0.3)).buffer(0.04)
        with course.session.watching(GLOBAL_COSTMAP) as maps:
            before = course.session.latest(GLOBAL_COSTMAP)
            course.put_box("box", spot, (0.3, 0.3))
            course.run_for(3.0)
            marked = [one for one in maps[-1:] if _lethal(one, cells, before)]
            maps.clear()
            course.take_away("box")
            gone_s = course.now_s
            cleared_s = None
            while marked and cleared_s is None and course.now_s - gone_s < 20.0:
                course.tick()
                if maps and not _lethal(maps[-1], cells, before):
                    cleared_s = msg.ns_from_time(maps[-1].header.stamp) * 1e-9 - gone_s
        row.extra = {"marked": bool(marked), "cleared_s": cleared_s}
        row.time_s = course.now_s
        row.success = bool(marked) and cleared_s is not None and cleared_s <= 1.0
        return [row]


def _spot_in_view(course: Course, random: np.random.Generator) -> SE2:
    """A place 0.7 to 2 m away with nothing between, and room for a box of 0.3 m."""
    here = course.pose
    while True:
        bearing = float(random.uniform(-math.pi, math.pi))
        ahead_m = float(random.uniform(0.7, 2.0))
        at = here @ SE2(ahead_m * math.cos(bearing), ahead_m * math.sin(bearing), 0.0)
        sight = shapely.LineString([here[:2], at[:2]])
        clear = not any(shapely.intersects(one, sight) for one in course.around.solids)
        if clear and course.around.point_clearance_m(*at[:2]) > 0.35:
            return SE2(at.x_m, at.y_m, 0.0)


def _lethal(
    grid: msg.OccupancyGrid, area: shapely.Polygon, before: msg.OccupancyGrid | None
) -> bool:
    """Whether cells in an area are lethal that were not before."""
    cells = msg.cells_from_grid(grid)
    lethal = np.asarray(cells) >= _LETHAL
    if before is not None:
        old = np.asarray(msg.cells_from_grid(before))
        if old.shape == lethal.shape:
            lethal &= old < _LETHAL
    rows, columns = np.nonzero(lethal)
    origin, side_m = msg.se2_from_pose(grid.info.origin), grid.info.resolution
    places = [origin @ SE2((c + 0.5) * side_m, (r + 0.5) * side_m, 0.0)
              for r, c in zip(rows.tolist(), columns.tolist(), strict=True)]  # fmt: skip
    return any(shapely.contains_xy(area, one.x_m, one.y_m) for one in places)


def patrols(yields: bool, posts: int = 5, settings: Settings | None = None) -> RunSeed:
    """The tour of the original world, with posts that go to and fro across the way, from wall to
    wall, at 0.2 to 0.5 m/s.
    """

    def run(name: str, seed: int, options: Options) -> list[Row]:
        random = random_generator(seed, "bench/patrols")
        own = options if settings is None else options.with_settings(settings)
        with Course(name, BenchWorld("original"), seed, own) as course:
            put = _put_posts(course, random, posts, yields)
            rows = [course.drive(goal) for goal in tour_of(course)[:4]]
            for row in rows:
                row.extra["posts"] = put
            return rows

    return run


def _put_posts(course: Course, random: np.random.Generator, posts: int, yields: bool) -> int:
    """Put posts across the ways of the tour, away from its goals; their number."""
    goals = [course.pose, *tour_of(course)]
    ways = [course.around.paths(0.0).path(a[:2], b[:2]) for a, b in itertools.pairwise(goals)]
    known = [way for way in ways if way is not None]
    spots = list[tuple[float, float]]()
    for _ in range(300):
        if len(spots) == posts:
            break
        way = known[int(random.integers(len(known)))]
        radius_m, speed = float(random.uniform(0.1, 0.16)), float(random.uniform(0.2, 0.5))
        spot, across = place_on(way, float(random.uniform(0.15, 0.85)))
        if min(math.dist(spot, goal[:2]) for goal in goals) < 0.9:
            continue
        if min((math.dist(spot, other) for other in spots), default=math.inf) < APART_M:
            continue
        ends = widest_across(course.around, spot, across, radius_m + 0.05)
        # Beside a post that stands at one wall the robot must fit through.
        if ends is None or math.dist(*ends) < 0.65:
            continue
        if course.put_post(f"post_{len(spots)}", ends[0], [ends[1]], speed, yields, radius_m):
            spots.append(spot)
    return len(spots)


def place_on(way: Array, share: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """The place at a share of a way's length, and the direction across it there."""
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    at_m = share * along_m[-1]
    x, y = (float(np.interp(at_m, along_m, column)) for column in way.T)
    leg = min(int(np.searchsorted(along_m, at_m, side="right")), len(way) - 1)
    dx, dy = (way[leg] - way[leg - 1]).tolist()
    length_m = math.hypot(dx, dy) or 1.0
    return (x, y), (-dy / length_m, dx / length_m)


def widest_across(
    around: Surroundings, spot: tuple[float, float], across: tuple[float, float], margin_m: float
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Both ends of a line across the way, a margin before the walls; None where it is too wide."""
    ends = []
    for sign in (1.0, -1.0):
        far = spot[0] + sign * 1.5 * across[0], spot[1] + sign * 1.5 * across[1]
        ray = shapely.LineString([spot, far])
        hits = [shapely.distance(shapely.Point(spot), shapely.intersection(one, ray))
                for one in around.solids if shapely.intersects(one, ray)]  # fmt: skip
        free_m = min(hits, default=1.5) - margin_m
        if free_m < 0.0:
            return None
        ends.append((spot[0] + sign * free_m * across[0], spot[1] + sign * free_m * across[1]))
    return ends[0], ends[1]


def _close(course: Course) -> None:
    course.put_box(DOOR, SE2(0.0, 0.0, 0.0), (0.15, DOOR_WIDTH_M - 0.02), 1.0)


def unreachable_goal(name: str, seed: int, options: Options) -> list[Row]:
    """The only door to the goal closes while the robot drives to it. For even seeds for good: the
    goal has to end within 20 s with a code that says so and a text that names the place. For odd
    seeds it opens again after 8 s: the robot has to go on and arrive.
    """
    opens = seed % 2 == 1
    row, closed_s = _through_door(name, seed, options, 8.0 if opens else math.inf)
    row.extra["opens"] = opens
    if not opens:
        took_s = row.time_s - closed_s
        named_m = nearest_named_m(row.error_msg, (0.0, 0.0))
        row.extra |= {"took_s": round(took_s, 2), "named_m": named_m}
        row.success = (
            row.error_code in CLOSED_CODES and took_s <= 20.0 and named_m is not None
            and named_m <= 0.75 and not row.contacts_robot
        )  # fmt: skip
    return [row]


def door_closed_15s(name: str, seed: int, options: Options) -> list[Row]:
    """The only door to the goal is closed for 15 s while the robot drives to it, then opens."""
    row, _ = _through_door(name, seed, options, 15.0)
    return [row]


def _through_door(name: str, seed: int, options: Options, closed_for_s: float) -> tuple[Row, float]:
    random = random_generator(seed, "bench/door")
    close_s = float(random.uniform(1.0, 3.0))
    goal = SE2(2.5, float(random.uniform(-1.2, 1.2)), float(random.uniform(-math.pi, math.pi)))
    place = bench_worlds.two_rooms()
    begin = SE2(-3.2, float(random.uniform(-1.2, 1.2)), float(random.uniform(-math.pi, math.pi)))
    closed = list[float]()
    opened = list[float]()

    def on_tick(course: Course, elapsed_s: float) -> None:
        if not closed and elapsed_s >= close_s and course.pose.x_m < -0.6:
            _close(course)
            closed.append(elapsed_s)
        elif closed and not opened and elapsed_s >= closed[0] + closed_for_s:
            course.take_away(DOOR)
            opened.append(elapsed_s)

    with Course(name, place.starting_at(begin), seed, options) as course:
        return course.drive(goal, [on_tick], limit_s=180.0), closed[0] if closed else math.nan


_PLACE = re.compile(r"\(\s*(-?\d+(?:\.\d+)?)\s*,\s*(-?\d+(?:\.\d+)?)")


def places_in(text: str) -> list[tuple[float, float]]:
    """The places that a text names, as `(x, y` in metres."""
    return [(float(x), float(y)) for x, y in _PLACE.findall(text)]


def nearest_named_m(text: str, place: tuple[float, float]) -> float | None:
    """Distance of the nearest place that a text names; None where it names none."""
    return min((math.dist(one, place) for one in places_in(text)), default=None)


def occupied_goals(name: str, seed: int, options: Options) -> list[Row]:
    """Goals in walls: each has to be refused within 100 ms with its code, and a text that names the
    place and the nearest free one.
    """
    random = random_generator(seed, "bench/occupied")
    rows = []
    with Course(name, BenchWorld("original"), seed, options) as course:
        walls = course.loaded.world.walls
        for _ in range(4):
            one = walls[int(random.integers(len(walls)))]
            along_m = float(random.uniform(-0.4, 0.4)) * one.length_m
            at = one.map_from_wall() @ SE2(along_m, 0.0, 0.0)
            row = course.drive(SE2(at.x_m, at.y_m, 0.0), limit_s=30.0, contacts_fail=False)
            places = places_in(row.error_msg)
            free = [place for place in places if course.around.point_clearance_m(*place) > 0.13]
            row.extra = {"names_place": bool(places), "names_free_place": bool(free)}
            row.success = row.error_code == 206 and row.time_s <= 0.1 and bool(free)
            rows.append(row)
    return rows


def false_alarms(name: str, seed: int, options: Options) -> list[Row]:
    """Random goals among three yielding posts, for six minutes: a pose near the truth must never be
    given up.
    """
    random = random_generator(seed, "bench/alarms")
    with Course(name, BenchWorld("original"), seed, options) as course:
        _put_posts(course, random, 3, yields=True)
        rows = list[Row]()
        for goal in random_poses(course, seed, 100):
            if course.now_s >= 360.0:
                break
            row = course.drive(goal)
            row.success = row.alarms == 0
            rows.append(row)
        return rows

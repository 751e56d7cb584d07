"""Robots that do not know where they are: carried away in mid-drive, or started with no pose."""

from __future__ import annotations

import itertools
import math

import numpy as np

from mazebot.bench.navigation.courses.bench_worlds import BenchWorld
from mazebot.bench.navigation.courses.course import Course, pose_apart
from mazebot.bench.navigation.courses.tours import random_poses
from mazebot.bench.navigation.scenario import Options, Row, RunSeed
from mazebot.bench.whole.soak import reachable_goals
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import Empty
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.common.messages.topics import (
    EXPLORATION_STATUS,
    MAP,
    REINITIALIZE_GLOBAL_LOCALIZATION,
)
from mazebot.common.node.executive import StalledError
from mazebot.common.node.node import random_generator
from mazebot.embedded.session import RefusedError
from mazebot.recorder.judging.map.true_map import Lattice, MapShares, true_map

KIDNAP_AFTER_S = 4.0
_EXPLORED_S = 400.0
FOUND_M = 0.10
FOUND_RAD = 0.10
HOLDS_S = 1.0
"""A pose counts as found when it stays within these bounds for this long."""


class _Kidnap:
    """Carries the robot away some seconds after the goal was sent, and watches what it claims."""

    def __init__(self, target: SE2) -> None:
        self.target = target
        self.at_s: float | None = None
        self.noticed_s: float | None = None
        self.found_s: float | None = None
        self.wrong_s = 0.0
        """Time for which navigation was active with a pose over 0.5 m wrong"""
        self._good_since_s: float | None = None

    def __call__(self, course: Course, elapsed_s: float) -> None:
        """See OnTick."""
        if self.at_s is None:
            if elapsed_s >= KIDNAP_AFTER_S:
                course.session.move_robot(*self.target)
                self.at_s = course.now_s
            return
        self.watch(course, course.now_s - self.at_s)

    def watch(self, course: Course, since_s: float) -> None:
        """See what is claimed now."""
        claim, active = course.witness.claimed(), course.is_active()
        if not active and self.noticed_s is None:
            self.noticed_s = since_s
        if claim is None:
            return
        error_m, error_rad = pose_apart(claim, course.pose)
        if active and error_m > 0.5 and since_s > 2.0:
            self.wrong_s += 0.05
        # Claims are up to 0.1 s old, in which the robot drives up to 5 cm.
        good = active and error_m <= FOUND_M + 0.05 and error_rad <= FOUND_RAD + 0.1
        self._good_since_s = (self._good_since_s or since_s) if good else None
        if self.found_s is None and self._good_since_s is not None:
            if since_s - self._good_since_s >= HOLDS_S:
                self.found_s = self._good_since_s

    def figures(self) -> dict[str, float | None]:
        """For the row."""
        return {
            "noticed_s": self.noticed_s,
            "found_s": self.found_s,
            "wrong_and_active_s": round(self.wrong_s, 2),
        }


def kidnap(
    world: str, turned: bool, camera: bool, within_s: float, reached_within_s: float | None = None
) -> RunSeed:
    """Carry the robot to another place in mid-drive, or turn it by 90 to 180 degrees where it is;
    it has to find itself within `within_s`, and to reach the goal, within `reached_within_s` of
    that where it is given.
    """

    def run(name: str, seed: int, options: Options) -> list[Row]:
        random = random_generator(seed, "bench/kidnap")
        with Course(name, BenchWorld(world), seed, options, camera) as course:
            goal = _far_goal(course, seed)
            watch = _Kidnap(course.pose)
            places = reachable_goals(course.loaded, seed + 1_000)
            angle = float(random.uniform(math.pi / 2.0, math.pi) * random.choice([-1.0, 1.0]))

            def on_tick(course: Course, elapsed_s: float) -> None:
                if watch.at_s is None and elapsed_s >= KIDNAP_AFTER_S:
                    here = course.pose
                    if turned:
                        watch.target = here @ SE2(0.0, 0.0, angle)
                    else:
                        far = (one.se2() for one in places)
                        watch.target = next(one for one in far if one.distance_m(here) > 1.5)
                try:
                    watch(course, elapsed_s)
                except RefusedError:
                    # A turn may reach into a wall: a moment later it will not.
                    return

            limit_s = reached_within_s or within_s + 120.0
            row = course.drive(goal, [on_tick], limit_s=KIDNAP_AFTER_S + limit_s)
            row.extra |= watch.figures() | {"within_s": within_s}
            found = watch.found_s is not None and watch.found_s <= within_s
            row.success = found and row.reached and not row.contacts_robot
            return [row]

    return run


def kidnap_mapping(world: str, least_walls_true: float) -> RunSeed:
    """Carry the robot to another place while it explores and makes a map: what it adds to it after
    that must be as right as before, and where it goes on, it has to have found itself. Where it
    cannot, as in a part that it has not seen, the exploration has to say so.
    """

    def run(name: str, seed: int, options: Options) -> list[Row]:
        random = random_generator(seed, "bench/kidnap_mapping")
        place = BenchWorld(world, (f"maze.seed={seed}",) if world.startswith("maze") else ())
        with Course(name, place, seed, options, slam=True) as course:
            course.run_for(float(random.uniform(8.0, 25.0)))
            row, here = course.row(), course.pose
            places = (one.se2() for one in reachable_goals(course.loaded, seed + 1_000))
            watch = _Kidnap(next(one for one in places if one.distance_m(here) > 1.5))
            course.session.move_robot(*watch.target)
            watch.at_s = course.now_s
            ended = _exploration(course)
            while not ended and course.now_s - watch.at_s < _EXPLORED_S:
                course.tick()
                watch.watch(course, course.now_s - watch.at_s)
                ended = _exploration(course)
            row.time_s = course.now_s
            row.reached = ended is not None and ended.state == "complete"
            row.error_msg = "not ended" if ended is None else "" if row.reached else ended.reason
            row.contacts_robot = sum(one.by_robot for one in course.witness.contacts)
            row.way = course.witness.truth_between(0.0, np.inf)[::3, 1:3]
            shares = _map_shares(course)
            row.extra = watch.figures() | {
                "walls_true": shares.walls_true, "walls_found": shares.walls_found
            }  # fmt: skip
            row.success = (
                ended is not None
                and (shares.walls_true or 0.0) >= least_walls_true
                and watch.wrong_s == 0.0
                and not row.contacts_robot
            )
            return [row]

    return run


def _exploration(course: Course) -> ExplorationStatus | None:
    """How the exploration has ended; None: it goes on."""
    status = course.session.latest(EXPLORATION_STATUS)
    return status if status is not None and status.state in ("complete", "failed") else None


def _map_shares(course: Course) -> MapShares:
    """How right the robot's map is."""
    grid = course.session.latest(MAP)
    assert grid is not None
    truth = true_map(course.loaded.world, course.loaded.meshes)
    origin = msg.se2_from_pose(grid.info.origin)
    cells = np.array(msg.cells_from_grid(grid), np.int8)
    return Lattice(truth, float(grid.info.resolution), origin).judge(cells, origin)


def _far_goal(course: Course, seed: int) -> SE2:
    """A reachable goal far enough that the robot is still driving when it is carried away."""
    here = course.pose
    for one in itertools.islice(reachable_goals(course.loaded, seed), 500):
        goal = one.se2()
        if (course.around.shortest_m(here, goal, 0.0) or 0.0) > 4.0:
            return goal
    raise ValueError(f"{course.place.shown}: no goal is farther than 4 m")


def unknown_start(place: BenchWorld, camera: bool, within_s: float) -> RunSeed:
    """A start at a random unknown pose; the robot has to find itself within a time, and
    may move to find out.
    """

    def run(name: str, seed: int, options: Options) -> list[Row]:
        world = place
        if place.name == "maze":
            world = BenchWorld(place.name, (*place.overrides, f"maze.seed={seed}"))
        with Course(name, world, seed, options, camera) as course:
            (target,) = random_poses(course, seed + 2_000, 1)
            # What the world says of the start is wrong, and the search is asked for as by
            # `mazebot localize --global`.
            course.session.move_robot(*target)
            course.run_for(0.5)
            asked = ask_for_search(course)
            row = Row(name, course.place.shown, seed, 0, scene=course.around.outlines())
            watch = _Kidnap(target)
            watch.at_s = course.now_s
            while course.now_s - watch.at_s < within_s and watch.found_s is None:
                course.tick()
                watch.watch(course, course.now_s - watch.at_s)
            row.time_s = course.now_s
            row.extra = watch.figures() | {"within_s": within_s, "search_asked": asked}
            del row.extra["noticed_s"]
            claim = course.witness.claimed()
            if claim is not None:
                row.extra["error_m"] = round(pose_apart(claim, course.pose)[0], 3)
            contacts = course.witness.contacts
            row.contacts_robot = sum(one.by_robot for one in contacts)
            row.way = course.witness.truth_between(0.0, np.inf)[::3, 1:3]
            row.reached = watch.found_s is not None
            row.success = row.reached and not row.contacts_robot
            return [row]

    return run


def ask_for_search(course: Course) -> bool:
    """Ask localisation to search the whole map; whether it answered."""
    try:
        return not course.session.ask(REINITIALIZE_GLOBAL_LOCALIZATION, Empty()).error
    except StalledError:
        return False

"""One run of the whole robot in one world, watched by the ground truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

import shapely

from mazebot.bench.navigation.courses.bench_worlds import BenchWorld
from mazebot.bench.navigation.measure import Leg, fill_in
from mazebot.bench.navigation.scenario import Options, Row
from mazebot.bench.navigation.surroundings import Post, PutThing, Surroundings
from mazebot.bench.navigation.witness import Witness
from mazebot.common.maths.frames import MAP_FRAME, SE2, quaternion_from_yaw
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    BodyEntity,
    Box,
    Cylinder,
    NavigationResult,
    ScriptedPath,
    Shape,
)
from mazebot.common.messages.topics import (
    ACTION_RESULT,
    GOAL_POSE,
    NAVIGATION_STATUS,
    SEND_GOAL,
)
from mazebot.common.robot.waffle import MAX_LINEAR_M_S
from mazebot.embedded.session import RefusedError, Session
from mazebot.physics.config import STEPS_PER_SECOND

TICK_S = 0.05
_STEPS = round(TICK_S * STEPS_PER_SECOND)
ACTIVE_WITHIN_S = 10.0
"""Simulation time to wait for navigation before a goal is sent all the same."""
POST_HEIGHT_M = 1.0
BOX_HEIGHT_M = 0.5

OnTick = Callable[["Course", float], None]
"""Called every 0.05 s of simulation with the course and the time since the goal was sent."""


class Course:
    """A session whose robot is driven to goals while things happen around it."""

    def __init__(
        self,
        scenario: str,
        place: BenchWorld,
        seed: int,
        options: Options,
        camera: bool = False,
        **physics: Any,
    ) -> None:
        """Load the world. Raises ConfigError where that cannot be done."""
        self.scenario, self.seed, self.place = scenario, seed, place
        self.trials = 0
        self._stack = ExitStack()
        place = self.place
        try:
            self.loaded = place.load()
            self.session: Session = self._stack.enter_context(
                Session(
                    place.name,
                    seed,
                    camera=camera and options.camera,
                    overrides=place.overrides,
                    worlds_dir=place.worlds_dir,
                    settings=options.settings,
                    **physics,
                )
            )
            self.around = Surroundings(self.loaded)
            self.witness = Witness(self.session, self.around, self._stack)
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Course:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def now_s(self) -> float:
        """Simulation time."""
        return self.session.now_s

    @property
    def pose(self) -> SE2:
        """The robot's true pose."""
        return self.session.ground_truth()

    def tick(self) -> None:
        """Advance by 0.05 s."""
        self.session.step(_STEPS)
        self.witness.take()

    def run_for(self, duration_s: float) -> None:
        """Advance by a duration."""
        for _ in range(round(duration_s / TICK_S)):
            self.tick()

    def is_active(self) -> bool:
        """Whether navigation is ready for a goal."""
        status = self.session.latest(NAVIGATION_STATUS)
        return status is not None and status.navigation_active

    def wait_until_active(self, within_s: float = ACTIVE_WITHIN_S) -> bool:
        """Wait for navigation to become active."""
        end_s = self.now_s + within_s
        while not self.is_active() and self.now_s < end_s:
            self.tick()
        return self.is_active()

    def drive(
        self,
        goal: SE2,
        on_tick: Sequence[OnTick] = (),
        limit_s: float | None = None,
        contacts_fail: bool = True,
        settle_s: float = 0.0,
        until: Callable[[], bool] = lambda: False,
    ) -> Row:
        """Send a goal and watch until it has ended, its time is over, or `until` is true."""
        self.wait_until_active()
        start_s, start = self.now_s, self.pose
        shortest_m = self.around.shortest_m(start, goal, start_s)
        if limit_s is None:
            limit_s = 45.0 + 3.0 * (shortest_m or start.distance_m(goal)) / MAX_LINEAR_M_S
        stamp_ns = self.send(goal)
        result = None
        while result is None and self.now_s - start_s < limit_s and not until():
            self.tick()
            for call in on_tick:
                call(self, self.now_s - start_s)
            result = self.witness.results.get(stamp_ns)
        end_s = self.now_s
        row = self.row()
        _note(row, result, limit_s)
        self.run_for(settle_s)
        if result is None and not until():
            self._cancel()
        leg = Leg(start_s, end_s, start, goal, shortest_m)
        fill_in(row, leg, self.witness, self.around)
        row.success = row.reached and not (contacts_fail and row.contacts_robot)
        return row

    def act(self, goal: act.ActionGoal, row: Row, limit_s: float) -> act.ActionResult | None:
        """Send an action and wait for its end, and note its code; None: there is no result."""
        sent = act.SendGoal(goal_id=f"bench_{goal.action}", goal=goal)
        reply = self.session.ask(SEND_GOAL, sent)
        row.error_code, row.error_msg = reply.error_code, reply.error_msg
        if not reply.accepted:
            return None
        start_s = self.now_s
        with self.session.watching(ACTION_RESULT) as results:
            while not results and self.now_s - start_s < limit_s:
                self.tick()
        result = results[0] if results else None
        _note(row, result, limit_s)
        return result

    def send(self, goal: SE2) -> int:
        """Send a goal; its stamp."""
        # Stamps identify goals: two must not share one.
        self.session.step(1)
        header = msg.header(round(self.now_s * 1e9), MAP_FRAME)
        self.session.publish(
            GOAL_POSE, msg.PoseStamped(header=header, pose=msg.pose_from_se2(goal))
        )
        return msg.ns_from_time(header.stamp)

    def put_box(
        self, name: str, pose: SE2, size_m: tuple[float, float], height_m: float = BOX_HEIGHT_M
    ) -> bool:
        """Spawn a box on the floor; whether there was room for it."""
        shape = Shape(name="box", geometry=Box(size_m=(*size_m, height_m)), material="")
        box = BodyEntity(
            name=name,
            position_m=(pose.x_m, pose.y_m, height_m / 2.0),
            orientation_xyzw=quaternion_from_yaw(pose.yaw_rad),
            shapes=(shape,),
        )
        if not self._spawn(box):
            return False
        self.around.put.append(PutThing(name, rectangle(pose, size_m), self.now_s))
        return True

    def take_away(self, name: str) -> None:
        """Remove a box."""
        self.session.remove(name)
        for thing in self.around.put:
            if thing.name == name:
                thing.until_s = min(thing.until_s, self.now_s)

    def put_post(
        self,
        name: str,
        start_m: tuple[float, float],
        waypoints_m: Sequence[tuple[float, float]],
        speed_m_s: float,
        yields: bool,
        radius_m: float,
    ) -> bool:
        """Spawn a cylinder that goes to and fro; whether there was room for it."""
        shape = Shape(
            name="post",
            geometry=Cylinder(radius_m=radius_m, length_m=POST_HEIGHT_M),
            material="",
        )
        path = ScriptedPath(waypoints_m=tuple(waypoints_m), speed_m_s=speed_m_s, yields=yields)
        post = BodyEntity(
            name=name, position_m=(*start_m, POST_HEIGHT_M / 2.0), shapes=(shape,), path=path
        )
        if not self._spawn(post):
            return False
        self.around.posts[name] = Post(name, radius_m)
        return True

    def take_post_away(self, name: str) -> None:
        """Remove a cylinder that goes to and fro."""
        self.session.remove(name)
        self.around.posts[name].until_s = self.now_s

    def _spawn(self, entity: BodyEntity) -> bool:
        try:
            self.session.spawn(entity)
        except RefusedError:
            return False
        return True

    def row(self) -> Row:
        """The row of the next trial."""
        row = Row(self.scenario, self.place.shown, self.seed, self.trials)
        if not self.trials:
            row.scene = self.around.outlines()
        self.trials += 1
        return row

    def _cancel(self) -> None:
        try:
            self.session.cancel()
        except RefusedError:
            return
        self.run_for(1.0)


def _note(row: Row, result: NavigationResult | act.ActionResult | None, limit_s: float) -> None:
    if result is None:
        row.error_msg = f"no result within {limit_s:.0f} s"
    else:
        row.error_code, row.error_msg = result.error_code, result.error_msg
        row.recoveries = result.number_of_recoveries


def rectangle(pose: SE2, size_m: tuple[float, float]) -> shapely.Polygon:
    """A rectangle about a pose."""
    x, y = size_m[0] / 2.0, size_m[1] / 2.0
    corners = (pose @ SE2(a, b, 0.0) for a, b in ((x, y), (-x, y), (-x, -y), (x, -y)))
    return shapely.Polygon([corner[:2] for corner in corners])


def pose_apart(a: SE2, b: SE2) -> tuple[float, float]:
    """Distance (m) and absolute angle (rad) between two poses."""
    turn = (a.yaw_rad - b.yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
    return a.distance_m(b), abs(turn)

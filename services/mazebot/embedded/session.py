"""A simulation in this process, controlled by a program step by step: `Session`."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

from rich.console import Console

from mazebot.bringup.config import BringupConfig
from mazebot.bringup.node import BringupNode
from mazebot.common.client.arguments import built, checks_arguments, refusal
from mazebot.common.client.robot import (
    Receive,
    Robot,
    RobotError,
    check_request,
    encoded,
    ignore,
)
from mazebot.common.client.user_messages import velocity
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import MAP_FRAME, SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    CancelGoal,
    CancelGoalReply,
    DeleteEntity,
    Entities,
    Entity,
    EntityReply,
    GetEntities,
    NavigationResult,
    Planar,
    PositiveTime,
    Quaternion,
    SetEntityState,
    SimulationControl,
    SimulationStats,
    SimulationTime,
    SpawnEntity,
    Steps,
    Vector,
)
from mazebot.common.messages.topics import (
    BY_NAME,
    CANCEL_GOAL,
    CMD_VEL,
    DELETE_ENTITY,
    EDGE,
    GET_ENTITIES,
    GOAL_POSE,
    GROUND_TRUTH_ODOM,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    SET_ENTITY_STATE,
    SIMULATION_CONTROL,
    SIMULATION_STATS,
    SPAWN_ENTITY,
    WORLD,
    WORLD_STATUS,
    Delivery,
    Query,
    Topic,
)
from mazebot.common.node.edge_client import EdgeClient
from mazebot.common.node.executive import Executive, StalledError
from mazebot.common.node.node import Envelope, Outbox
from mazebot.common.settings.load import load
from mazebot.common.stop_signals import interrupt_held_back
from mazebot.embedded.compile_progress import CompileProgress
from mazebot.embedded.compiling import compiled_side_by_side
from mazebot.embedded.demo import DemoOptions, robot_nodes, with_full_name, worldgen_config
from mazebot.embedded.watched_transport import WatchedTransport
from mazebot.physics.config import STEPS_PER_SECOND
from mazebot.physics.run_control import first_step_at
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.node import RecorderNode

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

LOCALISATION_PATIENCE_S = 10.0
"""Simulation time to wait for navigation to become active before a goal is sent."""
_STEPS_PER_COMMAND = STEPS_PER_SECOND // 20
"""Steps between two commands: the velocity watchdog stops a robot after 0.2 s without one."""
_MAX_TURNS = 1000
"""Maximum turns of the nodes at the same time until a request is answered; two or three suffice."""


class RefusedError(RobotError, ValueError):
    """A request was refused; its text is the reason in one line."""


@checks_arguments(RefusedError)
class Session(Robot):
    """A world with the robot in it, its sensors, perception and navigation, at time 0 and paused.

    Time advances only within calls that are documented to do so, in lockstep and as fast as
    possible; a run depends only on world, options, seed and calls. All requests and data use the
    queries and topics of a running stack. After `close` the time and what was published last can be
    read: all else raises RefusedError.

    One thread advances it at a time. What asks or advances raises RefusedError in another one
    meanwhile, and where a step of it is under way, as in `receive` of `watch`; to publish, to watch
    and to read what was published is possible there.

        with Session("enhanced", seed=7) as session:
            result = session.goal(0.5, -0.9)
            print(result.error_code, session.ground_truth(), session.stats.state_hash)
    """

    def __init__(
        self,
        world: str = "enhanced",
        seed: int = 7,
        *,
        camera: bool = True,
        use_aruco: bool = True,
        overrides: str | Sequence[str] = (),
        worlds_dir: Path | None = None,
        out_dir: Path | None = None,
        settings: Path | None = None,
        controller: str | None = None,
        slam: bool = False,
        explore: bool = True,
        map_file: Path | None = None,
        **physics: object,
    ) -> None:
        """Load a world.

        Args:
            world: its name, as for `mazebot demo --world`.
            seed: of every random stream.
            camera: whether images are rendered and markers detected.
            use_aruco: whether the world keeps its markers.
            overrides: `field=value`, overrides the world's recipe.
            worlds_dir: folder of the worlds; None: the one of Mazebot.
            out_dir: folder for the recording; None: no recording.
            settings: a settings file, as for `mazebot demo --config`.
            controller: its name or your own, as for `mazebot demo --controller`.
            slam: whether the robot gets no map, and mapping makes one.
            explore: with `slam`, whether the explorer sends goals as soon as time advances.
            map_file: YAML file of a map to drive in, instead of the world's own.
            physics: fields of PhysicsConfig by name, e.g. `scan_noise_m=0.0`.

        Raises ConfigError, in one line, for an invalid option or a world that cannot be loaded.
        """
        options = DemoOptions(
            seed=seed,
            camera=camera,
            worlds_dir=worlds_dir,
            renderer="auto" if camera else "none",
            settings=settings,
            controller=controller,
            map_file=map_file,
        )
        asked = {
            "world_name": world, "use_aruco": use_aruco, "world_overrides": overrides,
            "slam": slam, "explore": explore, "only_ask": True,
        }  # fmt: skip
        names = {"world_name": "world", "world_overrides": "overrides"}
        bringup = built(BringupConfig, asked, names=names)
        bringup = with_full_name(bringup, worldgen_config(options).worlds_dir)
        nodes = [*robot_nodes(options, physics, slam=slam), BringupNode(bringup)]
        if out_dir is not None:
            recorder = {"seed": seed, "out_dir": out_dir}
            nodes.append(RecorderNode(load(RecorderConfig, "recorder", (), recorder)))
        self._transport = WatchedTransport()
        self._executive = Executive(nodes, self._transport)
        self._outbox = Outbox(EdgeClient(), self._transport.send)
        self.navigators = itertools.count(1)
        """Numbers the `Navigator`s of this session, so that no two goals have one id."""
        self._closed = False
        self._lock = threading.RLock()
        """Of the thread that advances it."""
        self._turning: int | None = None
        """The thread by which a step is under way."""
        self._raised: BaseException | None = None
        """What a receiver of `watch` has raised in that step."""
        self._is_loaded = False
        self._compiling = ExitStack()
        try:
            progress = CompileProgress(Console(stderr=True))
            self._compiling.enter_context(compiled_side_by_side(progress))
            self.pause()
            self._turn_until(self._has_world, "the world")
            self._is_loaded = True
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the run, and what another thread waits for in it. Calling it again does nothing."""
        if self._closed:
            return
        self._check_no_step()
        self._closed = True
        with self._lock:
            self._executive.close()
            self._compiling.close()

    @property
    def stats(self) -> SimulationStats:
        """Time, steps, seed, epoch and hashes."""
        return self._control()

    def now_ns(self) -> int:
        """See Robot."""
        return self._executive.now_ns

    @property
    def now_s(self) -> float:
        """Simulation time."""
        return self._executive.now_ns * 1e-9

    def step(self, steps: Steps = 1) -> SimulationStats:
        """Advance by this number of steps of 1/240 s."""
        return self._control(step=steps)

    def run_for(self, duration_s: SimulationTime) -> SimulationStats:
        """Advance by a duration, rounded up to whole steps."""
        return self._control(run_until_s=self.now_s + duration_s)

    def run_until(self, time_s: SimulationTime) -> SimulationStats:
        """Advance to a simulation time, or to the first step after it."""
        if first_step_at(time_s) < first_step_at(self.now_s):
            what = f"must not be before now, {self.now_s:.6g} s"
            raise RefusedError(refusal("time_s", what, time_s))
        return self._control(run_until_s=time_s)

    def pause(self) -> None:
        """Pause the simulation, as after every call that advances time."""
        self.ask(SIMULATION_CONTROL, SimulationControl(pause=True))

    def resume(self) -> None:
        """Resume: calls of `turn` then advance time."""
        self.ask(SIMULATION_CONTROL, SimulationControl(pause=False))

    def turn(self) -> bool:
        """Advance the simulation by one step unless it is paused, then step every node that is due;
        return whether any stepped.
        """
        with self._advancing():
            return self._turn()

    def reset(
        self, seed: int | None = None, scope: Literal["all", "fresh", "time"] = "all"
    ) -> SimulationStats:
        """Reset to time 0: `all` resets everything to its initial state, what was spawned to its
        first pose; with `fresh` what was spawned is gone; `time` resets only the clock.

        A seed is not for `time`; without one the random streams restart with their current seed.
        """
        stats = self._control(reset=scope, seed=seed)
        if scope != "time":
            for name, topic in BY_NAME.items():
                if topic.delivery is not Delivery.LATCHED:
                    self._transport.latest.pop(name, None)
        return stats

    def spawn(
        self, entity: Entity, allow_renaming: bool = False, assets: dict[str, str] | None = None
    ) -> EntityReply:
        """Spawn an entity; return its pose and name."""
        request = {"entity": entity, "allow_renaming": allow_renaming, "assets": assets or {}}
        return self._done(self.ask(SPAWN_ENTITY, built(SpawnEntity, request, RefusedError)))

    def move(
        self,
        name: str,
        position_m: Vector,
        orientation_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0),
    ) -> EntityReply:
        """Move an entity; return its pose."""
        state = {"name": name, "position_m": position_m, "orientation_xyzw": orientation_xyzw}
        return self._done(self.ask(SET_ENTITY_STATE, built(SetEntityState, state, RefusedError)))

    def move_robot(self, x_m: float, y_m: float, yaw_rad: float = 0.0) -> None:
        """Put the robot down at another pose in the map, at rest, as if it had been carried there:
        neither odometry nor navigation is notified.

        Raises RefusedError where it would reach into something.
        """
        self._control(robot_pose=Planar(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad))

    def remove(self, name: str) -> EntityReply:
        """Delete an entity."""
        return self._done(self.ask(DELETE_ENTITY, DeleteEntity(name=name)))

    def entities(self) -> Entities:
        """The entities in the world."""
        return self.ask(GET_ENTITIES, GetEntities())

    def goal(
        self, x_m: float, y_m: float, yaw_rad: float = 0.0, timeout_s: PositiveTime = 600.0
    ) -> NavigationResult:
        """Drive to a pose in the map, and return the result; `error_code` 0 is success.

        Raises TimeoutError after `timeout_s` of simulation without a result; the goal stays active.
        """
        with self._advancing():
            return self._driven(x_m, y_m, yaw_rad, timeout_s)

    def _driven(self, x_m: float, y_m: float, yaw_rad: float, timeout_s: float) -> NavigationResult:
        if not self._run_while(lambda: not self._is_active(), LOCALISATION_PATIENCE_S):
            raise RefusedError(
                f"goal: navigation is not active after {LOCALISATION_PATIENCE_S:g} s"
            )
        header = msg.header(self._executive.now_ns, MAP_FRAME)
        pose = msg.pose_from_se2(SE2(x_m, y_m, yaw_rad))
        with self.watching(NAVIGATION_RESULT) as results:
            self.publish(GOAL_POSE, msg.PoseStamped(header=header, pose=pose))
            # Of two goals at the same time the stamp is the same.
            asked = msg.ns_from_time(header.stamp), msg.se2_from_pose(pose)
            mine: list[NavigationResult] = []

            def is_open() -> bool:
                mine.extend(one for one in results if (one.goal_stamp_ns, one.goal.se2()) == asked)
                results.clear()
                return not mine

            if not self._run_while(is_open, timeout_s):
                raise TimeoutError(f"goal: not ended within {timeout_s:g} s of simulation")
        return mine[0]

    def cancel(self) -> CancelGoalReply:
        """Cancel the goal that is still active after a timeout of `goal`: the robot stops.

        Raises RefusedError where no goal is active.
        """
        reply = self.ask(CANCEL_GOAL, CancelGoal())
        if reply.error:
            raise RefusedError(reply.error)
        return reply

    def command(
        self, linear_m_s: float, angular_rad_s: float, for_s: PositiveTime | None = None
    ) -> None:
        """Command a velocity of base_footprint once; with `for_s`, repeatedly for that duration,
        rounded up to whole steps.

        The robot stops 0.2 s after the last command.
        """
        steps_left = math.ceil(round((for_s or 0.0) * STEPS_PER_SECOND, 6))
        with self._advancing() if steps_left > 0 else nullcontext():
            while True:
                self.publish(CMD_VEL, velocity(self, linear_m_s, angular_rad_s))
                if steps_left <= 0:
                    return
                self.step(min(_STEPS_PER_COMMAND, steps_left))
                steps_left -= _STEPS_PER_COMMAND

    def ground_truth(self) -> SE2:
        """The robot's true pose in the map, as last published: at most 1/30 s ago, also when the
        session is closed.
        """
        odom = self.latest(GROUND_TRUTH_ODOM)
        if odom is not None:
            return msg.se2_from_pose(odom.pose.pose)
        world = self.latest(WORLD)
        assert world is not None
        return world.start.se2()

    def latest(self, topic: Topic[M]) -> M | None:
        """The last message on a topic, also when the session is closed; None where there was none
        since the start.
        """
        return cast("M | None", self._transport.latest.get(topic.name))

    @contextmanager
    def watching(self, topic: Topic[M]) -> Iterator[list[M]]:
        """A list to which every message on a topic is added while the context lasts."""
        self._check_open()
        seen: list[M] = []
        end = self._transport.watch(
            (topic,), lambda _, message, __: seen.append(message), with_latched=False
        )
        try:
            yield seen
        finally:
            end()

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive = ignore) -> Callable[[], None]:
        """See Robot."""
        self._check_open()

        def take(topic: Topic[Any], message: Any, envelope: Envelope) -> None:
            try:
                receive(topic, message, envelope)
            except BaseException as error:
                if self._turning != threading.get_ident():
                    raise
                # A node in mid-step is no place to end at: it would be left with half of it done.
                self._raised = self._raised or error

        return self._transport.watch(topics, take)

    def alive(self) -> Mapping[str, frozenset[str]]:
        """See Robot."""
        nodes = () if self._closed else self._executive.nodes
        return {node.name: frozenset((node.name,)) for node in nodes}

    def wait(self, seconds: SimulationTime, until: Callable[[], bool] = lambda: False) -> None:
        """Advance by a duration, rounded up to whole steps, whatever happens meanwhile."""
        self.run_for(seconds)

    def publish(self, topic: Topic[M], message: M) -> None:
        """Publish a message on a topic of the user's tools, such as CMD_VEL, GOAL_POSE, GOAL_UPDATE
        or INITIAL_POSE.

        Raises PermissionError on another topic, RefusedError where the message is invalid.
        """
        self._check_open()
        if EDGE not in topic.owners:
            raise PermissionError(f"{topic.name}: only {' and '.join(topic.owners)} may publish it")
        try:
            encoded(topic, message)
        except RobotError as error:
            raise RefusedError(str(error)) from error
        self._outbox.now_ns = self._executive.now_ns
        self._outbox.put(topic, message)

    def _check_open(self) -> None:
        if self._closed:
            raise RefusedError("the session is closed")

    def _check_no_step(self) -> None:
        if self._turning == threading.get_ident():
            raise RefusedError("a step of this session is under way: call this after it")

    @contextmanager
    def _advancing(self) -> Iterator[None]:
        """Only this thread advances the session meanwhile.

        Raises RefusedError where another one does, or a step is under way.
        """
        self._check_open()
        self._check_no_step()
        if not self._lock.acquire(blocking=False):
            raise RefusedError("another thread advances this session")
        try:
            yield
        finally:
            self._lock.release()

    def _turn(self) -> bool:
        self._check_open()
        self._turning, self._raised = threading.get_ident(), None
        # While it loads, which may take long, there is nothing that could be left half done.
        try:
            with interrupt_held_back() if self._is_loaded else nullcontext():
                stepped = self._executive.turn()
        finally:
            self._turning = None
        if self._raised is not None:
            raise self._raised
        return stepped

    def _has_world(self) -> bool:
        status = self.latest(WORLD_STATUS)
        if status is not None and status.error:
            raise ConfigError(status.error)
        return self.latest(SIMULATION_STATS) is not None

    def _is_active(self) -> bool:
        status = self.latest(NAVIGATION_STATUS)
        return status is not None and status.navigation_active

    def _run_while(self, goes_on: Callable[[], bool], limit_s: float) -> bool:
        """Advance time until a condition is no longer true; False where the limit came first."""
        end_s = self.now_s + limit_s
        if not goes_on():
            return True
        self.resume()
        try:
            while (is_going := goes_on()) and self.now_s < end_s:
                if not self._turn() and goes_on():
                    raise StalledError("the simulation is stalled")
        except BaseException:
            self._stand_still()
            raise
        self.pause()
        return not is_going

    def _control(self, **fields: object) -> SimulationStats:
        request = built(SimulationControl, fields, RefusedError)
        try:
            reply = self.ask(SIMULATION_CONTROL, request)
        except BaseException:
            if request.step is not None or request.run_until_s is not None:
                self._stand_still()
            raise
        if reply.error:
            raise RefusedError(reply.error)
        assert reply.stats is not None
        return reply.stats

    def _stand_still(self) -> None:
        """Pause where an error, or Ctrl-C, has ended what let time pass."""
        # Closed, or whoever watches raises once more: the first error is the one to be told of.
        with suppress(Exception):
            self.pause()

    def _done(self, reply: EntityReply) -> EntityReply:
        if reply.error:
            raise RefusedError(reply.error)
        return reply

    def ask(self, query: Query[Q, A], message: Q, timeout_s: float = math.inf) -> A:
        """The reply to a query. Time advances only where the query takes time; `timeout_s` has no
        effect, because a query without a reply raises StalledError.

        Raises RefusedError where too many requests wait, or the message is not what it takes.
        """
        try:
            check_request(query, message)
        except RobotError as error:
            raise RefusedError(str(error)) from error
        answers: list[A] = []
        with self._advancing():
            if not self._transport.ask(query, message, answers.append):
                raise RefusedError(f"{query.name}: too many pending requests")
            self._turn_until(lambda: bool(answers), query.name)
        return answers[0]

    def _turn_until(self, done: Callable[[], bool], what: str) -> None:
        """Turn until a condition is true; time may advance meanwhile."""
        turns, now_ns = 0, self._executive.now_ns
        while not done():
            if not self._turn() and not done():
                raise StalledError(f"{what}: the simulation is stalled")
            turns = turns + 1 if self._executive.now_ns == now_ns else 0
            now_ns = self._executive.now_ns
            if turns > _MAX_TURNS:
                raise StalledError(f"{what}: no response")

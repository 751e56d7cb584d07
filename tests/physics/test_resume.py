"""A simulator that is started again in the middle of a run."""

from __future__ import annotations

import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    Entities,
    Entity,
    SimulationCheckpoint,
    SimulationControl,
    SimulationControlReply,
)
from mazebot.common.messages.topics import (
    CLOCK,
    CMD_VEL,
    CONTACTS,
    DESIRED_ENTITIES,
    ENTITIES,
    GROUND_TRUTH_ODOM,
    ODOM,
    SIMULATION_CHECKPOINT,
    SIMULATION_CONTROL,
    SIMULATION_STATS,
    WORLD,
)
from tests.physics.stage import OPEN, Stage, crate, names, path

WALKER = crate("walker", -2.0, -1.0, path=path((-2.0, 3.0), (-2.0, -1.0)))
BALLAST = crate("ballast", 1.0, 0.0, mass_kg=0.2)
AT_START = crate("at_start", 0.0, 0.0)


def driven(*entities: Entity) -> Stage:
    """The robot has pushed a crate ahead of it, and turned a little."""
    stage = Stage(seed=5)
    stage.load(OPEN)
    stage.desire(*entities)
    stage.drive(0.3, 0.1, 3.0)
    return stage


def again(kept: SimulationCheckpoint | None, *entities: Entity) -> Stage:
    """Another process, to which others hand over what they keep."""
    stage = Stage(seed=9)
    stage.inbox.is_handed_over = False
    stage.deliver(WORLD, OPEN)
    desired = Entities.model_construct(
        world_hash=OPEN.hash, revision=7, entities=entities, refused=()
    )
    stage.deliver(DESIRED_ENTITIES, desired)
    stage.turn()
    assert stage.node.waiting_for() is not None or stage.node._simulation is None
    if kept is not None:
        stage.deliver(SIMULATION_CHECKPOINT, kept, source="before")
    stage.inbox.hand_over()
    assert stage.inbox.wakes()
    stage.turn()
    return stage


def places(stage: Stage) -> dict[str, tuple[float, float]]:
    bodies = stage.bodies
    return {
        name: (float(pose[0, 3]), float(pose[1, 3]))
        for name, pose in zip(bodies.mover_names, bodies.map_from_movers(), strict=True)
    }


def true_pose(stage: Stage) -> SE2:
    return stage.bodies.footprint_pose()


def close(pose: SE2, other: SE2, within: float) -> bool:
    return pose.distance_m(other) < within and abs(pose.yaw_rad - other.yaw_rad) < within


def test_it_goes_on_where_the_one_before_was() -> None:
    first = driven(BALLAST, WALKER)
    assert places(first)["ballast"][0] > 1.05
    kept = first.last(SIMULATION_CHECKPOINT)
    second = again(kept, BALLAST, WALKER)
    assert close(true_pose(second), true_pose(first), 0.04)
    for name, place in places(first).items():
        assert place == pytest.approx(places(second)[name], abs=0.08), name
    stats = second.last(SIMULATION_STATS)
    assert (stats.epoch, stats.resumed_from, stats.run_epoch) == (2, 1, 1)
    assert stats.seed == 5
    second.wait(0.5)
    # Time goes on, later than all that has been sent, and the robot stands until it is told to.
    last_ns = msg.ns_from_time(first.last(CLOCK).clock)
    assert 0 < msg.ns_from_time(second.all(CLOCK)[0].clock) - last_ns < 400_000_000
    assert second.speeds == pytest.approx((0.0, 0.0), abs=1e-3)
    assert close(true_pose(second), true_pose(first), 0.04)
    before, after = (msg.se2_from_pose(one.last(ODOM).pose.pose) for one in (first, second))
    assert close(before, after, 0.04)
    assert places(second)["walker"][1] > places(first)["walker"][1]
    now_s = second.now_ns * 1e-9
    second.drive(0.2, 0.0, 1.0)
    assert second.now_ns * 1e-9 == pytest.approx(now_s + 1.0, abs=0.01)
    assert true_pose(second).distance_m(true_pose(first)) > 0.1


def test_what_stands_where_the_robot_began_is_there_again() -> None:
    first = Stage()
    first.load(OPEN)
    first.drive(-0.3, 0.0, 3.0)
    assert names(first.desire(AT_START)) == ["at_start"]
    first.wait(0.2)
    second = again(first.last(SIMULATION_CHECKPOINT), AT_START)
    assert not second.last(ENTITIES).refused
    assert names(second.last(ENTITIES)) == ["at_start"]
    second.wait(0.2)
    assert not second.all(CONTACTS)


def test_a_pause_outlives_it() -> None:
    first = driven()
    replies: list[SimulationControlReply] = []
    first.inbox.ask(SIMULATION_CONTROL, SimulationControl(pause=True, speed=2.0), replies.append)
    first.turn()
    second = again(first.last(SIMULATION_CHECKPOINT))
    assert second.node.next_step_ns() is None
    assert second.node.speed == 2.0
    assert second.last(SIMULATION_STATS).paused


def test_without_a_checkpoint_or_in_another_world_it_begins_anew() -> None:
    first = driven()
    other = first.last(SIMULATION_CHECKPOINT).model_copy(update={"world_hash": "another"})
    for kept in (None, other):
        stage = again(kept)
        assert close(true_pose(stage), SE2(0.0, 0.0, 0.0), 0.001)
        assert stage.last(SIMULATION_STATS).resumed_from is None
        assert stage.now_ns < 100_000_000


def test_a_reset_ends_the_run_that_was_resumed() -> None:
    second = again(driven().last(SIMULATION_CHECKPOINT))
    second.inbox.ask(SIMULATION_CONTROL, SimulationControl(reset="all"), lambda _: None)
    second.turn()
    stats = second.last(SIMULATION_STATS)
    assert (stats.epoch, stats.resumed_from) == (3, None)
    assert stats.sim_time_s == 0.0


def test_a_process_that_was_resumed_is_resumed_again() -> None:
    first = driven()
    second = again(first.last(SIMULATION_CHECKPOINT))
    second.drive(0.3, 0.0, 1.0)
    third = again(second.last(SIMULATION_CHECKPOINT))
    assert close(true_pose(third), true_pose(second), 0.04)
    stats = third.last(SIMULATION_STATS)
    assert (stats.epoch, stats.run_epoch) == (3, 1)


def test_who_held_the_robot_before_holds_it_no_more() -> None:
    second = again(driven().last(SIMULATION_CHECKPOINT))
    second.command(0.2, source="navigation")
    second.wait(0.1)
    assert not second.inbox.counts[CMD_VEL.name].rejected
    assert second.last(GROUND_TRUTH_ODOM).twist.twist.linear.x > 0.02

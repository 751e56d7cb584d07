"""The emergency stop: the robot is held at rest, whatever is commanded, reset or started again."""

from __future__ import annotations

import math

import pytest

from mazebot.common.messages import action_documents as act
from mazebot.common.messages.documents import (
    EmergencyStop,
    Entities,
    SimulationControl,
    SimulationControlReply,
)
from mazebot.common.messages.topics import (
    CMD_VEL,
    DESIRED_ENTITIES,
    EMERGENCY_STOP,
    SIMULATION_CHECKPOINT,
    SIMULATION_CONTROL,
    SIMULATION_STATS,
    WORLD,
)
from tests.physics.driver import world
from tests.physics.stage import OPEN, Stage


def on_the_move(**config: object) -> Stage:
    stage = Stage(**config)
    stage.load(OPEN)
    stage.drive(0.4, 0.0, 1.5)
    assert stage.speeds[0] == pytest.approx(0.4, abs=0.02)
    return stage


def ask(stage: Stage, *, stop: bool, reason: str = "") -> None:
    replies: list[act.Reply] = []
    stage.inbox.ask(EMERGENCY_STOP, EmergencyStop(stop=stop, reason=reason), replies.append)
    stage.turn()
    assert replies == [act.Reply()]


def stands(stage: Stage) -> bool:
    """Whether it stays where it is though somebody wants it to drive."""
    stage.drive(0.4, 0.5, 0.3)
    stage.wait(0.05)
    before = stage.pose
    stage.drive(0.4, 0.5, 0.5)
    stage.wait(0.05)
    return stage.pose.distance_m(before) < 0.002 and max(map(abs, stage.speeds)) < 0.02


def test_the_robot_brakes_at_once_and_moves_again_only_when_it_is_cleared() -> None:
    stage = on_the_move()
    ask(stage, stop=True, reason="something\nsmells  burnt")
    assert stage.last(SIMULATION_STATS).emergency_stop == "something smells burnt"
    stage.drive(0.4, 0.0, 0.15)
    assert abs(stage.speeds[0]) < 0.02
    assert stands(stage)
    assert stage.inbox.counts[CMD_VEL.name].rejected["emergency stop"] > 10
    assert stage.last(SIMULATION_STATS).watchdog_stops == 0
    ask(stage, stop=False)
    assert stage.last(SIMULATION_STATS).emergency_stop == ""
    # What was commanded before is over.
    stage.wait(0.3)
    assert stage.speeds[0] == pytest.approx(0.0, abs=0.01)
    stage.drive(0.4, 0.0, 1.0)
    assert stage.speeds[0] == pytest.approx(0.4, abs=0.02)


def test_the_first_reason_stands_and_clearing_what_is_not_stopped_changes_nothing() -> None:
    stage = on_the_move()
    told = len(stage.all(SIMULATION_STATS))
    ask(stage, stop=False)
    assert len(stage.all(SIMULATION_STATS)) == told
    ask(stage, stop=True)
    ask(stage, stop=True, reason="another")
    assert stage.last(SIMULATION_STATS).emergency_stop == "requested"


def test_it_outlasts_a_reset_a_rebuild_and_another_world() -> None:
    stage = on_the_move()
    ask(stage, stop=True, reason="look")
    replies: list[SimulationControlReply] = []
    stage.inbox.ask(SIMULATION_CONTROL, SimulationControl(reset="all"), replies.append)
    stage.turn()
    assert replies[-1].error == ""
    assert stands(stage)
    simulation = stage.node._simulation
    assert simulation is not None
    # As where PyBullet's state was not physical.
    simulation.bodies.close()
    simulation._build()
    assert stands(stage)
    hall = world(name="hall")
    stage.load(hall)
    assert stage.node.world_hash == hall.hash
    assert stage.last(SIMULATION_STATS).emergency_stop == "look"
    assert stands(stage)


def test_it_outlasts_the_process_and_may_come_before_the_world() -> None:
    before = on_the_move()
    ask(before, stop=True, reason="look")
    kept = before.last(SIMULATION_CHECKPOINT)
    after = Stage()
    after.inbox.is_handed_over = False
    after.deliver(WORLD, OPEN)
    after.deliver(DESIRED_ENTITIES, Entities(world_hash=OPEN.hash))
    after.deliver(SIMULATION_CHECKPOINT, kept, source="before")
    after.inbox.hand_over()
    after.wait(0.05)
    assert after.pose.distance_m(before.pose) < 0.1
    assert stands(after)
    assert after.last(SIMULATION_STATS).emergency_stop == "look"
    early = Stage()
    ask(early, stop=True, reason="early")
    early.load(OPEN)
    assert stands(early)


def test_a_robot_that_has_fallen_is_stopped_until_it_stands_and_is_cleared() -> None:
    stage = on_the_move()
    robot = stage.last(SIMULATION_CHECKPOINT).robot
    fallen = (math.sin(0.7), 0.0, 0.0, math.cos(0.7))
    lies = robot.model_copy(update={"orientation_xyzw": fallen})
    stage.bodies.restore(lies, stage.bodies.state.wheel_angles_rad, ())
    stage.wait(0.2)
    stopped = stage.last(SIMULATION_STATS).emergency_stop
    assert stopped.startswith("the robot is tilted by more")
    ask(stage, stop=False)
    stage.wait(0.2)
    assert stage.last(SIMULATION_STATS).emergency_stop.startswith("the robot is tilted by more")
    stage.inbox.ask(SIMULATION_CONTROL, SimulationControl(reset="all"), lambda _: None)
    stage.turn()
    ask(stage, stop=False)
    stage.drive(0.4, 0.0, 1.0)
    assert stage.speeds[0] == pytest.approx(0.4, abs=0.02)

"""Requests for time to stand, go on, advance or begin again, at the physics node."""

import json
import random
from typing import Any

import pytest

from mazebot.common.messages import wire
from mazebot.common.messages.documents import SimulationControl, SimulationControlReply
from mazebot.common.messages.messages import TYPESTORE, String, ns_from_time
from mazebot.common.messages.topics import (
    CLOCK,
    ENTITIES,
    ODOM,
    SIMULATION_CONTROL,
    SIMULATION_STATS,
)
from mazebot.physics.config import time_of_step_ns
from mazebot.physics.run_control import first_step_at
from tests.physics.driver import Driver, world

Answers = list[SimulationControlReply]


def ask(driver: Driver, **fields: Any) -> Answers:
    """What is answered, now or later."""
    answers: Answers = []
    driver.inbox.ask(SIMULATION_CONTROL, SimulationControl(**fields), answers.append)
    return answers


def turns(driver: Driver, times: int) -> None:
    """As an executive gives them: at the next step's time, or at the present one."""
    for _ in range(times):
        next_ns = driver.node.next_step_ns()
        driver.now_ns = driver.node.now_ns if next_ns is None else next_ns
        driver.outbox.now_ns = driver.now_ns
        driver.node.step(driver.now_ns, driver.inbox, driver.outbox)


def answer(driver: Driver, **fields: Any) -> SimulationControlReply:
    """What is answered at once."""
    answers = ask(driver, **fields)
    turns(driver, 1)
    (one,) = answers
    return one


@pytest.fixture
def driver() -> Driver:
    return Driver(camera_enabled=False).load(world())


def test_it_stands_and_goes_on(driver: Driver) -> None:
    turns(driver, 10)
    reply = answer(driver, pause=True)
    assert reply.error == ""
    assert reply.stats is not None
    assert (reply.stats.iterations, reply.stats.paused) == (10, True)
    turns(driver, 5)
    assert driver.node.paused
    assert driver.node.now_ns == time_of_step_ns(10)
    assert driver.last(SIMULATION_STATS).paused
    assert answer(driver, pause=False).stats == driver.last(SIMULATION_STATS)
    turns(driver, 5)
    assert driver.node.now_ns == time_of_step_ns(15)


def test_nothing_asked_is_answered_with_how_it_is(driver: Driver) -> None:
    answer(driver, pause=True)
    told = len(driver.all(SIMULATION_STATS))
    reply = answer(driver)
    assert reply.stats is not None
    assert reply.stats == driver.last(SIMULATION_STATS)
    assert len(driver.all(SIMULATION_STATS)) == told


def test_steps_are_as_many_as_asked_for_and_leave_it_paused(driver: Driver) -> None:
    answers = ask(driver, step=7)
    turns(driver, 6)
    assert answers == []
    turns(driver, 10)
    assert [reply.error for reply in answers] == [""]
    assert answers[0].stats is not None
    assert (answers[0].stats.iterations, answers[0].stats.paused) == (7, True)
    assert driver.node.paused
    answers = ask(driver, run_until_s=0.1)
    turns(driver, 30)
    assert answers[0].stats is not None
    assert (answers[0].stats.iterations, answers[0].stats.sim_time_s) == (24, 0.1)
    assert answer(driver, run_until_s=0.1).error == ""


@pytest.mark.parametrize(
    "later", [{"pause": True}, {"pause": False}, {"step": 3}, {"reset": "time"}]
)
def test_a_run_that_is_cut_short_says_when(driver: Driver, later: dict[str, Any]) -> None:
    cut = ask(driver, step=1000)
    turns(driver, 12)
    assert cut == []
    ask(driver, **later)
    turns(driver, 5)
    (reply,) = cut
    assert reply.error == "interrupted at 0.05 s by a newer request"
    assert reply.stats is not None


def test_speed_and_questions_cut_nothing_short(driver: Driver) -> None:
    answers = ask(driver, step=20)
    turns(driver, 5)
    assert answer(driver, speed=0.0).stats is not None
    answer(driver)
    turns(driver, 20)
    assert [reply.error for reply in answers] == [""]
    assert driver.node.speed == 0.0


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"step": 1, "run_until_s": 5.0}, "step: 1: must not be combined with run_until_s"),
        ({"step": 1, "pause": True}, "pause: true"),
        ({"run_until_s": 0.01}, "run_until_s: 0.01: must not be before now, 0.05 s"),
        ({"seed": 3}, "seed: 3: requires reset: all"),
        ({"seed": 3, "reset": "time"}, "seed: 3: requires reset: all"),
        ({"reset": "all", "speed": 3.0, "step": 1, "pause": True}, "pause: true"),
    ],
)
def test_what_contradicts_itself_changes_nothing(
    driver: Driver, fields: dict[str, Any], words: str
) -> None:
    turns(driver, 12)
    answer(driver, pause=True)
    before = answer(driver).stats
    reply = answer(driver, **fields)
    assert words in reply.error
    assert "\n" not in reply.error
    assert reply.stats == before
    assert answer(driver).stats == before


@pytest.mark.parametrize(
    "fields",
    [
        {"step": 0}, {"step": -1}, {"step": 10**9}, {"run_until_s": -1.0}, {"run_until_s": 1e300},
        {"run_until_s": float("nan")}, {"speed": -1.0}, {"speed": 1e-3}, {"speed": 1e9},
        {"speed": float("inf")}, {"seed": -1}, {"seed": 2**64}, {"reset": "half"}, {"stop": True},
    ],
)  # fmt: skip
def test_hostile_values_are_refused_on_the_wire(fields: dict[str, Any]) -> None:
    text = String(data=json.dumps(fields))
    data = bytes(TYPESTORE.serialize_cdr(text, String.__msgtype__))
    with pytest.raises(wire.WireError, match=next(iter(fields))) as refused:
        wire.decode_json(SimulationControl, data)
    assert "\n" not in str(refused.value)


def test_a_reset_begins_again_with_everything(driver: Driver) -> None:
    fresh = answer(driver, pause=True).stats
    assert fresh is not None
    ask(driver, pause=False)
    driver.drive(0.3, 0.5, 1.0)
    x_m = driver.pose.x_m
    assert x_m > 0.1
    reply = answer(driver, reset="all", pause=True)
    assert reply.stats == fresh.model_copy(update={"epoch": fresh.epoch + 1})
    assert driver.last(SIMULATION_STATS) == reply.stats
    assert ns_from_time(driver.last(CLOCK).clock) == 0
    assert driver.node.next_step_ns() is None
    assert answer(driver, reset="all", seed=11).stats == fresh.model_copy(
        update={"epoch": fresh.epoch + 2, "seed": 11}
    )


def test_a_reset_goes_on_where_it_was_not_paused(driver: Driver) -> None:
    turns(driver, 100)
    reply = answer(driver, reset="all", speed=2.0)
    assert reply.stats is not None
    assert not reply.stats.paused
    turns(driver, 9)
    assert driver.node.now_ns == time_of_step_ns(9)
    answers = ask(driver, reset="all", run_until_s=0.05)
    turns(driver, 20)
    assert answers[0].stats is not None
    assert (answers[0].stats.sim_time_s, answers[0].stats.paused) == (0.05, True)


def test_before_there_is_a_world_time_is_controlled_and_nothing_reset() -> None:
    driver = Driver(camera_enabled=False)
    assert answer(driver, reset="all").error == "reset: all: no world loaded yet"
    assert answer(driver, pause=True).stats is None
    steps = ask(driver, step=5)
    turns(driver, 3)
    assert steps == []
    driver.load(world())
    turns(driver, 20)
    assert steps[0].stats is not None
    assert steps[0].stats.iterations == 5


def test_a_reset_of_time_leaves_the_sensors_in_step(driver: Driver) -> None:
    driver.drive(0.3, 0.0, 1.0)
    turns(driver, 3)
    answer(driver, reset="time")
    turns(driver, 8)
    odometry = driver.last(ODOM)
    assert ns_from_time(odometry.header.stamp) == time_of_step_ns(8)
    # The mean since the last reading: with the three steps before the reset it would be 0.41 m/s.
    assert odometry.twist.twist.linear.x == pytest.approx(0.3, abs=0.02)
    assert len(driver.all(ENTITIES)) == 1


def test_the_first_step_at_a_time_is_exact() -> None:
    random_ = random.Random(3)
    for _ in range(20_000):
        time_ns = random_.randrange(10**13)
        step = first_step_at(time_ns * 1e-9)
        exact_ns = round(time_ns * 1e-9 * 1e9)
        assert time_of_step_ns(step) >= exact_ns
        assert step == 0 or time_of_step_ns(step - 1) < exact_ns
    assert first_step_at(0.0) == 0
    assert first_step_at(1e9) == 240 * 10**9

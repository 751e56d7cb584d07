"""An exploration that is held, stopped, or gone on with by a process after the one before."""

from __future__ import annotations

from typing import Any

import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.slam_documents import ExplorationStatus, PlaceSetAside
from mazebot.common.node.node import Envelope
from mazebot.explorer.config import ExplorerConfig
from tests.common.samples import SAMPLES, WORLD
from tests.explorer.worlds import Stage, plan

TWO_ROOMS = plan(
    "##############",
    "#.....#......#",
    "#.....#......#",
    "#............#",
    "#............#",
    "#.....#......#",
    "##############",
)
HOME = SE2(1.25, 1.25, 0.0)
STATS = SAMPLES[table.SIMULATION_STATS]
PAUSED: dict[str, Any] = {"state": "held"}
STOPPED: dict[str, Any] = {"stop_level": "hold"}
BLIND: dict[str, Any] = {"stop_level": "stop"}


def exploring(config: ExplorerConfig | None = None) -> Stage:
    stage = Stage(TWO_ROOMS, HOME, config or ExplorerConfig())
    stage.say(table.SIMULATION_STATS, STATS)
    stage.run(10, "exploring")
    for _ in range(10):
        stage.step()
    return stage


def hold(stage: Stage, how: dict[str, Any], seconds: float) -> None:
    stage.navigation, stage.stuck = how, True
    for _ in range(10):
        stage.step()
    sent = len(stage.goals)
    for _ in range(round(10 * seconds)):
        stage.step()
    assert len(stage.goals) == sent
    stage.navigation, stage.stuck = {}, False


@pytest.mark.parametrize("how", [PAUSED, STOPPED, BLIND])
def test_nothing_is_sent_nor_given_up_while_the_robot_is_held(how: dict[str, Any]) -> None:
    stage = exploring()
    hold(stage, how, 60.0)
    assert (stage.status.state, stage.status.set_aside) == ("exploring", 0)
    stage.run(120, "complete", "failed")
    assert stage.status.reason == "no reachable frontiers left"
    assert not stage.status.places_set_aside


def test_a_hold_is_no_time_of_exploring() -> None:
    stage = exploring(ExplorerConfig(time_allowance=20.0))
    hold(stage, STOPPED, 30.0)
    assert stage.status.state == "exploring"
    assert 1.0 < stage.status.explored_s < 4.0


def test_it_waits_on_its_way_home_where_the_robot_is_held() -> None:
    stage = exploring()
    stage.run(120, "returning")
    hold(stage, PAUSED, 60.0)
    stage.run(60, "complete", "failed")
    assert stage.status.state == "complete"


def test_the_goal_of_somebody_else_is_left_alone_when_it_is_stopped() -> None:
    stage = exploring()
    own = stage.goal
    assert own is not None
    stage.goal = (1, HOME)
    stage.end(own, ErrorCode.PREEMPTED)
    stage.step()
    stage.say(table.EXPLORE_RESUME, msg.Bool(data=False))
    sent = len(stage.goals)
    for _ in range(3):
        stage.step()
    assert stage.status.state == "paused"
    assert stage.status.goal_stamp_ns == own[0]
    assert stage.goal == (1, HOME)
    assert len(stage.goals) == sent


@pytest.mark.parametrize("sent_meanwhile", [False, True])
def test_who_cancels_its_goal_pauses_it(sent_meanwhile: bool) -> None:
    stage = exploring()
    own = stage.goal
    assert own is not None
    while sent_meanwhile and stage.goals[-1] == own:
        stage.step()
    if not sent_meanwhile:
        stage.goal = None
    stage.end(own, ErrorCode.CANCELED)
    stage.step()
    sent = len(stage.goals)
    for _ in range(50):
        stage.step()
    assert (stage.status.state, stage.status.reason) == ("paused", "its goal was canceled")
    assert (stage.goal, len(stage.goals)) == (None, sent)
    stage.say(table.EXPLORE_RESUME, msg.Bool(data=True))
    stage.run(120, "complete", "failed")
    assert stage.status.reason == "no reachable frontiers left"


def test_one_that_is_resumed_at_once_is_not_paused_by_the_goal_that_its_pause_canceled() -> None:
    stage = exploring()
    stage.say(table.EXPLORE_RESUME, msg.Bool(data=False))
    stage.step()
    stage.say(table.EXPLORE_RESUME, msg.Bool(data=True))
    for _ in range(20):
        stage.step()
    assert stage.status.state == "exploring"


def again(before: Stage, kept: ExplorationStatus, **stats: Any) -> Stage:
    """Another process, with what was kept of the one before."""
    stage = Stage(TWO_ROOMS, before.robot, ExplorerConfig())
    stage.say(table.WORLD, before.world)
    stage.now_ns, stage.known, stage.goal = before.now_ns, before.known, before.goal
    stage.say(table.SIMULATION_STATS, STATS.model_copy(update=stats))
    stage.inbox.deliver(
        table.EXPLORATION_STATUS, kept, Envelope("before", 0, before.now_ns, WORLD.hash)
    )
    return stage


def test_one_that_was_stopped_stays_so_in_another_process_until_a_reset() -> None:
    before = exploring()
    before.say(table.EXPLORE_RESUME, msg.Bool(data=False))
    before.step()
    stage = again(before, before.status)
    stage.inbox.is_handed_over = False
    for _ in range(20):
        stage.step()
    # What others keep is not replaced before it is known.
    assert not stage.statuses
    stage.inbox.hand_over()
    for _ in range(50):
        stage.step()
    assert {one.state for one in stage.statuses} == {"paused"}
    assert stage.status.driven_m == before.status.driven_m > 0.5
    assert not stage.goals
    stage.say(table.EXPLORE_RESUME, msg.Bool(data=True))
    stage.run(120, "complete", "failed")
    assert stage.status.reason == "no reachable frontiers left"
    later = again(before, before.status, epoch=STATS.epoch + 1, resumed_from=None)
    later.run(20, "exploring")


def test_places_set_aside_and_time_go_on_in_another_process() -> None:
    before = exploring()
    place = PlaceSetAside(x_m=5.0, y_m=1.0, tries=3)
    kept = before.status.model_copy(update={"places_set_aside": (place,), "explored_s": 90.0})
    stage = again(before, kept)
    stage.run(20, "exploring")
    assert stage.status.places_set_aside == (place,)
    assert stage.status.explored_s >= 90.0
    stage.run(120, "complete", "failed")
    assert not any(abs(goal.x_m - 5.0) < 0.5 and goal.y_m < 1.5 for _, goal in stage.goals)

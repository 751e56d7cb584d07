"""Bringup against a stack that answers by hand."""

import logging
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.bringup.config import BringupConfig
from mazebot.bringup.node import (
    EXIT_NOT_ACTIVE,
    EXIT_NOT_REACHED,
    EXIT_REFUSED,
    BringupNode,
)
from mazebot.bringup.tour import APART_M, PLACES, default_tour, tour_goals
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import documents as doc
from mazebot.common.messages import topics as table
from mazebot.common.messages.messages import ns_from_time, occupancy_grid
from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Envelope, Inbox, Outbox
from mazebot.common.settings.load import load
from tests.common.samples import WORLD

STEP_NS = 100_000_000
HASH = WORLD.hash
ORIGIN = SE2(-5.0, -5.0, 0.0)
FREE = np.zeros((100, 100), np.int8)
SHUT_IN = FREE.copy()
SHUT_IN[:, :] = 100
SHUT_IN[48:52, 48:52] = 0
ACTIVE = doc.NavigationStatus(localization_active=True, navigation_active=True)
INACTIVE = doc.NavigationStatus(localization_active=False, navigation_active=False)


class Stage:
    """A bringup node, and the hand that plays everybody else."""

    def __init__(self, config: BringupConfig) -> None:
        self.node = BringupNode(config)
        self.inbox = Inbox(self.node)
        self.sent: list[tuple[str, Any]] = []
        self.outbox = Outbox(self.node, lambda topic, message, _: self._keep(topic, message))
        self.now_ns = 0
        self._sequence = 0

    def _keep(self, topic: Topic[object], message: object) -> None:
        self.sent.append((topic.name, message))

    def say(self, topic: Topic[Any], message: object) -> None:
        self.inbox.deliver(topic, message, Envelope("x", self._sequence, self.now_ns, HASH))
        self._sequence += 1

    def step(self, times: int = 1) -> None:
        for _ in range(times):
            self.now_ns += STEP_NS
            self.outbox.now_ns = self.now_ns
            self.node.step(self.now_ns, self.inbox, self.outbox)

    def goals(self) -> list[Any]:
        return [message for name, message in self.sent if name == "/goal_pose"]

    def bring_up(self, world: doc.World = WORLD, cells: NDArray[np.int8] = FREE) -> None:
        self.step()
        (request,) = [message for name, message in self.sent if name == "/world/request"]
        self.say(table.WORLD, world)
        self.say(table.MAP, occupancy_grid(0, 0.1, ORIGIN, cells))
        self.say(table.WORLD_STATUS, doc.WorldStatus(request=request, world_hash=HASH))
        self.say(table.NAVIGATION_STATUS, ACTIVE)
        self.step()

    def judge(self, *reached: bool, others: tuple[doc.GoalReport, ...] = ()) -> None:
        stamps_ns = [ns_from_time(goal.header.stamp) for goal in self.goals()]
        ours = tuple(report(r, s) for r, s in zip(reached, stamps_ns, strict=True))
        self.say(table.EVALUATION, doc.Evaluation(goals=(*others, *ours)))
        self.step()

    def answer(self, error_code: int = 0) -> None:
        goal = self.goals()[-1]
        self.say(
            table.NAVIGATION_RESULT,
            doc.NavigationResult(
                goal=doc.Planar(x_m=0, y_m=0, yaw_rad=0),
                goal_stamp_ns=ns_from_time(goal.header.stamp),
                error_code=error_code,
                error_msg="blocked" if error_code else "",
                start_time_s=0.0,
                end_time_s=1.0,
            ),
        )
        self.step(2)


def report(reached: bool, goal_stamp_ns: int = 0) -> doc.GoalReport:
    return doc.GoalReport(
        name="location1", reached=reached, time_s=1.0, path_length_m=2.0, shortest_path_m=1.9,
        goal_error_m=0.05, goal_error_rad=0.01, recoveries=0, error_code=0,
        goal_stamp_ns=goal_stamp_ns,
    )  # fmt: skip


@pytest.fixture
def stage(caplog: pytest.LogCaptureFixture) -> Stage:
    caplog.set_level(logging.INFO)
    return Stage(BringupConfig(world_name="tiny", tour=("location1", "home")))


def test_it_says_both_lines_once_and_drives_the_tour(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    stage.bring_up()
    said = [(r.name, r.getMessage()) for r in caplog.records if "Managed" in r.getMessage()]
    assert said == [
        ("lifecycle_manager_localization", "Managed nodes are active"),
        ("lifecycle_manager_navigation", "Managed nodes are active"),
    ]
    assert stage.node.waiting_for() is None
    stage.answer()
    stage.answer()
    assert [(g.pose.position.x, g.pose.position.y) for g in stage.goals()] == [(1, 2), (0, 0)]
    assert stage.node.exit_code is None
    stage.judge(True, True)
    assert stage.node.exit_code == 0
    assert "location1" in caplog.records[-1].getMessage()
    assert "shortest m" in caplog.records[-1].getMessage()


def drive_again(stage: Stage, goals_before: int) -> None:
    """Navigation has restarted as well: the tour is driven from its first goal on."""
    stage.say(table.NAVIGATION_STATUS, INACTIVE)
    stage.step()
    stage.say(table.NAVIGATION_STATUS, ACTIVE)
    stage.step()
    stage.answer()
    stage.answer()
    places = [(goal.pose.position.x, goal.pose.position.y) for goal in stage.goals()]
    assert places[goals_before:] == [(1, 2), (0, 0)]


def test_a_reset_begins_the_tour_anew(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    stage.step(50)
    stage.bring_up()
    stage.answer()
    goals_before = len(stage.goals())
    aborted = stage.goals()[-1]
    stage.now_ns = 0
    # Navigation may tell how it was before, and how the goal ended, after the clock went back.
    stage.say(table.NAVIGATION_STATUS, ACTIVE)
    stage.say(
        table.NAVIGATION_RESULT,
        doc.NavigationResult(
            goal=doc.Planar(x_m=0, y_m=0, yaw_rad=0),
            goal_stamp_ns=ns_from_time(aborted.header.stamp),
            error_code=9011,
            start_time_s=0.0,
            end_time_s=1.0,
        ),
    )
    stage.step(20)
    assert len(stage.goals()) == goals_before
    assert stage.node.waiting_for() is not None
    drive_again(stage, goals_before)
    del stage.sent[: next(i for i, said in enumerate(stage.sent) if said[1] is aborted) + 1]
    stage.judge(True, True)
    assert stage.node.exit_code == 0


def test_a_reset_after_the_tour_begins_it_anew(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    stage.bring_up()
    stage.answer()
    stage.answer()
    stage.judge(True, True)
    assert stage.node.exit_code == 0
    goals_before = len(stage.goals())
    stage.now_ns = 0
    stage.step()
    assert "restarting the tour" in caplog.records[-1].getMessage()
    assert stage.node.exit_code is None
    drive_again(stage, goals_before)


def test_another_world_in_the_place_of_its_own_ends_the_run(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    stage.bring_up()
    stage.answer()
    other = WORLD.model_copy(update={"name": "hall", "hash": "f" * 16})
    stage.say(table.WORLD, other)
    # Time begins anew, or goes on: neither is a reset of the tour's world.
    stage.now_ns = 0
    stage.step()
    assert stage.node.exit_code == EXIT_NOT_REACHED
    assert caplog.records[-1].getMessage().startswith("world hall runs in the place of tiny")
    goals_before = len(stage.goals())
    stage.step(50)
    assert len(stage.goals()) == goals_before
    stage.say(table.WORLD, WORLD)
    stage.now_ns = 0
    stage.step()
    assert stage.node.exit_code is None


def test_a_reset_without_a_tour_begins_none(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    stage = Stage(BringupConfig(world_name="tiny", only_ask=True))
    stage.bring_up()
    assert stage.node.exit_code == 0
    stage.now_ns = 0
    stage.step()
    assert stage.node.exit_code == 0
    assert "tour" not in caplog.text


def test_without_a_tour_it_ends_once_time_passes_in_the_world(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    stage = Stage(BringupConfig(world_name="tiny", drive=False))
    assert stage.node.waiting_for() == "the world"
    stage.now_ns = -2 * STEP_NS
    stage.bring_up()
    assert (stage.node.exit_code, stage.node.waiting_for()) == (None, "the simulation")
    stage.step()
    assert (stage.node.exit_code, stage.node.waiting_for()) == (0, None)
    stage.now_ns = 0
    stage.step()
    assert stage.node.exit_code == 0
    assert not stage.goals()
    assert "tour" not in caplog.text


def test_a_goal_that_its_world_took_away_is_driven_to_again(stage: Stage) -> None:
    stage.bring_up()
    stage.answer(error_code=9011)
    for _ in range(100):
        if len(stage.goals()) == 1:
            stage.step()
    stage.answer()
    stage.answer()
    places = [(goal.pose.position.x, goal.pose.position.y) for goal in stage.goals()]
    assert places == [(1, 2), (1, 2), (0, 0)]
    del stage.sent[: next(i for i, said in enumerate(stage.sent) if said[0] == "/goal_pose") + 1]
    stage.judge(True, True)
    assert stage.node.exit_code == 0


def test_two_verdicts_on_one_goal_stand_for_no_other(stage: Stage) -> None:
    stage.bring_up()
    stage.answer()
    stage.answer()
    first_ns, second_ns = (ns_from_time(goal.header.stamp) for goal in stage.goals())
    twice = (report(True, first_ns), report(True, first_ns))
    stage.say(table.EVALUATION, doc.Evaluation(goals=twice))
    stage.step()
    assert stage.node.exit_code is None
    stage.say(table.EVALUATION, doc.Evaluation(goals=(*twice, report(True, second_ns))))
    stage.step()
    assert stage.node.exit_code == 0


def test_after_a_reset_a_stack_that_never_becomes_active_is_given_up() -> None:
    stage = Stage(BringupConfig(world_name="tiny", tour=("home",), bringup_timeout_s=3.0))
    stage.step(50)
    stage.bring_up()
    stage.now_ns = 0
    stage.say(table.NAVIGATION_STATUS, INACTIVE)
    stage.step(25)
    assert stage.node.exit_code is None
    stage.step(15)
    assert stage.node.exit_code == EXIT_NOT_ACTIVE


def test_a_goal_that_was_not_reached_is_not_exit_code_0(stage: Stage) -> None:
    stage.bring_up()
    stage.answer()
    stage.answer(error_code=208)
    stage.judge(True, False)
    assert stage.node.exit_code == EXIT_NOT_REACHED


def test_who_cancels_a_goal_ends_the_tour(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    stage.bring_up()
    stage.answer(error_code=9012)
    assert len(stage.goals()) == 1
    stage.judge(False)
    assert stage.node.exit_code == EXIT_NOT_REACHED
    assert "location1: canceled: the tour ends" in caplog.messages


def test_without_a_recorder_the_tour_still_ends(stage: Stage) -> None:
    stage.bring_up()
    stage.answer()
    stage.answer()
    stage.step(60)
    assert stage.node.exit_code == 0


def test_a_goal_that_the_recorder_missed_takes_the_table_from_none_of_the_others(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    stage.bring_up()
    stage.answer()
    stage.answer(error_code=208)
    stamp_ns = ns_from_time(stage.goals()[0].header.stamp)
    stage.say(table.EVALUATION, doc.Evaluation(goals=(report(True, stamp_ns),)))
    stage.step(60)
    assert stage.node.exit_code == EXIT_NOT_REACHED
    said = [record.getMessage() for record in caplog.records]
    assert said[-2].startswith("tour finished\n")
    assert " yes " in said[-2]
    assert said[-1].startswith("not evaluated by the recorder: (")
    assert "error 208" in said[-1]


def test_only_the_goals_of_this_tour_count(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    others = (report(False, 1), report(False, 2))
    stage.step()
    stage.say(table.EVALUATION, doc.Evaluation(goals=others))
    stage.bring_up()
    stage.answer()
    stage.answer()
    assert stage.node.exit_code is None
    stage.judge(True, True, others=others)
    assert stage.node.exit_code == 0
    assert "no (" not in caplog.records[-1].getMessage()


def test_a_refused_world_is_one_line_and_not_exit_code_0(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    stage.step()
    request = stage.sent[0][1]
    stage.say(table.WORLD_STATUS, doc.WorldStatus(request=request, error="another world runs"))
    stage.step()
    assert stage.node.exit_code == EXIT_REFUSED
    assert caplog.records[-1].getMessage() == "another world runs"
    assert stage.goals() == []


def test_the_answer_to_another_request_is_not_ours(stage: Stage) -> None:
    stage.step()
    other = doc.WorldRequest(world_name="other")
    stage.say(table.WORLD_STATUS, doc.WorldStatus(request=other, error="no such world"))
    stage.step()
    assert stage.node.exit_code is None


def test_an_unknown_location_is_refused_before_driving(caplog: pytest.LogCaptureFixture) -> None:
    stage = Stage(BringupConfig(world_name="tiny", tour=("kitchen",)))
    stage.bring_up()
    assert stage.node.exit_code == EXIT_REFUSED
    assert "'kitchen'" in caplog.text
    assert "location1" in caplog.text


def test_without_a_tour_every_location_is_driven_to_and_then_home() -> None:
    goals = tour_goals(WORLD, (), FREE, ORIGIN, 7)
    assert [name for name, _ in goals] == [*(place.name for place in WORLD.locations), "home"]
    assert goals[-1][1] == WORLD.start


def test_a_place_that_is_called_home_is_home() -> None:
    home = doc.Location(name="home", x_m=1.0, y_m=0.0, yaw_rad=0.0)
    world = WORLD.model_copy(update={"locations": (home, *WORLD.locations)})
    goals = tour_goals(world, (), FREE, ORIGIN, 7)
    assert [name for name, _ in goals].count("home") == 1
    assert dict(goals)["home"] == doc.Planar(x_m=1.0, y_m=0.0, yaw_rad=0.0)


def test_a_world_with_nowhere_to_drive_names_the_remedy(caplog: pytest.LogCaptureFixture) -> None:
    nowhere = WORLD.model_copy(update={"locations": ()})
    stage = Stage(BringupConfig(world_name="tiny"))
    stage.bring_up(nowhere, SHUT_IN)
    assert stage.node.exit_code == EXIT_NOT_REACHED
    (line,) = [r.getMessage() for r in caplog.records if r.levelno >= logging.ERROR]
    assert "tiny.yaml" in line
    assert "`locations:`" in line
    assert "--goal" in line
    stage = Stage(BringupConfig(world_name="tiny", goal=(1.0, 0.0, 0.0)))
    stage.bring_up(nowhere)
    assert [(g.pose.position.x, g.pose.position.y) for g in stage.goals()] == [(1, 0)]


def test_a_world_without_locations_has_a_default_tour(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    nowhere = WORLD.model_copy(update={"locations": ()})
    stage = Stage(BringupConfig(world_name="tiny"))
    stage.bring_up(nowhere)
    for _ in range(PLACES + 1):
        stage.answer()
    stage.judge(*[True] * (PLACES + 1))
    assert stage.node.exit_code == 0
    places = [name for name in ("place1", f"place{PLACES}") if name in caplog.text]
    assert len(places) == 2


def test_the_places_of_a_default_tour_are_apart_where_the_robot_can_come_to() -> None:
    """Two rooms, the one to the east shut off."""
    cells = FREE.copy()
    cells[10, 10:90] = cells[80, 10:90] = cells[10:81, 10] = cells[10:81, 60] = cells[10:81, 89] = (
        100
    )
    world = WORLD.model_copy(update={"locations": (), "map_resolution_m": 0.1})
    tour = default_tour(world, cells, ORIGIN, 7)
    assert [name for name, _ in tour] == [*(f"place{i + 1}" for i in range(PLACES)), "home"]
    assert tour == default_tour(world, cells, ORIGIN, 7)
    assert tour != default_tour(world, cells, ORIGIN, 8)
    points = np.array([(place.x_m, place.y_m) for _, place in tour])
    between_m = np.hypot(*(points[:, None] - points[None]).T) + 9.0 * np.eye(len(points))
    assert between_m.min() > 4.0 * APART_M
    assert (points.min(0) > np.array([-3.9, -3.9]) + 0.3).all()
    assert (points.max(0) < np.array([1.0, 3.0]) - 0.3).all()
    # On open floor without anything they are near the start.
    points = np.array([(at.x_m, at.y_m) for _, at in default_tour(world, FREE, ORIGIN, 7)])
    assert np.abs(points).max() < 2.2


@pytest.mark.parametrize(
    ("flags", "overrides"),
    [
        ([], ()),
        (["maze.seed=3"], ("maze.seed=3",)),
        (["maze.seed=3", "maze.rows=4"], ("maze.seed=3", "maze.rows=4")),
        (["start={x_m: 1, y_m: 2}"], ("start={x_m: 1, y_m: 2}",)),
        (['["start={x_m: 1, y_m: 2}", "maze.seed=3"]'], ("start={x_m: 1, y_m: 2}", "maze.seed=3")),
    ],
)
def test_overrides_go_into_the_request(flags: list[str], overrides: tuple[str, ...]) -> None:
    arguments = [word for flag in flags for word in ("--world-overrides", flag)]
    stage = Stage(load(BringupConfig, "bringup", arguments))
    stage.step()
    assert stage.sent[0][1].overrides == overrides


def test_overrides_come_from_the_environment_too(monkeypatch: pytest.MonkeyPatch) -> None:
    for text, overrides in (("", ()), ("maze.seed=3,maze.rows=4", ("maze.seed=3", "maze.rows=4"))):
        monkeypatch.setenv("MAZEBOT_BRINGUP_WORLD_OVERRIDES", text)
        assert load(BringupConfig, "bringup", []).world_overrides == overrides
    monkeypatch.setenv("MAZEBOT_BRINGUP_WORLD_OVERRIDES", "[maze")
    with pytest.raises(ConfigError, match=r"world_overrides.*maze"):
        load(BringupConfig, "bringup", [])


def test_a_goal_that_navigation_forgot_is_sent_again(stage: Stage) -> None:
    stage.bring_up()
    driving = ACTIVE.model_copy(update={"goal": doc.Planar(x_m=1, y_m=2, yaw_rad=0)})
    for _ in range(30):
        stage.say(table.NAVIGATION_STATUS, driving)
        stage.step()
    assert len(stage.goals()) == 1
    stage.say(table.NAVIGATION_STATUS, INACTIVE)
    stage.step(40)
    assert len(stage.goals()) == 1
    stage.say(table.NAVIGATION_STATUS, ACTIVE)
    stage.step()
    assert len(stage.goals()) == 2
    stage.answer()
    assert len(stage.goals()) == 3


@pytest.mark.parametrize("by", ["goal", "state"])
def test_the_tour_gives_way_to_a_new_goal_and_goes_on_after_it(stage: Stage, by: str) -> None:
    stage.bring_up()
    stage.answer(error_code=9010)
    theirs = {"goal": doc.Planar(x_m=3, y_m=2, yaw_rad=0), "state": "controlling"}
    for _ in range(100):
        stage.say(table.NAVIGATION_STATUS, ACTIVE.model_copy(update={by: theirs[by]}))
        stage.step()
    assert len(stage.goals()) == 1
    stage.say(table.NAVIGATION_STATUS, ACTIVE)
    stage.step(15)
    assert len(stage.goals()) == 1
    stage.step(10)
    stage.answer()
    stage.answer()
    places = [(goal.pose.position.x, goal.pose.position.y) for goal in stage.goals()]
    assert places == [(1, 2), (1, 2), (0, 0)]


def test_a_stack_that_never_becomes_active_is_given_up_with_the_culprits_named(
    caplog: pytest.LogCaptureFixture,
) -> None:
    stage = Stage(BringupConfig(world_name="tiny", tour=("home",), bringup_timeout_s=3.0))
    stage.step()
    stage.say(table.WORLD, WORLD)
    stage.say(table.MAP, occupancy_grid(0, 0.1, ORIGIN, FREE))
    stage.say(table.WORLD_STATUS, doc.WorldStatus(request=stage.sent[0][1], world_hash=HASH))
    waiting = stage.node.waiting_for()
    assert waiting is not None
    assert "navigation (not running)" in waiting
    stage.step(40)
    assert stage.node.exit_code == EXIT_NOT_ACTIVE
    assert "perception (not running)" in caplog.text


def test_a_stack_that_has_run_for_long_gets_the_same_time() -> None:
    stage = Stage(BringupConfig(world_name="tiny", tour=("home",), bringup_timeout_s=3.0))
    stage.step()
    stage.say(table.WORLD, WORLD)
    stage.say(table.MAP, occupancy_grid(0, 0.1, ORIGIN, FREE))
    stage.say(table.WORLD_STATUS, doc.WorldStatus(request=stage.sent[0][1], world_hash=HASH))
    stage.now_ns = 500 * 10**9
    stage.step(25)
    assert stage.node.exit_code is None
    stage.step(15)
    assert stage.node.exit_code == EXIT_NOT_ACTIVE

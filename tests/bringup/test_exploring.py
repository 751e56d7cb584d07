"""Bringup where the robot makes the map."""

from __future__ import annotations

import logging

import pytest

from mazebot.bringup.config import BringupConfig
from mazebot.bringup.node import EVALUATION_PATIENCE_S, EXIT_NOT_REACHED
from mazebot.common.messages import documents as doc
from mazebot.common.messages import topics as table
from mazebot.common.messages.slam_documents import ExplorationStatus
from tests.bringup.test_node import ACTIVE, HASH, STEP_NS, Stage
from tests.common.samples import WORLD

EXPLORING = ExplorationStatus(state="exploring", seen_share=0.4)
COMPLETE = ExplorationStatus(
    state="complete", seen_share=0.995, driven_m=25.3, goals=33, frontiers=2, set_aside=2
)
JUDGED = doc.MapEvaluation(
    coverage_share=0.991, walls_found_share=0.985, keyframes=40, loops=3, exploration="complete",
    explored_s=82.4, trajectory_error_m=doc.TrajectoryError(rmse=0.012, p95=0.021, max=0.03),
    markers=doc.MarkersMapped(found=2),
)  # fmt: skip


@pytest.fixture
def stage(caplog: pytest.LogCaptureFixture) -> Stage:
    caplog.set_level(logging.INFO)
    return Stage(BringupConfig(world_name="tiny", slam=True))


def bring_up(stage: Stage) -> None:
    stage.step()
    (request,) = [message for name, message in stage.sent if name == "/world/request"]
    assert (request.slam, request.explores) == (True, True)
    stage.say(table.WORLD, WORLD.model_copy(update={"slam": True, "explore": True}))
    stage.say(table.WORLD_STATUS, doc.WorldStatus(request=request, world_hash=HASH))
    stage.say(table.NAVIGATION_STATUS, ACTIVE)
    stage.step()


def test_it_waits_for_mapping_and_the_explorer_and_not_for_localisation(stage: Stage) -> None:
    stage.step()
    waiting = str(stage.node.waiting_for())
    assert "mapping (not running)" in waiting
    assert "explorer (not running)" in waiting
    assert "localization" not in waiting
    with_a_map = Stage(BringupConfig(world_name="tiny"))
    with_a_map.step()
    waiting = str(with_a_map.node.waiting_for())
    assert "localization (not running)" in waiting
    assert "mapping" not in waiting
    assert "explorer" not in waiting


def test_it_sends_no_goal_and_ends_when_all_is_explored_and_judged(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    bring_up(stage)
    said = [r.name for r in caplog.records if r.getMessage() == "Managed nodes are active"]
    assert said == ["lifecycle_manager_localization", "lifecycle_manager_navigation"]
    stage.say(table.EXPLORATION_STATUS, EXPLORING)
    stage.step(100)
    assert stage.node.exploration == EXPLORING
    assert stage.node.exit_code is None
    stage.say(table.EXPLORATION_STATUS, COMPLETE)
    stage.step()
    stage.say(table.EVALUATION, doc.Evaluation(mapping=doc.MapEvaluation(exploration="exploring")))
    stage.step()
    assert stage.node.exit_code is None
    stage.say(table.EVALUATION, doc.Evaluation(mapping=JUDGED))
    stage.step()
    assert stage.node.exit_code == 0
    assert not stage.goals()
    lines = caplog.records[-1].getMessage().splitlines()
    assert lines[0] == "exploration complete"
    assert "  floor mapped  99.1% in 82 s" in lines
    assert "  walls found   98.5% within 0.10 m" in lines
    assert "  markers       2 found, 0 missing, 0 false, p95 - m, - deg" in lines
    assert "  driven        25.3 m to 33 view points" in lines


def test_without_a_recorder_the_explorer_s_own_figures_are_told(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    bring_up(stage)
    stage.say(table.EXPLORATION_STATUS, COMPLETE)
    stage.step(round(EVALUATION_PATIENCE_S * 1e9 / STEP_NS) + 2)
    assert stage.node.exit_code == 0
    assert "not evaluated by the recorder" in caplog.records[-1].getMessage()


def test_an_exploration_that_failed_is_not_exit_code_0(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    bring_up(stage)
    failed = ExplorationStatus(state="failed", reason="the robot is shut in")
    stage.say(table.EXPLORATION_STATUS, failed)
    stage.step(100)
    assert stage.node.exit_code == EXIT_NOT_REACHED
    assert "exploration failed: the robot is shut in" in caplog.records[-1].getMessage()


def test_after_a_reset_the_exploration_before_counts_no_more(stage: Stage) -> None:
    bring_up(stage)
    stage.step(20)
    stage.now_ns = 0
    stage.say(table.EXPLORATION_STATUS, COMPLETE)
    stage.step(100)
    assert stage.node.exit_code is None
    assert stage.node.exploration is None


def test_a_goal_may_be_driven_to_while_the_map_is_made(caplog: pytest.LogCaptureFixture) -> None:
    stage = Stage(BringupConfig(world_name="tiny", slam=True, explore=False, goal=(0.5, 0.0, 0.0)))
    stage.step()
    (request,) = [message for name, message in stage.sent if name == "/world/request"]
    assert (request.slam, request.explores) == (True, False)
    stage.say(table.WORLD, WORLD.model_copy(update={"slam": True}))
    stage.say(table.WORLD_STATUS, doc.WorldStatus(request=request, world_hash=HASH))
    stage.say(table.NAVIGATION_STATUS, ACTIVE)
    stage.step()
    assert [goal.pose.position.x for goal in stage.goals()] == [0.5]

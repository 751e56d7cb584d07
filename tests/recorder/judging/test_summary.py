"""The text of a run's summary."""

from __future__ import annotations

import json
import math
from pathlib import Path

from pydantic_core import to_json

from mazebot.common.config import changed_defaults
from mazebot.common.messages.documents import Evaluation, GoalReport, Parameters
from mazebot.common.node.node import TopicCounts
from mazebot.common.recordings.summary import RunSummary
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.judging.summary import _changed, build_summary, summary_text
from mazebot.recorder.judging.wall_time import WallTime
from tests.recorder.synthetic import room

GOAL = GoalReport(
    name='by the "door"\n{ü}', reached=True, time_s=1.5, path_length_m=2.0, shortest_path_m=None,
    goal_error_m=0.1, goal_error_rad=0.2, recoveries=0, error_code=0,
)  # fmt: skip


def summary_of(goals: tuple[GoalReport, ...]) -> RunSummary:
    return build_summary(
        ended=True,
        world=room("two\nlines"),
        seed=7,
        stats=None,
        rebuilds=0,
        sim_time_s=3.0,
        wall_time=WallTime(),
        now_s=0.0,
        evaluation=Evaluation(goals=goals),
        totals={
            "contacts": 0, "distance_m": None, "goals_sent": 2, "goals_reached": 2, "spl": 0.5,
        },
        counts={"/scan": TopicCounts(received=3)},
        recorded={"/scan": 3},
        wanted={"/scan": 4},
        rejected_elsewhere={("navigation", "/tf", "not finite"): 1},
        versions={"mazebot": "0.1.0"},
    )  # fmt: skip


def test_its_pieces_are_the_text_of_the_whole() -> None:
    summary = summary_of((GOAL, GOAL))
    pieces = list(summary_text(summary))
    assert b"".join(pieces) == to_json(summary, indent=2) + b"\n"
    read = json.loads(b"".join(pieces))
    assert read["goals"][1] == GOAL.model_dump()
    assert RunSummary.model_validate_json(b"".join(pieces)) == summary


def test_what_is_not_finite_is_null() -> None:
    goal = GoalReport.model_construct(**{**dict(GOAL), "time_s": math.nan})
    text = b"".join(summary_text(summary_of((goal,))))
    assert json.loads(text)["goals"][0]["time_s"] is None


def test_no_piece_is_longer_than_a_goal() -> None:
    assert max(map(len, summary_text(summary_of((GOAL,) * 1000)))) < 1000


def test_settings_that_are_not_the_defaults_are_listed_by_service() -> None:
    said = [
        Parameters(service="physics", values={"seed": 8, "b": 2, "a": 1}, defaults={"b": 1}),
        Parameters(service="navigation", values={"seed": 8, "x": None}, defaults={"x": 3}),
        Parameters(service="recorder", values={"live": True}, defaults={"live": False}),
        # The seed is the run's own, and is said once.
        Parameters(service="spawner", values={"seed": 8}, defaults={"seed": 7}),
    ]
    changed = _changed(said)
    assert {name: (one.value, one.default) for name, one in changed.items()} == {
        "navigation.x": (None, 3),
        "physics.b": (2, 1),
    }


def test_a_service_says_which_of_its_settings_are_not_the_defaults(tmp_path: Path) -> None:
    assert changed_defaults(RecorderConfig()) == {}
    config = RecorderConfig(recordings_dir=tmp_path, keep_days=3.0, live=False)
    assert changed_defaults(config) == {"recordings_dir": "recordings", "keep_days": None}

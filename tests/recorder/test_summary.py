"""The text of a run's summary."""

from __future__ import annotations

import json
import math

from pydantic_core import to_json

from services.common.documents import ErrorStatistics, GoalReport
from services.recorder.summary import summary_text

GOAL = GoalReport(
    name='by the "door"\n{ü}', reached=True, time_s=1.5, path_length_m=2.0, shortest_path_m=None,
    goal_error_m=0.1, goal_error_rad=0.2, recoveries=0, error_code=0,
)  # fmt: skip


def test_its_pieces_are_the_text_of_the_whole() -> None:
    summary = {
        "world": "two\nlines",
        "real_time_factor": math.nan,
        "goals": (GOAL, GOAL),
        "contacts": {"count": 0, "list": []},
        "localisation_error_m": ErrorStatistics(mean=0.5),
        "messages": {"/scan": {"sent": 3, "rejected_by": {}}, "/tf": {"rejected_by": {"a": 1}}},
    }
    pieces = list(summary_text(summary))
    assert b"".join(pieces) == to_json(summary, indent=2, inf_nan_mode="null") + b"\n"
    assert json.loads(b"".join(pieces))["goals"][1] == GOAL.model_dump()


def test_no_piece_is_longer_than_a_goal() -> None:
    summary = {"goals": (GOAL,) * 1000}
    assert max(map(len, summary_text(summary))) < 1000

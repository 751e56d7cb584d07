"""The goals of a run, as its page lists them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class GoalRow:
    """One goal; None: not measured."""

    name: str
    reached: bool
    reason: str
    """Why it was not reached."""
    time_s: float | None
    path_length_m: float | None
    error_m: float | None
    recoveries: float | None


def goals_of(summary: Mapping[str, Any]) -> tuple[GoalRow, ...]:
    """The goals in a summary; what is no goal is left out."""
    goals = summary.get("goals")
    if not isinstance(goals, list):
        return ()
    return tuple(
        GoalRow(
            name=str(goal.get("name", "")),
            reached=goal.get("reached") is True,
            reason=str(goal.get("error_msg") or "missed"),
            time_s=_number(goal.get("time_s")),
            path_length_m=_number(goal.get("path_length_m")),
            error_m=_number(goal.get("goal_error_m")),
            recoveries=_number(goal.get("recoveries")),
        )
        for goal in goals
        if isinstance(goal, dict)
    )


def _number(value: object) -> float | None:
    if not isinstance(value, int | float) or isinstance(value, bool) or abs(value) >= 1e300:
        return None
    return float(value)

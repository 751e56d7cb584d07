"""A run's goals as table rows, the same in the terminal and in the viewer."""

from __future__ import annotations

import math
from collections.abc import Iterable

from mazebot.common.messages.documents import Evaluation, GoalReport

HEADINGS = (
    "goal",
    "reached",
    "time s",
    "path m",
    "shortest m",
    "loc. error m",
    "goal error m",
    "goal error deg",
    "contacts",
    "recoveries",
)
NOT_MEASURED = "-"


def goal_rows(goals: Iterable[GoalReport]) -> list[tuple[str, ...]]:
    """One row a goal, one cell a heading."""
    return [
        (
            task_name(goal),
            "given up" if goal.given_up else "yes" if goal.reached else f"no ({goal.error_code})",
            f"{goal.time_s:.1f}",
            f"{goal.path_length_m:.2f}",
            measured(goal.shortest_path_m, 2),
            measured(goal.localisation_error_m, 3),
            measured(goal.goal_error_m, 3),
            measured(_degrees(goal.goal_error_rad), 1),
            str(goal.contacts),
            str(goal.recoveries),
        )
        for goal in goals
    ]


def task_name(goal: GoalReport) -> str:
    """The goal's name, after what was to be done there if that was not just to drive there."""
    action = goal.action.replace("_", " ")
    if goal.action == "navigate_to_pose":
        return goal.name
    return action if goal.name == goal.action else f"{action}: {goal.name}"


def failure_lines(goals: Iterable[GoalReport]) -> list[str]:
    """Why goals were not reached, a line each, where navigation gave a reason."""
    return [
        f"{task_name(goal)}: error {goal.error_code}: {goal.error_msg}"
        for goal in goals
        if goal.error_msg and not goal.given_up
    ]


def error_lines(evaluation: Evaluation) -> list[str]:
    """The figures of the whole run: errors, contacts and the markers seen."""
    error_m, error_rad = evaluation.localisation_error_m, evaluation.localisation_error_rad
    p95_deg = _degrees(error_rad.p95)
    inside_share = evaluation.localization.inside_95_percent
    lines = [
        "localisation error: no estimate"
        if error_m.mean is None
        else f"localisation error: mean {measured(error_m.mean, 3)} m, "
        f"p95 {measured(error_m.p95, 3)} m, p95 {measured(p95_deg, 2)} deg"
        + ("" if inside_share is None else f"; {inside_share:.0%} inside their 95 % ellipses"),
        f"contacts: {len(evaluation.contacts)}",
    ]
    counts = sorted(evaluation.markers_seen.items())
    if counts:
        seen = ", ".join(f"{name} ({count}x)" for name, count in counts)
        lines.append(f"markers seen: {seen}")
    return lines


def measured(value: float | None, digits: int) -> str:
    """A number, or a dash where nothing was measured."""
    return NOT_MEASURED if value is None else f"{value:.{digits}f}"


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else math.degrees(angle_rad)

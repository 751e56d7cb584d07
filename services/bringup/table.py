"""The table at the end of a tour."""

from __future__ import annotations

import math

from rich import box
from rich.console import Console
from rich.table import Table

from services.common.documents import Evaluation

_HEADINGS = (
    "goal",
    "reached",
    "time s",
    "path m",
    "shortest m",
    "loc. error m",
    "goal error m",
    "goal error deg",
    "contacts",
)


def tour_table(evaluation: Evaluation) -> str:
    """The goals of a run as text, a row each, and the run's errors and contacts below."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column(_HEADINGS[0])
    for heading in _HEADINGS[1:]:
        table.add_column(heading, justify="right")
    for goal in evaluation.goals:
        shortest = "-" if goal.shortest_path_m is None else f"{goal.shortest_path_m:.2f}"
        table.add_row(
            goal.name,
            "yes" if goal.reached else f"no ({goal.error_code})",
            f"{goal.time_s:.1f}",
            f"{goal.path_length_m:.2f}",
            shortest,
            f"{goal.localisation_error_m:.3f}",
            f"{goal.goal_error_m:.3f}",
            f"{math.degrees(goal.goal_error_rad):.1f}",
            str(goal.contacts),
        )
    console = Console(width=120, color_system=None)
    with console.capture() as capture:
        console.print(table)
    error_m, error_rad = evaluation.localisation_error_m, evaluation.localisation_error_rad
    counts = sorted(evaluation.markers_seen.items())
    seen = ", ".join(f"{name} ({count}x)" for name, count in counts)
    lines = [
        *(line.rstrip() for line in capture.get().splitlines() if line.strip()),
        f" localisation error: mean {error_m.mean:.3f} m, p95 {error_m.p95:.3f} m, "
        f"p95 {math.degrees(error_rad.p95):.2f} deg",
        f" contacts: {len(evaluation.contacts)}",
    ]
    if seen:
        lines.append(f" markers seen: {seen}")
    return "\n".join(lines)

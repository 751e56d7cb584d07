"""The table at the end of a tour."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table

from services.common.goal_table import HEADINGS, error_lines, failure_lines, goal_rows
from services.common.node.documents import Evaluation


def tour_table(evaluation: Evaluation) -> str:
    """The goals of a run as a text table, followed by the run's errors and contacts."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column(HEADINGS[0])
    for heading in HEADINGS[1:]:
        table.add_column(heading, justify="right")
    for row in goal_rows(evaluation.goals):
        table.add_row(*row)
    console = Console(width=120, color_system=None)
    with console.capture() as capture:
        console.print(table)
    lines = [line.rstrip() for line in capture.get().splitlines() if line.strip()]
    said = [*failure_lines(evaluation.goals), *error_lines(evaluation)]
    return "\n".join([*lines, *(f" {line}" for line in said)])

"""The table at the end of a tour."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table

from mazebot.common.figures.goal_table import HEADINGS, error_lines, failure_lines, goal_rows
from mazebot.common.figures.mapping_table import mapping_rows
from mazebot.common.messages.documents import Evaluation
from mazebot.common.messages.slam_documents import ExplorationStatus


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
    notes = [*failure_lines(evaluation.goals), *error_lines(evaluation)]
    return "\n".join([*lines, *(f" {line}" for line in notes)])


def exploration_table(status: ExplorationStatus, evaluation: Evaluation | None) -> str:
    """How an exploration ended, and the map it made, as lines of text."""
    rows = [
        (
            "explored",
            f"{status.seen_share:.1%} of the reachable floor, as estimated by the explorer",
        ),
        ("ended", status.reason),
        ("driven", f"{status.driven_m:.1f} m to {status.goals} view points"),
        (
            "frontiers",
            f"{status.frontiers} left: {status.reachable} reachable, {status.set_aside} set aside, "
            f"{status.left_out} beyond its limits",
        ),
    ]
    mapping = None if evaluation is None else evaluation.mapping
    if evaluation is None or mapping is None:
        rows.append(("map", "not evaluated by the recorder"))
    else:
        rows += mapping_rows(mapping)
        rows += [("", line) for line in error_lines(evaluation)]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"  {name:{width}}  {text}".rstrip() for name, text in rows)

"""`make seeds`: the tour of both worlds over ten seeds, evaluated against the ground truth."""

from __future__ import annotations

import json
import logging
import math
import statistics
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.embedded.demo import DemoOptions, build_nodes

WORLDS = ("sim_house_enhanced", "sim_house")
SEEDS = range(1, 11)

Summary = dict[str, Any]


def main() -> int:
    """Drive and print; return 0 if every goal was reached without a contact."""
    logging.disable(logging.INFO)
    console = Console()
    if not console.is_terminal:
        console.width = 120
    table = Table(
        "world", "goals reached", "contacts", "recoveries", "localisation p95 m", "p95 deg",
        "goal error m", "driven m", "simulated s", "state hashes", box=box.SIMPLE_HEAD,
        title="worst of all seeds, medians of what is driven and simulated",
    )  # fmt: skip
    well = True
    for world in WORLDS:
        summaries = []
        for seed in SEEDS:
            doing = f"{world} seed {seed}: driving"
            if not console.is_terminal:
                console.print(doing, style="dim")
            with console.status(doing):
                summaries.append(_tour(world, seed))
            console.print(f"{world} seed {seed}: {summaries[-1]['state_hash']}", style="dim")
        table.add_row(world, *_row(summaries))
        well = well and all(_is_well(summary) for summary in summaries)
    console.print(table)
    return 0 if well else 1


def _tour(world: str, seed: int) -> Summary:
    with tempfile.TemporaryDirectory() as folder:
        out_dir = Path(folder) / "run"
        options = DemoOptions(world_name=world, seed=seed, out_dir=out_dir, record=False)
        executive = Executive(build_nodes(options), MemoryTransport())
        try:
            executive.run()
        finally:
            executive.close()
        summary: Summary = json.loads((out_dir / "summary.json").read_text(encoding="utf-8"))
    return summary


def _is_well(summary: Summary) -> bool:
    reached = all(goal["reached"] for goal in summary["goals"])
    return reached and bool(summary["goals"]) and summary["contacts"]["count"] == 0


def _row(summaries: list[Summary]) -> list[str]:
    goals = [goal for summary in summaries for goal in summary["goals"]]

    def worst(value: Callable[[Summary], float | None]) -> float:
        measured = [value(summary) for summary in summaries]
        return max((one for one in measured if one is not None), default=math.nan)

    def median(name: str) -> float:
        return statistics.median(float(summary[name]) for summary in summaries)

    return [
        f"{sum(goal['reached'] for goal in goals)} of {len(goals)}",
        str(sum(summary["contacts"]["count"] for summary in summaries)),
        str(sum(goal["recoveries"] for goal in goals)),
        f"{worst(lambda summary: summary['localisation_error_m']['p95']):.3f}",
        f"{math.degrees(worst(lambda summary: summary['localisation_error_rad']['p95'])):.2f}",
        f"{max(filter(None, (goal['goal_error_m'] for goal in goals)), default=math.nan):.3f}",
        f"{median('distance_m'):.1f}",
        f"{median('sim_time_s'):.1f}",
        str(len({summary["state_hash"] for summary in summaries})),
    ]


if __name__ == "__main__":
    sys.exit(main())

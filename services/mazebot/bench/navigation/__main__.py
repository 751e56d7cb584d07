"""`make bench-nav`: navigation in many scenarios, judged by the ground truth."""

from __future__ import annotations

import argparse
import dataclasses
import json
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from mazebot.bench.bench_figures import tables
from mazebot.bench.navigation import parts
from mazebot.bench.navigation.courses.scenarios import BY_NAME, GROUPS, SCENARIOS
from mazebot.bench.navigation.plots import write_plots
from mazebot.bench.navigation.report import (
    as_json,
    ratio_table,
    read_summaries,
    summary,
    table,
)
from mazebot.bench.navigation.runner import Ran, Unit, quiet, run_units
from mazebot.bench.navigation.scenario import Options, Row
from mazebot.common.config import ConfigError, fail

PERCEPTION, TIMES = "perception", "times"
"""What is measured beside the scenarios"""
TIMED = ("patrols_yielding", "kidnap_lidar")
"""The scenarios in which computations are timed: five moving posts, and a robot that is lost"""


def units_of(chosen: Sequence[str], first_seed: int, seeds: int | None, full: bool) -> list[Unit]:
    """The seeds of each scenario, the first of all scenarios first, so that a run that is
    interrupted has something of each. Raises ConfigError for an unknown name.
    """
    found = []
    for place, name in enumerate(_names(chosen)):
        scenario = BY_NAME[name]
        count = seeds or (scenario.seeds if full else max(scenario.few, int(bool(chosen))))
        found += [(number, place, Unit(name, first_seed + number)) for number in range(count)]
    return [unit for _, _, unit in sorted(found)]


def _names(chosen: Sequence[str]) -> list[str]:
    names = [one for name in chosen for one in GROUPS.get(name, (name,))]
    for name in names:
        if name not in (*BY_NAME, PERCEPTION, TIMES):
            known = ", ".join([*GROUPS, *BY_NAME, PERCEPTION, TIMES])
            raise ConfigError(f"--scenario: {name!r:.60}: must be one of {known}")
    if not chosen:
        return [scenario.name for scenario in SCENARIOS]
    return [name for name in dict.fromkeys(names) if name in BY_NAME]


def _parsed(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench-nav", description=__doc__)
    parser.add_argument(
        "--scenario",
        action="append",
        default=[],
        metavar="NAME",
        help="a scenario or a group of scenarios; repeatable; default: all",
    )
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, help="seeds of each scenario")
    parser.add_argument("--full", action="store_true", help="all seeds: takes hours")
    parser.add_argument("--jobs", type=int, default=2, help="number of parallel processes")
    parser.add_argument("--no-camera", action="store_true", help="only the lidar, no camera")
    parser.add_argument("--settings", type=Path, help="settings file for all services")
    parser.add_argument("--json", type=Path, help="output file")
    parser.add_argument("--plots", type=Path, help="folder for pictures")
    parser.add_argument("--baseline", type=Path, help="JSON of another run to compare with")
    parser.add_argument("--list", action="store_true", help="print the scenarios")
    options = parser.parse_args(arguments)
    for name, least, most in (("seed", 0, 2**31), ("seeds", 1, 10_000), ("jobs", 1, 64)):
        value = getattr(options, name)
        if value is not None and not least <= value <= most:
            fail(f"--{name}: must be {least} to {most} (got {value})")
    return options


def main(arguments: list[str] | None = None) -> int:
    """Run, print the table, write the files; return 0."""
    asked = _parsed(arguments)
    console = Console()
    if not console.is_terminal:
        console.width = 200
    if asked.list:
        for scenario in SCENARIOS:
            console.print(f"{scenario.name:24}{scenario.few:4}{scenario.seeds:5}  {scenario.about}")
        return 0
    try:
        units = units_of(asked.scenario, asked.seed, asked.seeds, asked.full)
        baseline = read_summaries(asked.baseline) if asked.baseline else None
    except ConfigError as error:
        fail(str(error))
    options = Options(camera=not asked.no_camera, settings=asked.settings)
    start_s = time.perf_counter()
    with _interruptible():
        rows = _run(units, options, asked.jobs, console)
    summaries = {name: summary(found) for name, found in rows.items()}
    if rows:
        console.print(table(summaries))
    if baseline is not None:
        console.print(ratio_table(summaries, baseline))
    measured = _parts(asked.scenario, asked.seed, asked.full, options, console)
    if asked.json is not None:
        settings = {"seed": asked.seed, "camera": options.camera, "full": asked.full,
                "took_s": round(time.perf_counter() - start_s, 1)}  # fmt: skip
        _write(asked.json, as_json(rows, settings) | measured)
        console.print(f"figures: {asked.json}", soft_wrap=True)
    if asked.plots is not None:
        try:
            files = write_plots(asked.plots, rows, summaries)
        except OSError as error:
            fail(f"--plots: {asked.plots}: {error.strerror}")
        console.print(f"{len(files)} pictures: {asked.plots}", soft_wrap=True)
    return 0


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let both signals raise KeyboardInterrupt: a shell lets its background jobs ignore SIGINT."""
    before = {
        number: signal.signal(number, signal.default_int_handler)
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run(
    units: Sequence[Unit], options: Options, jobs: int, console: Console
) -> dict[str, list[Row]]:
    """The rows of each scenario in the table's order, by seed."""
    rows: dict[str, list[Row]] = {
        name: [] for name in BY_NAME if name in {u.scenario for u in units}
    }
    console.print(f"{len(units)} drives, {jobs} at a time", style="dim", highlight=False)
    try:
        for number, (unit, ran) in enumerate(run_units(units, options, jobs), 1):
            rows[unit.scenario] += ran.rows
            console.print(
                f"{number}/{len(units)} {_progress_line(unit, ran)}",
                style="dim", markup=False, highlight=False, soft_wrap=True,
            )  # fmt: skip
    except KeyboardInterrupt:
        console.print("interrupted: partial results", style="red")
    for found in rows.values():
        found.sort(key=lambda row: (row.seed, row.trial))
    return rows


def _parts(
    chosen: Sequence[str], seed: int, full: bool, options: Options, console: Console
) -> dict[str, Any]:
    """Measure and print what is no scenario; its figures as JSON."""
    measured: dict[str, Any] = {}
    with quiet():
        if not chosen or PERCEPTION in chosen:
            pictures = parts.PERCEPTION_PICTURES_FULL if full else parts.PERCEPTION_PICTURES
            measured[PERCEPTION], made = parts.perception(pictures, seed)
            for one in made:
                console.print(one)
        if not chosen or TIMES in chosen:
            drives = [(BY_NAME[name].run, name) for name in TIMED]
            figures = parts.times(drives, options)
            measured[TIMES] = [dataclasses.asdict(one) for one in figures]
            for one in tables(figures):
                console.print(one)
    return measured


def _progress_line(unit: Unit, ran: Ran) -> str:
    """How a unit ended, with its processor time and the first error of its trials."""
    good = sum(row.success for row in ran.rows)
    broke = next((row.error_msg for row in ran.rows if row.error_msg and not row.success), "")
    return f"{unit.scenario} seed {unit.seed}: {good}/{len(ran.rows)} {ran.cpu_s:.1f} s {broke}"


def _write(path: Path, content: dict[str, Any]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        fail(f"--json: {path}: {error.strerror}")


if __name__ == "__main__":
    sys.exit(main())

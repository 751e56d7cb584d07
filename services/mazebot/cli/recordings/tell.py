"""`mazebot recordings list|info|compare`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mazebot.cli.parsing.options import print_json
from mazebot.cli.recordings.printing import info_row, number_text, print_table, printable, size_text
from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import RecordingInfo, find_run
from mazebot.common.recordings.comparing.wholeness import faults, recording_faults
from mazebot.common.recordings.figures import FIGURES, figure_text, figures_of
from mazebot.common.recordings.run_settings import read_summary

_STATES = {"ended": "", "running": "running", "interrupted": "interrupted"}
_MOST_TEXT = 60


def print_runs(directory: Path, runs: Sequence[RecordingInfo], as_json: bool) -> None:
    """Print runs, one a line."""
    if as_json:
        print_json([info_row(run) for run in runs])
        return
    if not runs:
        sys.stdout.write(f"no recordings in {directory}; `make demo` creates one\n")
        return
    headings = (
        "name",
        "world",
        "started",
        "goals",
        "simulated s",
        "error m",
        "size MB",
        "tags",
        "state",
    )
    rows = [
        (
            run.name,
            run.world,
            run.started.strftime("%Y-%m-%d %H:%M:%S") if run.started else "-",
            f"{run.goals_reached}/{run.goals_total}",
            number_text(run.sim_time_s, 0),
            number_text(run.error_mean_m, 3),
            size_text(run.size_bytes),
            " ".join(run.tags),
            run.problem or ", ".join(filter(None, (_STATES[run.state], run.gap))),
        )
        for run in runs
    ]
    print_table(headings, rows, right=("goals", "simulated s", "error m", "size MB"))


def print_run(directory: Path, name: str, as_json: bool) -> None:
    """Print what is known of a run. Raises ConfigError where there is no such run."""
    run = find_run("recordings info", directory, name)
    try:
        figures = figures_of(read_summary(run.path))
    except ConfigError:
        # Said by the catalog as the run's problem.
        figures = figures_of({})
    sizes = {name: (run.path / name).stat().st_size for name in run.files}
    wrong = (*recording_faults(run.path), *faults(run.path))
    if as_json:
        told = {"faults": wrong, "files": sizes, "figures": figures}
        print_json(info_row(run) | told)
        return
    lines = [
        ("name", run.name),
        ("folder", str(run.path)),
        ("state", run.state),
        ("world", run.world or "-"),
        ("seed", "-" if run.seed is None else str(run.seed)),
        ("started", f"{run.started:%Y-%m-%d %H:%M:%S}" if run.started else "-"),
        ("goals", f"{run.goals_reached} of {run.goals_total} reached"),
        *((("exploration", run.exploration),) if run.exploration else ()),
        *((("problem", run.problem),) if run.problem else ()),
        *((("incomplete", run.gap),) if run.gap else ()),
        *(("fault", fault) for fault in wrong),
        *((("tags", " ".join(run.tags)),) if run.tags else ()),
        *((("note", run.note),) if run.note else ()),
        *(
            (figure.title, f"{figure_text(figure, figures[figure.name])} {figure.unit}".strip())
            for figure in FIGURES
            if figures[figure.name] is not None and not figure.name.startswith("goals_")
        ),
        *((f"set {name}", str(value)) for name, value in (run.changed_settings or {}).items()),
        *((f"file {name}", f"{size_text(size)} MB") for name, size in sizes.items()),
    ]
    shown = [(printable(title), printable(text)) for title, text in lines]
    width = max(len(title) for title, _ in shown)
    sys.stdout.write("".join(f"{title.ljust(width)}  {text}\n" for title, text in shown))


def print_comparison(directory: Path, names: Sequence[str], messages: bool, as_json: bool) -> int:
    """Print the differences of runs from the first one; returns 1 where the files of a run are cut,
    missing or another run's, else 0.

    Raises ConfigError where there are fewer than two, one is no run, or a file cannot be read.
    """
    from mazebot.common.recordings.comparing.compare_runs import compare_runs  # noqa: PLC0415

    command = "recordings compare"
    if len(names) < 2:
        raise ConfigError(f"{command}: {' '.join(names)}: must be two runs or more")
    found = [find_run(command, directory, name) for name in names]
    folders = [run.path for run in found]
    try:
        comparison = compare_runs(folders, messages)
    except ConfigError as error:
        raise ConfigError(f"{command}: {error}") from error
    code = int(any(comparison.faults))
    if as_json:
        print_json(comparison.model_dump(mode="json"))
        return code
    runs = comparison.runs
    lacks = [
        ", ".join(filter(None, (_STATES[run.state], run.gap, *of_run)))
        for run, of_run in zip(found, comparison.faults, strict=True)
    ]
    print_table(
        ("runs", "", ""),
        [(f"({row + 1})", *told) for row, told in enumerate(zip(runs, lacks, strict=True))],
    )
    short = [f"({row + 1})" for row in range(len(runs))]
    sys.stdout.write("\n")
    if comparison.settings:
        print_table(
            ("setting", *short),
            [(row.name, *map(_value_text, row.values)) for row in comparison.settings],
        )
    else:
        sys.stdout.write(" the same world, seed, configuration and versions\n")
    sys.stdout.write("\n")
    digits = {figure.name: figure for figure in FIGURES}
    headings = ["figure", short[0], *(text for one in short[1:] for text in (one, f"{one} is"))]
    rows = []
    for row in comparison.figures:
        figure = digits[row.name]
        cells = [f"{row.title}{f', {row.unit}' if row.unit else ''}"]
        cells.append(figure_text(figure, row.values[0]))
        for value, delta, judgement in zip(
            row.values[1:], row.deltas[1:], row.judgements[1:], strict=True
        ):
            cells.append(figure_text(figure, value))
            changed = delta is not None and judgement != "same"
            by = f" {figure_text(figure, delta, signed=True)}" if changed else ""
            word = "" if judgement in (None, "other") else judgement
            cells.append(f"{word}{by}".strip() or "-")
        rows.append(cells)
    print_table(headings, rows, right=short)
    for name, verdict in zip(runs[1:], comparison.messages, strict=False):
        sys.stdout.write(f"\n messages of {name} against {runs[0]}:\n")
        sys.stdout.write("".join(f"   {printable(line)}\n" for line in verdict.lines))
    return code


def _value_text(value: Any) -> str:
    return "-" if value is None else str(value)[:_MOST_TEXT]

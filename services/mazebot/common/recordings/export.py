"""One table of many runs, or of their goals, as Parquet, CSV or JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from mazebot.common.config import ConfigError
from mazebot.common.files.folder_writing import write_file
from mazebot.common.recordings.catalog import RecordingInfo
from mazebot.common.recordings.figures import figures_of
from mazebot.common.recordings.run_settings import read_summary

SUFFIXES = (".parquet", ".csv", ".json")
Rows = Literal["runs", "goals"]
Row = dict[str, Any]

_NOT_FLAT = ("goals", "contacts", "messages", "changed_settings", "mapping", "markers_seen")
"""Parts of a summary with a length of their own; their figures are in the table."""


def rows_of(runs: Iterable[RecordingInfo], rows: Rows) -> list[Row]:
    """A row a run, oldest first: what `list` prints, then summary.json, nested names joined by
    dots, then the settings that are not the defaults, as `settings.<service>.<field>`. Or a row a
    goal, with the name of its run. A summary that cannot be read leaves its columns empty.
    """
    table: list[Row] = []
    for run in sorted(runs, key=lambda run: run.name):
        try:
            summary = read_summary(run.path)
        except ConfigError:
            summary = {}
        if rows == "goals":
            table += _goal_rows(run, summary)
        else:
            table.append(_run_row(run, summary))
    return table


def write_table(file: Path, table: Sequence[Row]) -> None:
    """Write rows to a file in the format of its suffix; a row that lacks a column has null there.

    Raises ConfigError with one line where the suffix is another one, or the file cannot be written.
    """
    names = list(dict.fromkeys(name for row in table for name in row))
    columns = {name: [row.get(name) for row in table] for name in names}
    if file.suffix not in SUFFIXES:
        raise ConfigError(f"--out: {file}: must end in {', '.join(SUFFIXES)}")
    try:
        if file.suffix == ".parquet":
            data = _parquet(columns)
        elif file.suffix == ".csv":
            data = _csv(columns)
        else:
            full = [{name: row.get(name) for name in names} for row in table]
            data = json.dumps(full, indent=1).encode()
        write_file(file, data)
    except OSError as error:
        raise ConfigError(f"--out: {file}: {error.strerror}") from error


def _run_row(run: RecordingInfo, summary: Mapping[str, Any]) -> Row:
    row: Row = {
        "name": run.name,
        "started": run.started.isoformat() if run.started else None,
        "state": run.state,
        "failed": run.failed,
        "world": run.world,
        "seed": run.seed,
        "slam": run.slam,
        "tags": ",".join(run.tags),
        "note": run.note,
        "size_bytes": run.size_bytes,
        "problem": run.problem,
        "goals_total": run.goals_total,
        "messages_received": run.messages_received,
        "messages_recorded": run.messages_recorded,
    }
    flat = dict(_flat("", {name: summary[name] for name in summary if name not in _NOT_FLAT}))
    row |= {name: value for name, value in flat.items() if name not in row}
    row |= figures_of(summary)
    settings = run.changed_settings or {}
    return row | {f"settings.{name}": _plain(value) for name, value in settings.items()}


def _goal_rows(run: RecordingInfo, summary: Mapping[str, Any]) -> Iterator[Row]:
    goals = summary.get("goals")
    for number, goal in enumerate(goals if isinstance(goals, list) else []):
        if isinstance(goal, dict):
            known = {"run": run.name, "world": run.world, "seed": run.seed, "number": number}
            yield known | dict(_flat("", goal))


def _flat(prefix: str, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(f"{prefix}{name}.", value)
        else:
            yield f"{prefix}{name}", _plain(value)


def _plain(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, dict | list) else value


def _rows(columns: Mapping[str, list[Any]]) -> Iterator[tuple[Any, ...]]:
    return zip(*columns.values(), strict=True)


def _csv(columns: Mapping[str, list[Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(_rows(columns))
    return text.getvalue().encode()


def _parquet(columns: Mapping[str, list[Any]]) -> bytes:
    # Takes 0.2 s to load.
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet  # noqa: PLC0415

    arrays = {}
    for name, values in columns.items():
        kinds = {type(value) for value in values if value is not None}
        if kinds == {int, float}:
            values = [None if value is None else float(value) for value in values]  # noqa: PLW2901
        elif len(kinds) > 1:
            # A setting may be a number in one run and a text in another.
            values = [None if value is None else str(value) for value in values]  # noqa: PLW2901
        try:
            arrays[name] = pa.array(values)
        except (OverflowError, pa.ArrowInvalid):
            arrays[name] = pa.array([None if value is None else str(value) for value in values])
    sink = pa.BufferOutputStream()
    pa.parquet.write_table(pa.table(arrays), sink, compression="zstd")
    return bytes(sink.getvalue())

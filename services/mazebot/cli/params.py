"""`mazebot params`: what becomes of a parameter file of Nav2."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path

import yaml
from pydantic import BaseModel

from mazebot.cli.parsing.known import model_of
from mazebot.cli.parsing.options import print_json
from mazebot.common.nav2_params.report import STATUSES, Report, Row, report
from mazebot.common.settings.load import read_nav2_params, sections

_WIDEST = 28
_HEADS = {
    "used": "used: as they stand",
    "mapped": "mapped: under another name, or with another value",
    "unsupported": "unsupported: parameters of Nav2 that change nothing here",
    "unknown": "unknown: no parameters of Nav2, which ignores them too",
}


def tell_params(path: Path, as_json: bool, as_settings: bool) -> None:
    """Print what becomes of each parameter of a file of Nav2, or the settings that come of it.

    Raises ConfigError where the file cannot be read, or holds a value that is not valid.
    """
    told = report(read_nav2_params(path), models_of_all())
    if as_settings:
        sys.stdout.write(yaml.safe_dump(dict(told.settings), sort_keys=False))
    elif as_json:
        print_json(in_json(told))
    else:
        sys.stdout.write("\n".join(_lines(told)) + "\n")


def models_of_all() -> dict[str, type[BaseModel]]:
    """The configuration of every section, by its name."""
    return {section: model_of(section) for section in sections()}


def in_json(told: Report) -> dict[str, object]:
    """The report for programs."""
    return {
        "file": told.name,
        "parameters": len(told.rows),
        "counts": told.counts,
        "rows": [dataclasses.asdict(row) | {"value": _plain(row.value)} for row in told.rows],
        "settings": _plain(dict(told.settings)),
    }


def _lines(told: Report) -> Iterator[str]:
    for status in STATUSES:
        rows = [row for row in told.rows if row.status == status]
        if rows:
            yield f"{_HEADS[status]} ({len(rows)})"
            yield from _table(rows)
            yield ""
    counts = ", ".join(f"{count} {status}" for status, count in told.counts.items())
    yield f"{told.name}: {len(told.rows)} parameters: {counts}"


def _table(rows: list[Row]) -> Iterator[str]:
    cells = []
    for row in rows:
        name = f"{row.node}.{row.parameter}"
        value = _short(row.value)
        target = [f"-> {row.setting}"] if row.setting else []
        note = "; ".join([*target, *([row.note] if row.note else [])])
        cells.append((f"{row.line}", name, value, note))
    widths = [max(len(row[at]) for row in cells) for at in range(3)]
    for line, name, value, note in cells:
        text = f"  {line:>{widths[0]}}  {name:<{widths[1]}}  {value:<{widths[2]}}  {note}"
        yield text.rstrip()


def _short(value: object) -> str:
    text = str(value).lower() if isinstance(value, bool) else " ".join(str(value).split())
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."


def _plain(value: object) -> object:
    """The value as JSON has it: infinity is a text."""
    if isinstance(value, float) and value in {float("inf"), float("-inf")}:
        return str(value)
    if isinstance(value, float) and value != value:  # noqa: PLR0124 - NaN
        return "nan"
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list) else value

"""Tables of text, and what programs read of a run."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Collection, Sequence

from mazebot.common.problems import words
from mazebot.common.recordings.catalog import RecordingInfo


def print_table(
    headings: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[str] = ()
) -> None:
    """Print columns, those named in `right` aligned there; thousands of rows take no time."""
    table = [list(headings), *(list(map(printable, row)) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = []
    for row in table:
        cells = (
            cell.rjust(width) if heading in right else cell.ljust(width)
            for heading, cell, width in zip(headings, row, widths, strict=True)
        )
        lines.append(f" {'  '.join(cells)}".rstrip())
    rule = " " + "─" * (sum(widths) + 2 * (len(widths) - 1))
    sys.stdout.write("\n".join([lines[0], rule, *lines[1:]]) + "\n")


def info_row(run: RecordingInfo) -> dict[str, object]:
    """A run as JSON values."""
    return dataclasses.asdict(run) | {
        "path": str(run.path),
        "started": run.started.isoformat() if run.started else None,
        "recording": str(run.recording) if run.recording else None,
        "failed": run.failed,
    }


def printable(text: str) -> str:
    """A text of a recording with its control characters as codes: a terminal obeys them."""
    return text if text.isprintable() else words(text)


def size_text(size_bytes: float) -> str:
    """A size in MB."""
    return f"{size_bytes / 1e6:.1f}"


def number_text(value: float | None, digits: int) -> str:
    """A number; a dash if there is none."""
    return "-" if value is None else f"{value:.{digits}f}"

"""Compares runs: their settings, their figures, and whether their messages are the same."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, JsonValue
from pydantic_core import to_jsonable_python

from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import Document, Finite
from mazebot.common.messages.topics import CMD_VEL
from mazebot.common.recordings.comparing.digests import DigestError, Digests, read_digests
from mazebot.common.recordings.comparing.run_comparison import Comparison, Difference, compare
from mazebot.common.recordings.comparing.wholeness import faults
from mazebot.common.recordings.figures import FIGURES, Direction, Figure, figures_of
from mazebot.common.recordings.run_folder import DIGESTS
from mazebot.common.recordings.run_settings import read_summary, settings_of

_CONTROL_RATE_HZ = CMD_VEL.rate_hz or 20.0
_MOST_LINES = 12

Judgement = Literal["better", "worse", "same", "other"]


class SettingRow(Document):
    """A setting that is not the same in all runs."""

    name: str = Field(description="`world`, `seed`, `version.<package>` or `service.field`")
    values: tuple[JsonValue, ...] = Field(description="of each run; null: it has none")


class FigureRow(Document):
    """A figure of each run, and its difference from the first run's."""

    name: str = Field(description="its path in summary.json, or what it is computed from")
    title: str = Field(description="what it is, in words")
    unit: str = Field(description="empty: none")
    better: Direction = Field(description="which way it is better")
    values: tuple[Finite | None, ...] = Field(description="of each run; null: not measured")
    deltas: tuple[Finite | None, ...] = Field(description="from the first run's value")
    judgements: tuple[Judgement | None, ...] = Field(
        description="of each run against the first; `other`: it differs, and neither is better"
    )


class MessagesVerdict(Document):
    """The result of `mazebot diff` for a run against the first one."""

    same: bool | None = Field(description="whether all messages are the same; null: not known")
    lines: tuple[str, ...] = Field(description="the same in words")


class RunsComparison(Document):
    """Two or more runs side by side; the first is what the others are compared with."""

    runs: tuple[str, ...] = Field(description="names of their folders")
    faults: tuple[tuple[str, ...], ...] = Field(
        (), description="of each run: what its files lack, or have of another run"
    )
    settings: tuple[SettingRow, ...] = Field(description="those that differ")
    figures: tuple[FigureRow, ...] = Field(description="those that at least one run has")
    messages: tuple[MessagesVerdict, ...] = Field(
        description="of every run but the first, in the same order"
    )


def compare_runs(folders: Sequence[Path], messages: bool = True) -> RunsComparison:
    """Compare two or more runs with the first; `messages`: also by their digests.

    Raises ConfigError with one line where a file of a run cannot be read.
    """
    settings = [settings_of(folder) for folder in folders]
    figures = [figures_of(read_summary(folder)) for folder in folders]
    rows = (_figure_row(figure, [run[figure.name] for run in figures]) for figure in FIGURES)
    return RunsComparison(
        runs=tuple(folder.resolve().name for folder in folders),
        faults=tuple(map(faults, folders)),
        settings=tuple(_setting_rows(settings)),
        figures=tuple(row for row in rows if any(value is not None for value in row.values)),
        messages=tuple(_verdicts(folders)) if messages else (),
    )


def comparison_lines(comparison: Comparison) -> Iterator[str]:
    """The differences in two runs' messages, in words."""
    differences = comparison.differences
    first_ns, second_ns = comparison.ends_ns
    if differences:
        yield f"first difference: {_line(differences[0])}"
        for difference in differences[1:_MOST_LINES]:
            yield f"             then: {_line(difference)}"
        if len(differences) > _MOST_LINES:
            yield f"             and on {len(differences) - _MOST_LINES} more topics"
        yield f"{comparison.messages} messages are the same"
    else:
        common_s = min(first_ns, second_ns) * 1e-9
        yield f"the same: {comparison.messages} messages in {common_s:.3f} s of simulation time"
    if first_ns != second_ns:
        longer = "first" if first_ns > second_ns else "second"
        yield f"the {longer} run continues for another {abs(first_ns - second_ns) * 1e-9:.3f} s"
    for which, lost in zip(("first", "second"), comparison.lost, strict=True):
        if lost:
            yield f"{lost} messages were not received by the {which} run's recorder: not compared"


def read_run_digests(folder: Path) -> Digests:
    """The digests of a run's messages. Raises ConfigError with one line where there are none."""
    try:
        return read_digests(folder / DIGESTS)
    except FileNotFoundError as error:
        raise ConfigError(f"{folder} has no {DIGESTS}: it was run without recording") from error
    except OSError as error:
        raise ConfigError(f"{folder / DIGESTS}: {error.strerror}") from error
    except DigestError as error:
        raise ConfigError(str(error)) from error


def _verdicts(folders: Sequence[Path]) -> Iterator[MessagesVerdict]:
    """A run without digests has no verdict, and the others still have theirs."""
    first: Digests | None = None
    for folder in folders[1:]:
        try:
            first = first or read_run_digests(folders[0])
            comparison = compare(first, read_run_digests(folder))
        except ConfigError as error:
            yield MessagesVerdict(same=None, lines=(str(error),))
        else:
            lines = tuple(comparison_lines(comparison))
            yield MessagesVerdict(same=not comparison.differences, lines=lines)


def _setting_rows(settings: Sequence[dict[str, Any]]) -> Iterator[SettingRow]:
    """A service that not all runs have is one row, and so is the seed that all services share."""
    services = [{name.partition(".")[0] for name in run if "." in name} for run in settings]
    missing = {name for run in services for name in run if not all(name in one for one in services)}
    for name in sorted(missing):
        yield SettingRow(
            name=name, values=tuple("running" if name in run else None for run in services)
        )
    for name in dict.fromkeys(name for run in settings for name in run):
        service, dot, field = name.partition(".")
        is_common_seed = field == "seed" and all(
            run.get(name) == run.get("seed") for run in settings
        )
        values = [to_jsonable_python(run.get(name), fallback=str) for run in settings]
        is_told = (dot and service in missing) or is_common_seed
        if not is_told and any(value != values[0] for value in values):
            yield SettingRow(name=name, values=tuple(values))


def _figure_row(figure: Figure, values: list[float | None]) -> FigureRow:
    first = values[0]
    deltas = [None if None in (value, first) else value - first for value in values]  # type: ignore[operator]
    return FigureRow(
        name=figure.name,
        title=figure.title,
        unit=figure.unit,
        better=figure.better,
        values=tuple(values),
        deltas=tuple(deltas),
        judgements=tuple(_judgement(figure, delta) for delta in deltas),
    )


def _judgement(figure: Figure, delta: float | None) -> Judgement | None:
    """A difference too small to be printed is none."""
    if delta is None:
        return None
    if abs(delta) < 0.5 * 10.0**-figure.digits:
        return "same"
    if figure.better == "neither":
        return "other"
    return "better" if (delta > 0.0) == (figure.better == "higher") else "worse"


def _line(difference: Difference) -> str:
    tick = int(difference.time_ns * 1e-9 * _CONTROL_RATE_HZ)
    of = f" of {difference.source}" if difference.source else ""
    how = {None: "differs", 0: "is in the first run only", 1: "is in the second run only"}
    return (
        f"{difference.time_ns * 1e-9:.3f} s (control tick {tick}), {difference.topic}{of}: "
        f"message {difference.number} {how[difference.only_in]}"
    )

"""The report of a run: one HTML page without scripts, which needs nothing else."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
from pydantic import ValidationError

from mazebot.common.config import ConfigError, one_line
from mazebot.common.figures.goal_table import HEADINGS, failure_lines, goal_rows
from mazebot.common.figures.mapping_table import mapping_rows
from mazebot.common.recordings.catalog import RecordingInfo, run_at
from mazebot.common.recordings.figures import FIGURES, figure_text, figures_of
from mazebot.common.recordings.report.plan import plan_of
from mazebot.common.recordings.report.plots import Line, Plot, plot
from mazebot.common.recordings.report.thumbnail import thumbnail_png
from mazebot.common.recordings.run_folder import (
    REPORT,
    SERIES,
    SUMMARY,
    THUMBNAIL,
    write_atomically,
)
from mazebot.common.recordings.run_settings import read_config, read_summary
from mazebot.common.recordings.series import RunSeries, read_series
from mazebot.common.recordings.summary import RunSummary

_HERE = Path(__file__).parent
_MADE_MAP = Path("map") / "map.yaml"
_MOST_GOALS = 200
_MOST_MARKS = 60
_DEGREES = 180.0 / math.pi


class Verdict(NamedTuple):
    """How a run went, and how good that is: `good`, `warn` or `bad`."""

    text: str
    kind: str


def write_report(folder: Path) -> list[Path]:
    """Write report.html and thumbnail.png of a run, from its other files; return their paths.

    What is missing, as in a run that was killed early, the report says. Raises ConfigError with one
    line where the folder holds no run, or a file cannot be written.
    """
    series, problem = _series(folder)
    written = {REPORT: report_html(folder, series, problem).encode()}
    if series is not None:
        written[THUMBNAIL] = thumbnail_png(series)
    for name, data in written.items():
        try:
            write_atomically(folder / name, [data], sync=False)
        except OSError as error:
            raise ConfigError(f"{folder / name}: {error.strerror}") from error
    return [folder / name for name in written]


def report_html(folder: Path, series: RunSeries | None, problem: str = "") -> str:
    """The text of a run's report; `problem`: why there is no series.

    Raises ConfigError with one line where the folder holds no run.
    """
    run = run_at(folder)
    if run is None:
        raise ConfigError(f"{folder}: contains no run")
    notices = [problem] if problem else []
    if run.state != "ended":
        why = "has not ended" if run.state == "running" else "was interrupted: its recorder died"
        notices.append(f"This run {why}; the report shows its latest {SUMMARY}.")
    if run.gap:
        notices.append(f"The disk had no room for all of it: {run.gap}.")
    content: dict[str, Any] = {}
    for part in (_from_summary, _from_config):
        try:
            content |= part(folder)
        except ConfigError as error:
            notices.append(str(error).removeprefix(f"{folder}/"))
    if series is not None:
        content |= _from_series(series, folder)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE),
        autoescape=True,
        undefined=_Nothing,
        keep_trailing_newline=True,
    )
    css = (_HERE / "report.css").read_text(encoding="utf-8")
    return environment.get_template("report.html.jinja").render(
        name=run.name,
        world=run.world,
        seed=run.seed,
        started=_time_text(run.started),
        slam=run.slam,
        tags=run.tags,
        note=run.note,
        verdict=verdict_of(run),
        notices=notices,
        css=jinja2.filters.do_mark_safe(css.rstrip()),
        **content,
    )


def verdict_of(run: RecordingInfo) -> Verdict | None:
    """How a run went, in a few words; None if nothing is known of it."""
    if run.problem is not None:
        return Verdict("cannot be read", "bad")
    broken = ", interrupted" if run.state == "interrupted" else ""
    if run.exploration:
        kind = "good" if run.exploration == "complete" and not broken else "warn"
        return Verdict(f"exploration {run.exploration}{broken}", kind)
    if not run.goals_total:
        return Verdict("interrupted", "bad") if broken else None
    reached = f"{run.goals_reached} of {run.goals_total} goals reached"
    touched = f", {run.contacts} contacts" if run.contacts else ""
    kind = "bad" if run.failed else "warn" if run.contacts else "good"
    return Verdict(reached + touched + broken, kind)


class _Nothing(jinja2.Undefined):
    """What a run does not have is left out of its report."""


def _series(folder: Path) -> tuple[RunSeries | None, str]:
    try:
        series = read_series(folder)
    except ConfigError as error:
        return None, str(error).removeprefix(f"{folder}/")
    if series is None:
        return None, f"There is no {SERIES}: no plan and no plots can be drawn."
    return series, ""


def _from_summary(folder: Path) -> dict[str, Any]:
    values = read_summary(folder)
    if not values:
        raise ConfigError(f"There is no {SUMMARY}: its goals and errors are unknown.")
    figures = figures_of(values)
    content: dict[str, Any] = {
        "figures": [
            {
                "title": figure.title,
                "text": f"{figure_text(figure, figures[figure.name])} {figure.unit}".strip(),
            }
            for figure in FIGURES
            if figures[figure.name] is not None
        ]
    }
    try:
        summary = RunSummary.model_validate(values)
    except ValidationError as error:
        # For example of another version of Mazebot.
        raise ConfigError(f"{SUMMARY}: {one_line(error):.300}") from error
    hardware = summary.hardware
    content |= {
        "goals": goal_rows(summary.goals[-_MOST_GOALS:]),
        "goals_left_out": max(len(summary.goals) - _MOST_GOALS, 0),
        "goal_headings": HEADINGS,
        "failures": [
            line if count == 1 else f"{line} ({count} times)"
            for line, count in Counter(failure_lines(summary.goals[-_MOST_GOALS:])).items()
        ],
        "changed": [
            {"name": name, "value": _text(setting.value), "default": _text(setting.default)}
            for name, setting in summary.changed_settings.items()
        ],
        "versions": [
            *summary.versions.items(),
            *(_hardware_rows(hardware.model_dump()) if hardware else []),
            *([("renderer", summary.renderer)] if summary.renderer else []),
            *([("state hash", summary.state_hash)] if summary.state_hash else []),
            *([("world hash", summary.world_hash)] if summary.world_hash else []),
        ],
        "messages": [
            {
                **{name: _text(value) for name, value in counts.model_dump().items()},
                "topic": topic,
                "why": "; ".join(f"{why}: {count}" for why, count in counts.rejected_by.items()),
            }
            for topic, counts in sorted(summary.messages.items())
        ],
        "messages_text": _messages_text(figures, len(summary.messages)),
    }
    if summary.mapping is not None:
        steps = summary.mapping.coverage
        coverage = Line(
            "floor mapped",
            [step.time_s for step in steps],
            [100.0 * step.coverage_share for step in steps],
            has_gaps=False,
        )
        end_s = summary.sim_time_s or 0.0
        content |= {
            "mapping_rows": mapping_rows(summary.mapping),
            "mapping_plots": _drawn(plot("coverage", "Floor mapped", "%", [coverage], end_s)),
        }
    return content


def _from_config(folder: Path) -> dict[str, Any]:
    request = read_config(folder).get("world_request")
    if not isinstance(request, dict):
        return {}
    return {"request": [(str(name), _text(value)) for name, value in request.items()]}


def _from_series(series: RunSeries, folder: Path) -> dict[str, Any]:
    truth, estimate, end_s = series.truth, series.estimate, series.sim_time_s
    ends_s = [goal.end_s for goal in series.goals if goal.end_s is not None]
    marks_s = ends_s if len(ends_s) <= _MOST_MARKS else []
    degrees = [value * _DEGREES for value in estimate.error_rad]
    rates = [value * _DEGREES for value in truth.yaw_rate_rad_s]
    plots = (
        plot("error", "Localisation error", "m",
             [Line("error", estimate.time_s, estimate.error_m)], end_s, marks_s),
        plot("heading", "Heading error", "deg",
             [Line("error", estimate.time_s, degrees)], end_s, marks_s),
        plot("speed", "Speed", "m/s",
             [Line("true", truth.time_s, truth.speed_m_s)], end_s, marks_s),
        plot("rate", "Yaw rate", "deg/s", [Line("true", truth.time_s, rates)], end_s, marks_s),
        plot("pace", "Real-time factor", "",
             [Line("factor", series.pace.time_s, series.pace.real_time_factor)], end_s),
    )  # fmt: skip
    costs = sorted(
        series.costs.items(), key=lambda entry: -max(entry[1].step_time_p99_ms, default=0)
    )
    lines = [Line(name, rows.time_s, rows.step_time_p99_ms) for name, rows in costs]
    return {
        "plan": plan_of(series, folder / _MADE_MAP if series.slam else None),
        "plots": _drawn(*plots),
        "cost_plots": _drawn(plot("cost", "Step time, 99th percentile", "ms", lines, end_s)),
        "costs": [
            {
                "name": name,
                "newest": f"{rows.step_time_p99_ms[-1]:.1f}",
                "highest": f"{max(rows.step_time_p99_ms):.1f}",
                "missed": f"{rows.missed_periods[-1]:.0f}",
            }
            for name, rows in costs
            if rows.time_s
        ],
        "events": series.events,
        "events_dropped": series.events_dropped,
    }


def _drawn(*plots: Plot | None) -> list[Plot]:
    return [one for one in plots if one is not None]


def _hardware_rows(hardware: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [(name.replace("_mib", ", MiB"), _text(value)) for name, value in hardware.items()]


def _messages_text(figures: Mapping[str, float | None], topics: int) -> str:
    lost, rejected = figures["messages_lost"] or 0.0, figures["messages_rejected"] or 0.0
    return f"{topics} topics; {lost:.0f} messages lost, {rejected:.0f} rejected"


def _time_text(started: datetime | None) -> str:
    return "" if started is None else f"{started:%Y-%m-%d %H:%M:%S}"


def _text(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value)) or "-"
    return str(value) or "-"

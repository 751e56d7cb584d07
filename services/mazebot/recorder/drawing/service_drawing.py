"""What is drawn of the services' own reports: states, faults, and figures over time."""

from __future__ import annotations

import rerun as rr

from mazebot.common.messages import messages as msg
from mazebot.common.node.diagnostics import (
    FIGURE_KEYS,
    LOST_KEY,
    MISSED_KEY,
    RATE_KEY,
    REJECTED_KEY,
    STEP_TIME_KEY,
    WAITING_KEY,
)
from mazebot.recorder.drawing import palette
from mazebot.recorder.drawing.canvas import Canvas, entity_part

FIGURES = "performance"
"""Above the entities of the figures: one viewer's plot has the same figure of all services."""


def draw_diagnostics(canvas: Canvas, array: msg.DiagnosticArray) -> None:
    """Each service's state and figures over time, and each change as text."""
    canvas.at(array.header.stamp)
    for status in array.status:
        path = f"diagnostics/{entity_part(status.name)}"
        entries = [
            (v.key, v.value) for v in status.values
            if v.value and v.key not in FIGURE_KEYS and not v.key.startswith(RATE_KEY)
        ]  # fmt: skip
        _draw_state(canvas, path, status, entries)
        _draw_figures(canvas, status)
        if canvas.changed(f"{path}/text", (status.message, tuple(entries))):
            details = "; ".join(f"{key}: {value}" for key, value in entries if key != WAITING_KEY)
            text = f"[{status.name}]: {status.message}" + (f" ({details})" if details else "")
            level = status.level if isinstance(status.level, int) else status.level[0]
            canvas.recording.log(path, rr.TextLog(text, level="WARN" if level else "INFO"))


def _draw_state(
    canvas: Canvas, path: str, status: msg.DiagnosticStatus, entries: list[tuple[str, str]]
) -> None:
    # The counts are of the whole run: only new ones show its present state.
    counts = [entry for entry in entries if entry[0].startswith(REJECTED_KEY)]
    rejected = canvas.changed(f"{path}#rejected", counts) and bool(counts)
    waiting = status.message.startswith("waiting")
    state = "waiting" if waiting else "rejecting" if rejected else "active"
    if canvas.changed(f"{path}#states", True):
        configuration = rr.StateConfiguration(
            values=list(palette.STATES), colors=list(palette.STATES.values())
        )
        canvas.recording.log(path, configuration, static=True)
    reasons = tuple(key for key, _ in counts)
    if reasons and canvas.changed(f"{path}#reasons", reasons):
        canvas.event("fault", f"{status.name}: {'; '.join(reasons)}", "WARN")
    before = canvas.last.get(path)
    if not canvas.changed(path, state):
        return
    canvas.recording.log(path, rr.StateChange(state=state))
    # That services wait for each other is usual until each was active once.
    was_active = canvas.last.get(f"{path}#active") is not None
    canvas.last[f"{path}#active"] = was_active or not waiting or None
    if was_active and waiting:
        canvas.event("fault", f"{status.name}: {status.message}", "WARN")
    elif was_active and before == "waiting":
        canvas.event("fault", f"{status.name}: active again")


def _draw_figures(canvas: Canvas, status: msg.DiagnosticStatus) -> None:
    """The cost of a step, the rates of its topics, and its counts of what went wrong."""
    totals = dict.fromkeys((LOST_KEY, REJECTED_KEY), 0)
    for entry in status.values:
        for key in totals:
            if entry.key.startswith(key) and entry.value.isdecimal():
                totals[key] += int(entry.value)
        if entry.key in (STEP_TIME_KEY, MISSED_KEY):
            _number(canvas, entry.key, status.name, entry.value)
        elif entry.key.startswith(RATE_KEY):
            _number(canvas, "rate_hz", entry.key.removeprefix(RATE_KEY), entry.value)
    for key, total in totals.items():
        _number(canvas, key.strip(), status.name, str(total))


def _number(canvas: Canvas, figure: str, name: str, value: str) -> None:
    """One line of a plot: a figure of a service or a topic."""
    path = f"{FIGURES}/{figure}/{entity_part(name)}"
    try:
        number = float(value)
    except ValueError:
        return
    if canvas.changed(f"{path}#style", name):
        looks = rr.SeriesLines(names=[name], widths=[1.5], colors=[palette.of_name(name)])
        canvas.recording.log(path, looks, static=True)
    canvas.recording.scalar(path, number)

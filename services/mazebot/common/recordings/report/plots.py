"""Plots over time as inline SVG: what the template draws, in the pixels of its view box."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

WIDTH_PX, HEIGHT_PX = 480, 180
_LEFT_PX, _RIGHT_PX, _TOP_PX, _BOTTOM_PX = 46, 10, 10, 34
_GAP = 8
"""A line has a gap where so many times its usual period nothing was measured."""


class Line(NamedTuple):
    """A quantity over time."""

    name: str
    times_s: Sequence[float]
    values: Sequence[float]
    has_gaps: bool = True
    """Whether a long time without a value is shown as a gap."""


class Tick(NamedTuple):
    """A mark on an axis."""

    at_px: float
    text: str


class DrawnLine(NamedTuple):
    """A line as SVG's path data."""

    name: str
    path: str


class Plot(NamedTuple):
    """A plot, ready to be drawn."""

    key: str
    """Unique in its page."""
    title: str
    unit: str
    about: str
    """What it shows, in words, for those who do not see it."""
    lines: tuple[DrawnLine, ...]
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    marks_px: tuple[float, ...]
    """Vertical lines at events."""
    left_px: float = _LEFT_PX
    right_px: float = WIDTH_PX - _RIGHT_PX
    top_px: float = _TOP_PX
    bottom_px: float = HEIGHT_PX - _BOTTOM_PX
    width_px: float = WIDTH_PX
    height_px: float = HEIGHT_PX


def plot(
    key: str,
    title: str,
    unit: str,
    lines: Sequence[Line],
    end_s: float,
    marks_s: Sequence[float] = (),
    top: float | None = None,
) -> Plot | None:
    """Plot lines over simulation time from 0 to `end_s`; None if there is nothing to show. `top`
    is the upper end of the axis, if that is known; the lower one is 0, or the least value.
    """
    lines = [line for line in lines if line.values]
    if not lines:
        return None
    low = min(0.0, *(min(line.values) for line in lines))
    high = max(max(line.values) for line in lines) if top is None else top
    y_steps = ticks(low, high if high > low else low + 1.0, 4)
    low, high = min(low, y_steps[0]), max(high, y_steps[-1])
    end_s = max(end_s, *(line.times_s[-1] for line in lines), 1e-3)
    x_px = (WIDTH_PX - _RIGHT_PX - _LEFT_PX) / end_s
    y_px = (HEIGHT_PX - _BOTTOM_PX - _TOP_PX) / (high - low)

    def point(time_s: float, value: float) -> str:
        x, y = _LEFT_PX + time_s * x_px, HEIGHT_PX - _BOTTOM_PX - (value - low) * y_px
        return f"{x:.1f} {max(y, _TOP_PX):.1f}"

    return Plot(
        key=key,
        title=title,
        unit=unit,
        about=_about(title, unit, lines),
        lines=tuple(DrawnLine(line.name, _path(line, point)) for line in lines),
        x_ticks=tuple(Tick(round(_LEFT_PX + s * x_px, 1), _label(s)) for s in ticks(0.0, end_s, 6)),
        y_ticks=tuple(
            Tick(round(HEIGHT_PX - _BOTTOM_PX - (value - low) * y_px, 1), _label(value))
            for value in y_steps
        ),
        marks_px=tuple(round(_LEFT_PX + s * x_px, 1) for s in marks_s if 0.0 <= s <= end_s),
    )


def ticks(low: float, high: float, about: int) -> list[float]:
    """Round values from `low` to `high`, about so many."""
    rough = (high - low) / about
    unit = 10.0 ** math.floor(math.log10(rough))
    step = next(unit * times for times in (1, 2, 5, 10) if unit * times >= 0.75 * rough)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(number * step, 9) for number in range(first, last + 1)]


def _path(line: Line, point: object) -> str:
    assert callable(point)
    times_s = line.times_s
    usual_s = (times_s[-1] - times_s[0]) / max(len(times_s) - 1, 1)
    gap_s = _GAP * usual_s if line.has_gaps else 1e300
    parts = []
    before_s = -math.inf
    for time_s, value in zip(times_s, line.values, strict=True):
        parts.append(f"{'M' if time_s - before_s > gap_s else 'L'}{point(time_s, value)}")
        before_s = time_s
    # A single point shows as a dot.
    return "".join(parts) + ("h0.1" if len(parts) == 1 else "")


def _about(title: str, unit: str, lines: Sequence[Line]) -> str:
    ranges = (
        f"{line.name + ': ' if len(lines) > 1 else ''}"
        f"{_label(min(line.values))} to {_label(max(line.values))}{' ' + unit if unit else ''}"
        for line in lines
    )
    return f"{title} over simulation time; {'; '.join(ranges)}"


def _label(value: float) -> str:
    return f"{value:.4g}".replace("e+0", "e").replace("e-0", "e-")

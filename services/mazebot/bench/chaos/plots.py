"""A picture of a sequence of faults: how long until the robot drives again, each beside what is
promised.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from mazebot.bench.chaos.summary import Row
from mazebot.bench.chaos.trial import Trial

_LEFT_PX, _BAR_PX, _RIGHT_PX, _LINE_PX, _MARGIN_PX = 240, 520, 150, 26, 16
_WHITE, _INK, _GREY = (255, 255, 255), (40, 40, 40), (225, 225, 225)
_GOOD, _BAD, _PROMISE = (31, 119, 180), (214, 39, 40), (255, 140, 0)
_LEAST_S = 5.0


def write_plot(file: Path, rows: Sequence[Row], trials: Sequence[Trial]) -> None:
    """Draw every trial as a dot in its fault's row. Raises OSError."""
    font = ImageFont.load_default(14)
    longest_s = max([_LEAST_S, *(one.drives_s for one in trials if one.drives_s is not None)])
    width = _LEFT_PX + _BAR_PX + _RIGHT_PX
    picture = Image.new("RGB", (width, _LINE_PX * (len(rows) + 2) + 2 * _MARGIN_PX), _WHITE)
    draw = ImageDraw.Draw(picture)
    scale = _BAR_PX / longest_s
    for number, row in enumerate(rows):
        y = _MARGIN_PX + number * _LINE_PX
        draw.text((_MARGIN_PX, y + 4), row.fault, fill=_INK, font=font)
        draw.rectangle((_LEFT_PX, y + 11, _LEFT_PX + _BAR_PX, y + 13), fill=_GREY)
        if row.promised_s is not None:
            x = _LEFT_PX + row.promised_s * scale
            draw.line((x, y + 3, x, y + _LINE_PX - 5), fill=_PROMISE, width=2)
        for trial in trials:
            if trial.fault != row.fault:
                continue
            x = _LEFT_PX + (longest_s if trial.drives_s is None else trial.drives_s) * scale
            ink = _GOOD if trial.recovered else _BAD
            draw.ellipse((x - 4, y + 8, x + 4, y + 16), fill=ink)
        text = f"{row.recovered} of {row.times}"
        draw.text((_LEFT_PX + _BAR_PX + 12, y + 4), text, fill=_INK, font=font)
    y = _MARGIN_PX + len(rows) * _LINE_PX
    for at_s in range(0, int(longest_s) + 1, max(1, int(longest_s) // 6)):
        draw.text((_LEFT_PX + at_s * scale - 6, y), f"{at_s} s", fill=_INK, font=font)
    legend = "until the robot can be sent about again; orange: promised for the service"
    draw.text((_LEFT_PX, y + _LINE_PX), legend, fill=_INK, font=font)
    picture.save(file)

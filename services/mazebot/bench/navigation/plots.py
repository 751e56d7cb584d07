"""Pictures of a run of the benchmark: the ways driven, and the share of successes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from mazebot.bench.navigation.report import Summary
from mazebot.bench.navigation.scenario import Row
from mazebot.common.maths.frames import Array

_PANEL_PX, _MARGIN_PX, _TITLE_PX = 420, 14, 34
_MOST_PANELS = 6
_WHITE, _GREY, _INK = (255, 255, 255), (150, 150, 150), (40, 40, 40)
_GOOD, _BAD, _SKIPPED = (31, 119, 180), (214, 39, 40), (210, 210, 210)
_TOUCH = (255, 140, 0)
_LINE_PX = 26

Ink = tuple[int, int, int]


def write_plots(
    folder: Path, rows: Mapping[str, Sequence[Row]], summaries: Mapping[str, Summary]
) -> list[Path]:
    """Draw everything into a folder; the files. Raises OSError where they cannot be written."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / "overview.png"]
    overview(summaries).save(files[0])
    for name, found in rows.items():
        picture = ways(name, found)
        if picture is not None:
            files.append(folder / f"ways_{name}.png")
            picture.save(files[-1])
    return files


def ways(name: str, rows: Sequence[Row]) -> Image.Image | None:
    """The true ways of a scenario's first few runs over the plans of their worlds: blue where the
    trial succeeded, red where not, orange where the robot touched something. None without ways.
    """
    runs: dict[tuple[str, int], list[Row]] = {}
    for row in rows:
        if len(row.way):
            runs.setdefault((row.world, row.seed), []).append(row)
    if not runs:
        return None
    panels = [_panel(name, run) for run in list(runs.values())[:_MOST_PANELS]]
    columns = min(len(panels), 3)
    height = -(-len(panels) // columns)
    sheet = Image.new("RGB", (columns * _PANEL_PX, height * (_PANEL_PX + _TITLE_PX)), _WHITE)
    for number, panel in enumerate(panels):
        x, y = number % columns * _PANEL_PX, number // columns * (_PANEL_PX + _TITLE_PX)
        sheet.paste(panel, (x, y))
    return sheet


def _panel(name: str, run: Sequence[Row]) -> Image.Image:
    panel = Image.new("RGB", (_PANEL_PX, _PANEL_PX + _TITLE_PX), _WHITE)
    draw = ImageDraw.Draw(panel)
    scene = next((row.scene for row in run if row.scene), ())
    points = np.concatenate([*scene, *(row.way for row in run)])
    low, high = points.min(0) - 0.2, points.max(0) + 0.2
    scale = (_PANEL_PX - 2 * _MARGIN_PX) / float((high - low).max())

    def pixels(places: Array) -> list[tuple[float, float]]:
        x = _MARGIN_PX + (places[:, 0] - low[0]) * scale
        y = _TITLE_PX + _MARGIN_PX + (high[1] - places[:, 1]) * scale
        return list(zip(x.tolist(), y.tolist(), strict=True))

    for outline in scene:
        if len(outline) > 2:
            draw.polygon(pixels(outline), fill=_GREY)
    for row in run:
        places = pixels(row.way)
        ink = _GOOD if row.success else _BAD
        if len(places) > 1:
            draw.line(places, fill=ink, width=2)
        _dot(draw, places[0], 4, ink)
        _dot(draw, places[-1], 3, _INK)
        for x, y in pixels(row.touches) if len(row.touches) else []:
            _dot(draw, (x, y), 5, _TOUCH)
    good = sum(row.success for row in run)
    title = f"{name}, seed {run[0].seed}: {good} of {len(run)}"
    draw.text((_MARGIN_PX, 8), title, fill=_INK, font=ImageFont.load_default(15))
    return panel


def _dot(draw: ImageDraw.ImageDraw, place: tuple[float, float], radius: int, ink: Ink) -> None:
    x, y = place
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=ink)


def overview(summaries: Mapping[str, Summary]) -> Image.Image:
    """The share of successful trials of every scenario as a bar."""
    font = ImageFont.load_default(14)
    left, bar, right = 200, 400, 260
    height = _LINE_PX * (len(summaries) + 1) + 2 * _MARGIN_PX
    picture = Image.new("RGB", (left + bar + right, height), _WHITE)
    draw = ImageDraw.Draw(picture)
    for number, (name, found) in enumerate(summaries.items()):
        y = _MARGIN_PX + number * _LINE_PX
        draw.text((_MARGIN_PX, y + 4), name, fill=_INK, font=font)
        trials = found.get("trials", 0)
        draw.rectangle((left, y + 4, left + bar, y + _LINE_PX - 4), fill=_SKIPPED)
        text = str(found.get("skipped", ""))
        if trials:
            share = found["successes"] / trials
            if share > 0.0:
                right_px = left + round(bar * share)
                draw.rectangle((left, y + 4, right_px, y + _LINE_PX - 4), fill=_GOOD)
            text = f"{found['successes']} of {trials}, {found['contacts_robot']} contacts"
        draw.text((left + bar + 8, y + 4), text[:36], fill=_INK, font=font)
    y = _MARGIN_PX + len(summaries) * _LINE_PX + 4
    draw.text((left, y), "share of trials that succeeded", fill=_INK, font=font)
    return picture

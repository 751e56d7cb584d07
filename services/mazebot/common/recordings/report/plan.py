"""The plan of a run: its world from above, with what happened in it, as SVG's numbers."""

from __future__ import annotations

import base64
import io
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from PIL import Image

from mazebot.common.config import ConfigError
from mazebot.common.recordings.series import RunSeries, SeriesGoal
from mazebot.common.world.costmap import FREE, OCCUPIED
from mazebot.common.world.map_files import read_map

_WIDTH_PX = 640.0
_MARGIN_M = 0.35
_MARKER_M = 0.15
_STRIDE_PX = 1.0
"""Points of a path nearer to each other than this are left out."""


class Extent(NamedTuple):
    """A rectangle in the map, m."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float


class Spot(NamedTuple):
    """A place on the plan, in pixels of its view box."""

    x: float
    y: float
    name: str = ""
    kind: str = ""


class PlanMarker(NamedTuple):
    """A marker: a line along its face, and a place for its number."""

    x1: float
    y1: float
    x2: float
    y2: float
    text_x: float
    text_y: float
    name: str
    images: int


class MadeMap(NamedTuple):
    """The map that the robot has made, as a picture."""

    uri: str
    transform: str
    """From the picture's pixels to the plan's."""
    width: int
    height: int


class Plan(NamedTuple):
    """A plan, ready to be drawn."""

    width: float
    height: float
    solid: str
    true_path: str
    estimated_path: str
    start: Spot
    locations: tuple[Spot, ...]
    goals: tuple[Spot, ...]
    markers: tuple[PlanMarker, ...]
    contacts: tuple[Spot, ...]
    metre_px: float
    made_map: MadeMap | None
    about: str


def goal_kind(goal: SeriesGoal) -> Literal["reached", "canceled", "missed"]:
    """What became of a goal."""
    return "reached" if goal.reached else "canceled" if goal.canceled else "missed"


def extent_of(series: RunSeries) -> Extent:
    """The rectangle that a plan shows: the world's walls, and wherever the robot was."""
    points = [point for ring in series.solid for point in ring]
    points += zip(series.truth.x_m, series.truth.y_m, strict=True)
    points += [(series.start.x_m, series.start.y_m)]
    if not series.solid:
        points += [(goal.pose.x_m, goal.pose.y_m) for goal in series.goals if goal.pose]
    corners = np.array(points)
    low, high = corners.min(axis=0) - _MARGIN_M, corners.max(axis=0) + _MARGIN_M
    return Extent(float(low[0]), float(low[1]), float(high[0]), float(high[1]))


def plan_of(series: RunSeries, made_map: Path | None = None) -> Plan:
    """The plan of a run; `made_map` is the YAML file of the map that the robot has made."""
    extent = extent_of(series)
    wide_m, high_m = extent.x_max_m - extent.x_min_m, extent.y_max_m - extent.y_min_m
    scale = _WIDTH_PX / max(wide_m, high_m)

    def x(x_m: float) -> float:
        return round((x_m - extent.x_min_m) * scale, 1)

    def y(y_m: float) -> float:
        return round((extent.y_max_m - y_m) * scale, 1)

    def path(xs_m: Sequence[float], ys_m: Sequence[float]) -> str:
        points = zip(map(x, xs_m), map(y, ys_m), strict=True)
        return "M" + "L".join(f"{a} {b}" for a, b in _apart(points)) if xs_m else ""

    solid = "".join(
        "M" + "L".join(f"{x(a)} {y(b)}" for a, b in ring) + "Z" for ring in series.solid
    )
    return Plan(
        width=round(wide_m * scale, 1),
        height=round(high_m * scale, 1),
        solid=solid,
        true_path=path(series.truth.x_m, series.truth.y_m),
        estimated_path=path(series.estimate.x_m, series.estimate.y_m),
        start=Spot(x(series.start.x_m), y(series.start.y_m)),
        locations=tuple(Spot(x(one.x_m), y(one.y_m), one.name) for one in series.locations),
        goals=tuple(
            Spot(x(goal.pose.x_m), y(goal.pose.y_m), goal.name, goal_kind(goal))
            for goal in series.goals
            if goal.pose is not None
        ),
        markers=tuple(
            _marker(x, y, one.x_m, one.y_m, one.yaw_rad, str(one.marker_id), one.images)
            for one in series.markers
        ),
        contacts=tuple(
            Spot(x(event.x_m), y(event.y_m), event.text)
            for event in series.events
            if event.kind == "contact" and event.x_m is not None and event.y_m is not None
        ),
        metre_px=round(scale, 2),
        made_map=None if made_map is None else _made_map(made_map, extent, scale),
        about=_about(series, wide_m, high_m),
    )


def _apart(points: Iterable[tuple[float, float]]) -> Iterable[tuple[float, float]]:
    last = (math.inf, math.inf)
    waiting = None
    for point in points:
        waiting = point
        if math.dist(last, point) >= _STRIDE_PX:
            yield point
            last, waiting = point, None
    if waiting is not None:
        yield waiting


def _marker(
    x: object, y: object, x_m: float, y_m: float, yaw_rad: float, name: str, images: int
) -> PlanMarker:
    assert callable(x)
    assert callable(y)
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return PlanMarker(
        *(x(x_m - s * _MARKER_M), y(y_m + c * _MARKER_M)),
        *(x(x_m + s * _MARKER_M), y(y_m - c * _MARKER_M)),
        *(x(x_m + c * 0.3), y(y_m + s * 0.3)),
        name=name,
        images=images,
    )


def _made_map(path: Path, extent: Extent, scale: float) -> MadeMap | None:
    """None if there is no such map, or it cannot be read."""
    if not path.is_file():
        return None
    try:
        made = read_map(path)
    except (ConfigError, OSError):
        return None
    cells = made.cells[::-1]
    pixels = np.zeros((*cells.shape, 2), np.uint8)
    pixels[cells == FREE] = (255, 200)
    pixels[cells >= OCCUPIED] = (0, 255)
    file = io.BytesIO()
    Image.fromarray(pixels, "LA").save(file, "PNG", optimize=True)
    size = made.resolution_m * scale
    height_m = cells.shape[0] * made.resolution_m
    c, s = math.cos(made.origin.yaw_rad), math.sin(made.origin.yaw_rad)
    corner_x = (made.origin.x_m - s * height_m - extent.x_min_m) * scale
    corner_y = (extent.y_max_m - made.origin.y_m - c * height_m) * scale
    matrix = (size * c, -size * s, size * s, size * c, corner_x, corner_y)
    return MadeMap(
        uri=f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}",
        transform=f"matrix({' '.join(f'{value:.4f}' for value in matrix)})",
        width=cells.shape[1],
        height=cells.shape[0],
    )


def _about(series: RunSeries, wide_m: float, high_m: float) -> str:
    kinds = Counter(map(goal_kind, series.goals))
    contacts = sum(event.kind == "contact" for event in series.events)
    return (
        f"{series.world} from above, {wide_m:.1f} m by {high_m:.1f} m, with the robot's true and "
        f"estimated path, {kinds['reached']} goals reached, {kinds['missed']} not reached, "
        f"{len(series.markers)} markers and {contacts} contacts"
    )

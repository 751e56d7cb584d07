"""How far a map deviates from another one of the same place."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.ndimage import distance_transform_edt, map_coordinates

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.documents import Document, Finite
from mazebot.common.world.map_files import MapFile

_CLOSE_M = 0.05
_MAX_OFFSET_M = 2.0
_FAR_M = 0.5
"""Distances are capped here: a wall that only one map has does not affect the offset."""


class MapDisagreement(Document):
    """How far a map deviates from the walls of the world that it is used in. Distances are from an
    occupied cell of one to the nearest occupied cell of the other, in both directions.
    """

    mean_m: Finite
    p95_m: Finite
    max_m: Finite
    share_within_5_cm: Finite
    offset_x_m: Finite = Field(description="to add to the map's origin for the best agreement")
    offset_y_m: Finite
    mean_after_offset_m: Finite
    share_contradicted: Finite = Field(
        description="of the cells known in both: free in one, occupied in the other"
    )

    def __str__(self) -> str:
        """One line of text."""
        line = (
            f"walls of map and world are {100 * self.mean_m:.1f} cm apart on average, "
            f"{100 * self.p95_m:.0f} cm at the 95th percentile, {100 * self.max_m:.0f} cm at most; "
            f"{100 * self.share_within_5_cm:.0f} % within 5 cm; "
            f"{100 * self.share_contradicted:.1f} % of the cells contradict each other"
        )
        if self.mean_after_offset_m < 0.5 * self.mean_m:
            line += (
                f"; shifted by ({self.offset_x_m:+.3f}, {self.offset_y_m:+.3f}) m the map would "
                f"be {100 * self.mean_after_offset_m:.1f} cm off"
            )
        return line


def disagreement(ready: MapFile, own: MapFile) -> MapDisagreement:
    """Deviation of a ready map from one made of the world's own walls.

    Raises ValueError with a phrase if one of them has no occupied cell.
    """
    points = _occupied_points(ready)
    own_points = _occupied_points(own)
    for whose, found in (("the map", points), ("the world", own_points)):
        if not len(found):
            raise ValueError(f"{whose} has no occupied cell")
    far = np.concatenate([_distances(points, own), _distances(own_points, ready)])
    offset = _best_offset(points, own)
    moved = MapFile(
        ready.cells,
        ready.resolution_m,
        SE2(float(offset[0]), float(offset[1]), 0.0) @ ready.origin,
    )
    after = np.concatenate([_distances(points + offset, own), _distances(own_points, moved)])
    return MapDisagreement(
        mean_m=round(float(far.mean()), 6),
        p95_m=round(float(np.percentile(far, 95.0)), 6),
        max_m=round(float(far.max()), 6),
        share_within_5_cm=round(float((far <= _CLOSE_M).mean()), 6),
        offset_x_m=round(float(offset[0]), 6),
        offset_y_m=round(float(offset[1]), 6),
        mean_after_offset_m=round(float(after.mean()), 6),
        share_contradicted=round(_contradicted(ready, own), 6),
    )


def _occupied_points(chart: MapFile) -> Array:
    """(n, 2) centres of the occupied cells, in the map."""
    rows, columns = np.nonzero(chart.cells > 50)
    points = np.stack([columns + 0.5, rows + 0.5], axis=-1) * chart.resolution_m
    return _turned(points, chart.origin.yaw_rad) + chart.origin[:2]


def _turned(points: Array, yaw_rad: float) -> Array:
    c, s = portable.cos_sin(yaw_rad)
    return np.asarray(portable.product(points, np.array([[c, s], [-s, c]])))


def _in_own(points: Array, chart: MapFile) -> Array:
    """The points from the corner of cell (0, 0), along the chart's axes."""
    return _turned(points - np.array(chart.origin[:2]), -chart.origin.yaw_rad)


def _in_cells(points: Array, chart: MapFile) -> NDArray[np.int64]:
    """(n, 2) of column and row; they may be outside."""
    return np.floor(_in_own(points, chart) / chart.resolution_m + 1e-9).astype(np.int64)


def _field(chart: MapFile, margin_m: float) -> tuple[NDArray[np.float32], int]:
    """Distance to the nearest occupied cell, and by how many cells it extends beyond the map."""
    margin = math.ceil(margin_m / chart.resolution_m)
    # A map of many cells must not get many more around it.
    margin = min(margin, max(chart.cells.shape))
    walls = np.pad(chart.cells > 50, margin)
    return (distance_transform_edt(~walls) * chart.resolution_m).astype(np.float32), margin


def _look_up(points: Array, chart: MapFile, field: NDArray[np.float32], margin: int) -> Array:
    """For points beyond the field, the value of its nearest cell plus the distance to it."""
    cells = _in_cells(points, chart) + margin
    near = cells.clip(0, np.array(field.shape[::-1]) - 1)
    beyond = portable.hypot_each(*(cells - near).T) * chart.resolution_m
    return np.asarray(field[near[:, 1], near[:, 0]] + beyond)


def _distances(points: Array, chart: MapFile) -> Array:
    return _look_up(points, chart, *_field(chart, _MAX_OFFSET_M))


def _best_offset(points: Array, own: MapFile) -> Array:
    """The translation of the points with the least mean distance to the own walls, to about a
    tenth of a cell.
    """
    field, margin = _field(own, 2.0 * _MAX_OFFSET_M)
    # As many points as are needed.
    few = points[:: max(1, len(points) // 500)]

    def cost(offset: Array, among: Array) -> float:
        # Interpolated between cell centres, or all offsets within a cell would be equally good.
        at = _in_own(among + offset, own) / own.resolution_m + (margin - 0.5)
        far = map_coordinates(field, at.T[::-1], order=1, mode="nearest", prefilter=False)
        return float(np.minimum(far, _FAR_M).mean())

    best, step = np.zeros(2), 0.1
    reach = round(_MAX_OFFSET_M / step)
    steps = np.arange(-reach, reach + 1) * step
    tried = [np.array((x, y)) for x in steps for y in steps]
    # Of equal ones the shortest.
    tried.sort(key=lambda offset: (round(float(portable.hypot_each(*offset)), 9), *offset.tolist()))
    best = min(tried, key=lambda offset: cost(offset, few))
    while step > 0.1 * own.resolution_m:
        step /= 2.0
        around = [best + step * np.array((i, j)) for i in (0, -1, 1) for j in (0, -1, 1)]
        best = min(around, key=lambda offset: cost(offset, few))
    # Without an improvement there is no offset.
    return best if cost(best, points) < cost(np.zeros(2), points) else np.zeros(2)


def _contradicted(ready: MapFile, own: MapFile) -> float:
    rows, columns = np.nonzero(ready.cells >= 0)
    points = np.stack([columns + 0.5, rows + 0.5], axis=-1) * ready.resolution_m
    at = _in_cells(_turned(points, ready.origin.yaw_rad) + ready.origin[:2], own)
    there = ((at >= 0) & (at < own.cells.shape[::-1])).all(1)
    one, other = ready.cells[rows, columns][there], own.cells[at[there, 1], at[there, 0]]
    known = other >= 0
    differs = known & ((one > 50) != (other > 50))
    return float(differs.sum() / max(1, known.sum()))

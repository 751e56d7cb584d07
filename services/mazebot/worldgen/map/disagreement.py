"""How far a map deviates from another one of the same place.

Walls are compared by their faces, the occupied cells beside free floor: what is deep inside
something solid is in no map that a lidar has made.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import binary_dilation, distance_transform_edt, map_coordinates

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.documents import Document, Finite, World
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.map_files import MapFile
from mazebot.worldgen.map.occupancy import floor_map

MAX_MAP_ERROR_M = 0.1
"""A map whose walls are further off does not fit its world: SLAM's are 2 to 5 cm off."""
_CLOSE_M = 0.05
_FAR_M = 0.5
"""Distances are capped here: a wall that only one map has does not affect the offset."""
_MARGIN_M = 2.0
_COARSE_M = 0.1
_MOST_COARSE_CELLS = 1024
"""Of a side of the grid on which every offset is tried."""
_REFINED = 8
"""So many of the best coarse offsets are refined."""


class MapDisagreement(Document):
    """How far a map deviates from the walls of the world that it is used in. Distances are from a
    face of one, an occupied cell beside free floor, to the nearest face of the other, in both
    directions; faces beside floor that the map does not know are left out.
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

    @property
    def explains(self) -> bool:
        """Whether the map is shifted, rather than another one."""
        return self.mean_after_offset_m < 0.5 * self.mean_m

    def __str__(self) -> str:
        """One line of text."""
        line = (
            f"walls of map and world are {100 * self.mean_m:.1f} cm apart on average, "
            f"{100 * self.p95_m:.0f} cm at the 95th percentile, {100 * self.max_m:.0f} cm at most; "
            f"{100 * self.share_within_5_cm:.0f} % within 5 cm; "
            f"{100 * self.share_contradicted:.1f} % of the cells contradict each other"
        )
        if self.explains:
            line += (
                f"; shifted by ({self.offset_x_m:+.3f}, {self.offset_y_m:+.3f}) m the map would "
                f"be {100 * self.mean_after_offset_m:.1f} cm off"
            )
        return line


def misfit_in(ready: MapFile, world: World, meshes: Mapping[str, TriangleMesh]) -> str:
    """The same as `misfit` with the map that is made of a world; `meshes` are by sha256."""
    grid, cells = floor_map(world, meshes)
    return misfit(ready, MapFile(cells, grid.resolution_m, grid.origin))


def misfit(ready: MapFile, own: MapFile) -> str:
    """How a ready map deviates from the world's own walls, in one line; empty: it fits."""
    try:
        found = disagreement(ready, own)
    except ValueError as error:
        return str(error)
    shifted_m = portable.hypot_each(found.offset_x_m, found.offset_y_m)
    # Walls along the shift are not off: the mean alone would not tell it.
    shifted = shifted_m > MAX_MAP_ERROR_M and found.explains
    return str(found) if shifted or found.mean_m > MAX_MAP_ERROR_M else ""


def disagreement(ready: MapFile, own: MapFile) -> MapDisagreement:
    """Deviation of a ready map from one made of the world's own walls.

    Raises ValueError with a phrase if one of them has no occupied cell beside free floor.
    """
    faces, own_faces = _faces(ready), _faces(own)
    for whose, found in (("the map", faces), ("the world", own_faces)):
        if not found.any():
            raise ValueError(f"{whose} has no occupied cell beside free floor")
    field, own_field = _Field(faces, ready.resolution_m), _Field(own_faces, own.resolution_m)

    def distances(chart: MapFile) -> Array:
        seen = _centres(_seen(own_faces, own, chart), own)
        of_map = own_field.distances(_in_own(_centres(faces, chart), own))
        return np.concatenate([of_map, field.distances(_in_own(seen, chart))])

    far = distances(ready)
    offset = _best_offset(_centres(faces, ready), own, own_field)
    after = distances(
        replace(ready, origin=SE2(float(offset[0]), float(offset[1]), 0.0) @ ready.origin)
    )
    return MapDisagreement(
        mean_m=round(float(far.mean()), 6),
        p95_m=round(float(np.percentile(far, 95.0)), 6),
        max_m=round(float(far.max()), 6),
        share_within_5_cm=round(float((far <= _CLOSE_M).mean()), 6),
        offset_x_m=round(float(offset[0]), 6) + 0.0,
        offset_y_m=round(float(offset[1]), 6) + 0.0,
        mean_after_offset_m=round(float(after.mean()), 6),
        share_contradicted=round(_contradicted(ready, own), 6),
    )


class _Field:
    """The distance to the nearest face of a map, on and around its grid."""

    def __init__(self, faces: NDArray[np.bool_], resolution_m: float) -> None:
        self.resolution_m = resolution_m
        # A map of many cells must not get many more around it.
        self._margin = min(math.ceil(_MARGIN_M / resolution_m), max(faces.shape))
        around = np.pad(faces, self._margin)
        self._far_m = (distance_transform_edt(~around) * resolution_m).astype(np.float32)

    @property
    def size_m(self) -> Array:
        """Width and height of the map itself."""
        columns, rows = self._far_m.shape[::-1]
        return np.array([columns, rows], np.float64) * self.resolution_m - 2 * self.margin_m

    @property
    def margin_m(self) -> float:
        """How far it extends around the map."""
        return float(self._margin * self.resolution_m)

    def distances(self, points_m: Array) -> Array:
        """Of (n, 2) points from the map's corner; beyond the field, the value of its nearest cell
        plus the distance to that.
        """
        cells = np.floor(points_m / self.resolution_m + 1e-9).astype(np.int64) + self._margin
        near = cells.clip(0, np.array(self._far_m.shape[::-1]) - 1)
        beyond = portable.hypot_each(*(cells - near).T) * self.resolution_m
        return np.asarray(self._far_m[near[:, 1], near[:, 0]] + beyond)

    def cost(self, points_m: Array) -> float:
        """The mean distance, capped, interpolated between the centres of cells: without that all
        offsets within a cell would be equally good.
        """
        at = points_m / self.resolution_m + (self._margin - 0.5)
        far = map_coordinates(self._far_m, at.T[::-1], order=1, mode="nearest", prefilter=False)
        return float(np.minimum(far, _FAR_M).mean())


def _beside(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(binary_dilation(cells, np.ones((3, 3), np.bool_)))


def _faces(chart: MapFile) -> NDArray[np.bool_]:
    """The occupied cells beside free floor."""
    return (chart.cells > 50) & _beside((chart.cells >= 0) & (chart.cells <= 50))


def _seen(faces: NDArray[np.bool_], own: MapFile, chart: MapFile) -> NDArray[np.bool_]:
    """The own faces beside floor that another map knows."""
    floor = _beside(faces) & (own.cells >= 0) & (own.cells <= 50)
    cells = _in_cells(_centres(floor, own), chart)
    within = ((cells >= 0) & (cells < chart.cells.shape[::-1])).all(1)
    known = np.zeros(len(cells), np.bool_)
    known[within] = chart.cells[cells[within, 1], cells[within, 0]] >= 0
    floor[floor] = known
    return faces & _beside(floor)


def _centres(mask: NDArray[np.bool_], chart: MapFile) -> Array:
    """(n, 2) centres of cells, in the world."""
    rows, columns = np.nonzero(mask)
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


def _best_offset(points: Array, own: MapFile, field: _Field) -> Array:
    """The translation of the points with the least mean distance to the own faces, to about a
    tenth of a cell, however long it is.
    """
    at = _in_own(points, own)
    # As many points as are needed.
    few = at[:: max(1, len(at) // 500)]
    found, step_m = _coarse_offsets(at, field)

    def refined(offset: Array) -> Array:
        step = step_m
        while step > 0.1 * own.resolution_m:
            step /= 2.0
            around = [offset + step * np.array((i, j)) for i in (0, -1, 1) for j in (0, -1, 1)]
            offset = min(around, key=lambda one: field.cost(few + one))
        return offset

    # Of equally good ones the shortest.
    best = min(
        map(refined, found),
        key=lambda offset: (
            round(field.cost(at + offset), 4),
            round(float(portable.hypot_each(*offset)), 6),
        ),
    )
    # Without an improvement there is no offset.
    if field.cost(at + best) >= field.cost(at):
        return np.zeros(2)
    return np.asarray(_turned(best[None], own.origin.yaw_rad)[0])


def _coarse_offsets(at: Array, field: _Field) -> tuple[list[Array], float]:
    """The best offsets of all, (0, 0) among them, and how far they are rounded, m.

    How near all points are to a face after each offset is one correlation.
    """
    spans = [field.size_m + 2 * _FAR_M, at.max(0) - at.min(0)]
    step_m = max(_COARSE_M, float(np.max(spans)) / _MOST_COARSE_CELLS)
    low = at.min(0)
    columns, rows = np.ceil(spans[0] / step_m).astype(int)
    y, x = np.mgrid[:rows, :columns]
    centres = (np.stack([x.ravel(), y.ravel()], axis=-1) + 0.5) * step_m - _FAR_M
    near = 1.0 - np.minimum(field.distances(centres), _FAR_M).reshape(rows, columns) / _FAR_M
    cells = np.floor((at - low) / step_m).astype(int)
    many = np.zeros(tuple(cells.max(0)[::-1] + 1))
    np.add.at(many, (cells[:, 1], cells[:, 0]), 1.0)
    shape = [next_fast_len(one + other, real=True)
             for one, other in zip(near.shape, many.shape, strict=True)]  # fmt: skip
    score = irfft2(rfft2(near, shape) * np.conj(rfft2(many, shape)), shape)
    found = [np.zeros(2)]
    apart = math.ceil(_FAR_M / step_m)
    for _ in range(_REFINED):
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        shift = np.array([column, row])
        shift = np.where(shift >= near.shape[::-1], shift - shape[::-1], shift)
        found.append(shift * step_m - _FAR_M - low)
        rows_around = np.arange(row - apart, row + apart + 1) % score.shape[0]
        columns_around = np.arange(column - apart, column + apart + 1) % score.shape[1]
        score[np.ix_(rows_around, columns_around)] = -np.inf
    return found, step_m


def _contradicted(ready: MapFile, own: MapFile) -> float:
    rows, columns = np.nonzero(ready.cells >= 0)
    points = np.stack([columns + 0.5, rows + 0.5], axis=-1) * ready.resolution_m
    at = _in_cells(_turned(points, ready.origin.yaw_rad) + ready.origin[:2], own)
    there = ((at >= 0) & (at < own.cells.shape[::-1])).all(1)
    one, other = ready.cells[rows, columns][there], own.cells[at[there, 1], at[there, 0]]
    known = other >= 0
    differs = known & ((one > 50) != (other > 50))
    return float(differs.sum() / max(1, known.sum()))

"""What a perfect map of a world holds: the faces that the lidar can see from where the robot can
drive, and the floor there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.documents import Thing, World
from mazebot.common.world.costmap import (
    INSCRIBED_RADIUS_M,
    ROBOT_RADIUS_M,
    START_TOLERANCE_M,
    Cells,
    Mask,
    clearance_m,
    inscribed,
    nearest_cell,
    reachable_from,
    roomy,
)
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.obstruction import obstructions, wall_polygons
from mazebot.recorder.judging.map.visible import EVERY_M, visible_faces
from mazebot.recorder.judging.obstacles import obstacles

SPACING_M = 0.05
"""Between the points on walls that are looked for."""
NEAR_M = 0.10
"""A wall is found by an occupied cell with its centre this near, and such a cell is true."""
SCAN_HEIGHT_M, SCAN_RANGE_M = 0.132, 3.5
"""Of a TurtleBot3 waffle's lidar."""

_OCCUPIED, _FREE = 65, 19
"""From, and up to, which value a cell is occupied or free: Nav2's thresholds, in percent."""
_SLAB_M = 1e-3
"""Half of the height of the slice of bodies that the lidar sees."""
_RASTER_M = 0.025
_MOST_CELLS = 8_000_000
"""The raster is coarser in a world that needs more of them."""
_MARGIN_M = 1.0
_SHIFT = 8
"""Bits of a fraction of a cell in OpenCV's coordinates."""
_ALIGNED = 1e-3
"""In cells: lattices of maps farther apart are different ones."""


@dataclass(frozen=True, eq=False)
class TrueMap:
    """The truth about one world, as the robot can see it."""

    solids: shapely.Geometry
    """Everything solid and static on the lidar's level."""
    faces_m: Array
    """(n, 2, 2): segments, from and to, of its outline that can be seen; at most SPACING_M long."""
    reachable: Mask
    """(rows, columns): floor where the robot's centre can be, also behind gaps that its outline
    fits through, on a raster of its own"""
    raster_m: float
    raster_origin_m: tuple[float, float]
    """of cells of this side, from this corner."""
    is_open: bool
    """Whether the robot could drive away without end: there is no share of such a floor."""

    def reachable_at(self, points_m: Array) -> Mask:
        """(n,): whether points (n, 2) lie on floor that the robot's centre can reach."""
        cells = np.floor((points_m - self.raster_origin_m) / self.raster_m).astype(np.int64)
        rows, columns = self.reachable.shape
        column, row = cells.T
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        found = self.reachable[row.clip(0, rows - 1), column.clip(0, columns - 1)]
        return np.asarray(inside & found)


def true_map(
    world: World,
    meshes: Mapping[str, TriangleMesh],
    spawned: tuple[Thing, ...] = (),
    scan_height_m: float = SCAN_HEIGHT_M,
    scan_range_m: float = SCAN_RANGE_M,
) -> TrueMap:
    """The truth about a world with static things `spawned` in it; moving ones do not count.

    `meshes` are by sha256; a body whose mesh is missing is left out.
    """
    polygons = solid_at(world, meshes, spawned, scan_height_m)
    solids = shapely.union_all(polygons)
    around = obstacles(world, meshes, spawned)
    start = world.start.se2()
    extent = shapely.total_bounds(np.append(np.append(polygons, around), shapely.Point(start[:2])))
    low, high = extent[:2] - _MARGIN_M, extent[2:] + _MARGIN_M
    raster_m = max(_RASTER_M, math.sqrt(float(np.prod(high - low)) / _MOST_CELLS))
    columns, rows = np.ceil((high - low) / raster_m).astype(int)
    shape = int(rows), int(columns)
    blocked = _painted(around, shape, low, raster_m)
    column, row = ((np.array(start[:2]) - low) / raster_m).astype(int)
    clearance = clearance_m(blocked, raster_m)
    fits = ~inscribed(clearance, INSCRIBED_RADIUS_M)
    reachable = reachable_from(fits, int(row), int(column), START_TOLERANCE_M / raster_m)
    reachable &= roomy(clearance, ~blocked, raster_m, ROBOT_RADIUS_M, INSCRIBED_RADIUS_M)
    edge = np.concatenate([reachable[0], reachable[-1], reachable[:, 0], reachable[:, -1]])
    standing = reachable.copy()
    at_start = nearest_cell(~blocked, int(row), int(column))
    if at_start is not None:
        standing[at_start] = True
    faces, normals = _outline(solids)
    seen = visible_faces(
        _painted(polygons, shape, low, raster_m),
        standing,
        (faces.mean(axis=1) - low) / raster_m,
        normals,
        scan_range_m / raster_m,
        max(1, round(EVERY_M / raster_m)),
    )
    return TrueMap(
        solids=solids,
        faces_m=faces[seen],
        reachable=reachable,
        raster_m=raster_m,
        raster_origin_m=(float(low[0]), float(low[1])),
        is_open=bool(edge.any()),
    )


def solid_at(
    world: World,
    meshes: Mapping[str, TriangleMesh],
    spawned: tuple[Thing, ...],
    height_m: float,
) -> NDArray[np.object_]:
    """(n,) of shapely.Polygon: the cuts of walls and static bodies at a height."""
    walls = tuple(wall for wall in world.walls if wall.height_m > height_m)
    still = tuple(body for body in (*world.bodies, *spawned) if not body.moves)
    cut = [
        one.between(height_m - _SLAB_M, height_m + _SLAB_M).polygons
        for one in obstructions(world.model_copy(update={"bodies": still}), meshes)
        if one.solid
    ]
    return np.concatenate([wall_polygons(walls), *cut])


class Lattice:
    """A true map in the cells of one map, and of all maps that it grows or shrinks to: those whose
    origins are whole cells away.
    """

    def __init__(self, truth: TrueMap, resolution_m: float, origin: SE2) -> None:
        """`origin` is map_from_grid of one map, whose rows lie along x."""
        self._resolution_m = resolution_m
        self._corner_m = np.array(origin[:2])
        low, high = self._bounds(truth)
        self._first = low
        columns, rows = high - low
        self._shape = int(rows), int(columns)
        x, y = np.meshgrid(*(np.arange(a, b) + 0.5 for a, b in zip(low, high, strict=True)))
        centres = self._corner_m + resolution_m * np.stack([x.ravel(), y.ravel()], axis=1)
        points = shapely.points(centres)
        shapely.prepare(truth.solids)
        self._near = shapely.dwithin(truth.solids, points, NEAR_M).reshape(self._shape)
        deep = shapely.buffer(truth.solids, -resolution_m / 2.0)
        shapely.prepare(deep)
        self._deep = shapely.contains(deep, points).reshape(self._shape)
        reachable = truth.reachable_at(centres).reshape(self._shape)
        self._reachable = None if truth.is_open or not reachable.any() else reachable
        self._cells_near = self._near_points(truth.faces_m.mean(axis=1))

    def holds(self, resolution_m: float, origin: SE2) -> bool:
        """Whether the cells of another map are cells of this lattice."""
        if resolution_m != self._resolution_m:
            return False
        apart = (np.array(origin[:2]) - self._corner_m) / resolution_m
        return bool(np.all(np.abs(apart - np.rint(apart)) < _ALIGNED))

    def judge(self, cells: Cells, origin: SE2) -> MapShares:
        """Compare a map that the lattice holds; `cells` are occupancy, -1 unknown."""
        occupied, free = cells >= _OCCUPIED, (cells >= 0) & (cells <= _FREE)
        true_there, here = self._overlap(cells.shape, origin)
        inside = np.zeros(self._near.size + 1, np.bool_)
        inside[:-1].reshape(self._shape)[true_there] = occupied[here]
        near = int(np.count_nonzero(self._near[true_there] & occupied[here]))
        wrong = int(np.count_nonzero(self._deep[true_there] & free[here]))
        count, floor = int(np.count_nonzero(occupied)), int(np.count_nonzero(free))
        covered = None
        if self._reachable is not None:
            known = int(np.count_nonzero(self._reachable[true_there] & free[here]))
            covered = known / int(np.count_nonzero(self._reachable))
        found = np.count_nonzero(inside[self._cells_near].any(axis=1))
        points = len(self._cells_near)
        return MapShares(
            walls_found=int(found) / points if points else None,
            walls_true=near / count if count else None,
            free_wrong=wrong / floor if floor else None,
            coverage=covered,
        )

    def found(self, cells: Cells, origin: SE2) -> Mask:
        """(n,): which of the true map's faces have an occupied cell near."""
        true_there, here = self._overlap(cells.shape, origin)
        inside = np.zeros(self._near.size + 1, np.bool_)
        inside[:-1].reshape(self._shape)[true_there] = (cells >= _OCCUPIED)[here]
        return np.asarray(inside[self._cells_near].any(axis=1))

    def _bounds(self, truth: TrueMap) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First cell, and that after the last, (column, row), around all that counts."""
        corners = [np.array(truth.raster_origin_m)]
        corners.append(corners[0] + truth.raster_m * np.array(truth.reachable.shape[::-1]))
        low, high = ((corner - self._corner_m) / self._resolution_m for corner in corners)
        return np.floor(low).astype(np.int64), np.ceil(high).astype(np.int64)

    def _near_points(self, points_m: Array) -> NDArray[np.int64]:
        """(n, k) cells with their centres within NEAR_M of points (n, 2), as flat indices; filled
        up with one that is never occupied.
        """
        reach = math.ceil(NEAR_M / self._resolution_m)
        window = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
        at = (points_m - self._corner_m) / self._resolution_m - self._first
        cells = np.floor(at).astype(np.int64)[:, None] + window
        apart_m = self._resolution_m * np.linalg.norm(cells + 0.5 - at[:, None], axis=2)
        rows, columns = self._shape
        inside = (cells >= 0).all(axis=2) & (cells[..., 0] < columns) & (cells[..., 1] < rows)
        flat = cells[..., 1] * columns + cells[..., 0]
        return np.where(inside & (apart_m <= NEAR_M), flat, rows * columns)

    def _overlap(
        self, shape: tuple[int, ...], origin: SE2
    ) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """The rows and columns that a map shares with the lattice: there, and in the map."""
        apart = (np.array(origin[:2]) - self._corner_m) / self._resolution_m
        column, row = (np.rint(apart).astype(np.int64) - self._first).tolist()
        rows, columns = self._shape
        top, left = min(max(row, 0), rows), min(max(column, 0), columns)
        bottom = max(min(row + shape[0], rows), top)
        right = max(min(column + shape[1], columns), left)
        here = slice(top - row, bottom - row), slice(left - column, right - column)
        if bottom == top or right == left:
            return (slice(0, 0), slice(0, 0)), (slice(0, 0), slice(0, 0))
        return (slice(top, bottom), slice(left, right)), here


@dataclass(frozen=True)
class MapShares:
    """How well a map fits the truth, each 0 to 1; see `MapEvaluation`."""

    walls_found: float | None
    walls_true: float | None
    free_wrong: float | None
    coverage: float | None


def _painted(
    polygons: NDArray[np.object_], shape: tuple[int, int], low: Array, raster_m: float
) -> Mask:
    """(rows, columns): cells that polygons or lines touch."""
    picture = np.zeros(shape, np.uint8)
    for ring, closed in _rings(polygons):
        # In OpenCV whole coordinates are the centres of cells.
        cells = np.rint(((ring - low) / raster_m - 0.5) * (1 << _SHIFT)).astype(np.int32)
        if closed:
            cv2.fillPoly(picture, [cells], 1, shift=_SHIFT)
        else:
            cv2.polylines(picture, [cells], False, 1, shift=_SHIFT)
    return picture.astype(np.bool_)


def _rings(shapes: NDArray[np.object_]) -> list[tuple[Array, bool]]:
    """The outlines of polygons, without their holes, and lines; whether each is closed."""
    found = []
    for part in shapely.get_parts(shapes):
        if shapely.is_empty(part):
            continue
        closed = part.geom_type == "Polygon"
        line = shapely.get_exterior_ring(part) if closed else part
        found.append((shapely.get_coordinates(line), closed))
    return found


def _outline(solids: shapely.Geometry) -> tuple[Array, Array]:
    """(n, 2, 2) pieces of an outline, from and to, and (n, 2) their normals, outwards."""
    pieces = []
    for polygon in shapely.get_parts(shapely.segmentize(solids, SPACING_M)):
        exterior = shapely.get_exterior_ring(polygon)
        holes = [shapely.get_interior_ring(polygon, k) for k in range(len(polygon.interiors))]
        for ring, is_hole in [(exterior, False), *((hole, True) for hole in holes)]:
            points = shapely.get_coordinates(ring)
            # Counter-clockwise outside and clockwise in holes: the solid lies to the left.
            if shapely.is_ccw(ring) == is_hole:
                points = points[::-1]
            pieces.append(np.stack([points[:-1], points[1:]], axis=1))
    faces = np.concatenate(pieces) if pieces else np.zeros((0, 2, 2))
    along = faces[:, 1] - faces[:, 0]
    length = np.linalg.norm(along, axis=1)
    faces, along, length = (values[length > 1e-6] for values in (faces, along, length))
    return faces, np.stack([along[:, 1], -along[:, 0]], axis=1) / length[:, None]

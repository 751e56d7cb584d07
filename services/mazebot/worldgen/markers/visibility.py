"""Computes from where on the floor the robot can read a marker.

The whole panel must be in the camera's image, near enough and not too oblique, with the robot
at a reachable pose. The camera is assumed above the robot's centre.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.messages.documents import Planar, World
from mazebot.common.robot.waffle import WAFFLE_RADIUS_M
from mazebot.common.world.costmap import FREE
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.grids import connected_regions, distance_cells
from mazebot.common.world.obstruction import Obstruction, obstructions, wall_polygons
from mazebot.common.world.placement import Panel

Bits = NDArray[np.bool_]
Window = tuple[slice, slice, Bits]
"""Rows and columns of a map, and a mask of the cells there."""

CAMERA_HEIGHT_M = 0.21
TAN_HALF_VERTICAL_FOV = 480.0 / 640.0 * portable.tan(1.047 / 2.0)
"""Of the waffle's camera, 640 x 480 pixels and 1.047 rad wide, which is level."""
NEAREST_M, FARTHEST_M = 0.6, 5.0
WIDEST_RAD = math.radians(60.0)
"""Angle between a panel's normal and the ray to it."""

_BLOCK_M = 0.05
"""Cells of finer maps are judged in blocks about this wide, by the middle one."""
_TOUCH = 1e-9
"""A ray that crosses an obstacle over less of its length only touches it."""


def reachable(
    map_cells: NDArray[np.int8],
    resolution_m: float,
    origin: SE2,
    start: Planar,
    radius_m: float = WAFFLE_RADIUS_M,
) -> Bits:
    """(rows, columns): the cells in whose middle a round robot fits, connected to the start.

    Only free cells count as floor. If it does not fit at the start, the nearest cell where it does
    is used instead. Exact to within a quarter of a cell.
    """
    taken: Bits = map_cells != FREE
    # From a cell's middle to the nearest edge of an occupied cell.
    distance_m = (distance_cells(taken) - 0.5) * resolution_m
    fits: Bits = distance_m >= radius_m
    if not fits.any():
        return fits
    regions = connected_regions(fits)
    here = origin.inverse() @ start.se2()
    row, column = math.floor(here.y_m / resolution_m), math.floor(here.x_m / resolution_m)
    inside = 0 <= row < taken.shape[0] and 0 <= column < taken.shape[1]
    if not (inside and fits[row, column]):
        rows, columns = np.nonzero(fits)
        nearest = np.argmin(portable.square(rows - row) + portable.square(columns - column))
        row, column = int(rows[nearest]), int(columns[nearest])
    return np.asarray(regions == regions[row, column])


class Sight:
    """Visibility in one world. `meshes` are by sha256; missing ones hide nothing.

    Bodies hide what is behind them, at their initial poses.
    """

    def __init__(
        self,
        world: World,
        map_cells: NDArray[np.int8],
        origin: SE2,
        meshes: Mapping[str, TriangleMesh] | None = None,
    ) -> None:
        self._resolution_m = world.map_resolution_m
        self._origin = origin
        self.reachable: Bits = reachable(map_cells, world.map_resolution_m, origin, world.start)
        """(rows, columns): where the robot can go."""
        self._walls = wall_polygons(world.walls)
        self._heights_m = np.array([wall.height_m for wall in world.walls])
        self._bodies = [one for one in obstructions(world, meshes) if one.seen]
        self._hiding: dict[tuple[float, float], _Hiding] = {}

    def window(self, panel: Panel, every: int = 1) -> Window:
        """The cells from which a panel can be read, and the rows and columns that contain them all.
        Only every `every`-th row and column is judged, counted from the map's corner.
        """
        size_m = self._resolution_m
        centre = self._origin.inverse() @ SE2(
            float(panel.centre_m[0]), float(panel.centre_m[1]), 0.0
        )
        block = max(1, math.floor(_BLOCK_M / size_m + 1e-9)) if every == 1 else 1
        step = max(every, block)
        rows, columns = (
            slice(
                max(math.floor((middle - FARTHEST_M) / size_m), 0) // step * step,
                max(min(math.ceil((middle + FARTHEST_M) / size_m), count), 0),
                every,
            )
            for middle, count in zip((centre.y_m, centre.x_m), self.reachable.shape, strict=True)
        )
        seen = self.reachable[rows, columns].copy()
        if not seen.any():
            return rows, columns, seen
        x, y = self._middles(rows, columns)
        dx, dy = x - panel.centre_m[0], y - panel.centre_m[1]
        distance_m = portable.hypot_each(dx, dy)
        ahead_m = dx * panel.normal[0] + dy * panel.normal[1]
        seen &= (distance_m >= NEAREST_M) & (distance_m <= FARTHEST_M)
        seen &= ahead_m >= portable.cos(WIDEST_RAD) * distance_m
        # Panels high above the camera are out of its image when near.
        off_axis_m = abs(float(panel.centre_m[2]) - CAMERA_HEIGHT_M) + panel.side_m / 2.0
        seen &= distance_m >= off_axis_m / TAN_HALF_VERTICAL_FOV
        if seen.any():
            seen &= self._in_sight(panel, x, y, seen, block)
        return rows, columns, seen

    def _middles(self, rows: slice, columns: slice) -> tuple[Array, Array]:
        """The x and y in the map of the cells' middles."""
        x = (np.arange(columns.start, columns.stop, columns.step) + 0.5) * self._resolution_m
        y = ((np.arange(rows.start, rows.stop, rows.step) + 0.5) * self._resolution_m)[:, None]
        c, s = portable.cos_sin(self._origin.yaw_rad)
        return self._origin.x_m + c * x - s * y, self._origin.y_m + s * x + c * y

    def _in_sight(self, panel: Panel, x: Array, y: Array, wanted: Bits, block: int) -> Bits:
        """The wanted cells from which nothing hides any part of the panel."""
        low_m = float(panel.centre_m[2]) - panel.side_m / 2.0
        high_m = low_m + panel.side_m
        hiding = self._hiding_between(min(low_m, CAMERA_HEIGHT_M), max(high_m, CAMERA_HEIGHT_M))
        numbers = hiding.before(panel)
        if block > 1:
            count = [-(-size // block) for size in wanted.shape]
            middle = [
                np.minimum(np.arange(n) * block + block // 2, size - 1)
                for n, size in zip(count, wanted.shape, strict=True)
            ]
            x, y = x[np.ix_(*middle)], y[np.ix_(*middle)]
            blocks = np.add.reduceat(
                np.add.reduceat(wanted, np.arange(count[0]) * block, 0, np.int64),
                np.arange(count[1]) * block,
                1,
            )
            asked = blocks > 0
        else:
            asked = wanted
        half = panel.side_m / 2.0 * panel.right[:2]
        centre = panel.centre_m[:2]
        found = np.zeros(asked.shape, np.bool_)
        found[asked] = _unhidden(
            np.stack([x[asked], y[asked]], 1),
            np.stack([centre, centre - half, centre + half]),
            np.array([low_m, high_m]),
            hiding.planes,
            hiding.first,
            hiding.spans_m,
            numbers,
        )
        if block > 1:
            found = np.repeat(np.repeat(found, block, 0), block, 1)
            found = found[: wanted.shape[0], : wanted.shape[1]]
        return found

    def _hiding_between(self, low_m: float, high_m: float) -> _Hiding:
        key = (round(low_m, 6), round(high_m, 6))
        if key not in self._hiding:
            self._hiding[key] = _Hiding(self._walls, self._heights_m, self._bodies, *key)
        return self._hiding[key]


def seen_from(
    world: World,
    panels: Sequence[Panel],
    map_cells: NDArray[np.int8],
    origin: SE2,
    meshes: Mapping[str, TriangleMesh] | None = None,
) -> Bits:
    """(panels, rows, columns): the cells from whose middle the robot can read each panel."""
    sight = Sight(world, map_cells, origin, meshes)
    seen = np.zeros((len(panels), *map_cells.shape), np.bool_)
    for number, panel in enumerate(panels):
        rows, columns, cells = sight.window(panel)
        seen[number, rows, columns] = cells
    return seen


def covered_share(
    world: World,
    panels: Iterable[Panel],
    map_cells: NDArray[np.int8],
    origin: SE2,
    meshes: Mapping[str, TriangleMesh] | None = None,
) -> float:
    """Share of the reachable floor from which at least one panel can be read."""
    sight = Sight(world, map_cells, origin, meshes)
    covered = np.zeros(map_cells.shape, np.bool_)
    for panel in panels:
        rows, columns, cells = sight.window(panel)
        covered[rows, columns] |= cells
    return float(covered.sum()) / max(int(sight.reachable.sum()), 1)


class _Hiding:
    """Convex pieces that hide what is behind them, each bounded by the planes of its sides."""

    def __init__(
        self,
        walls: NDArray[np.object_],
        wall_heights_m: Array,
        bodies: Sequence[Obstruction],
        low_m: float,
        high_m: float,
    ) -> None:
        pieces = [body.between(low_m, high_m) for body in bodies]
        spans_m = np.stack([np.zeros(len(walls)), wall_heights_m], 1)
        self.polygons = np.concatenate([walls, *(some.polygons for some in pieces)])
        self.spans_m = np.concatenate(
            [spans_m, *(np.stack([some.low_m, some.high_m], 1) for some in pieces)]
        )
        """(n, 2): height range of each"""
        corners, owner = shapely.get_coordinates(
            shapely.orient_polygons(self.polygons), return_index=True
        )
        last = np.append(owner[1:] != owner[:-1], True) if len(owner) else owner.astype(bool)
        steps = np.roll(corners, -1, 0) - corners
        outward = np.stack([steps[:, 1], -steps[:, 0]], 1)
        planes = np.column_stack([outward, (outward * corners).sum(1)])
        self.planes = planes[~last]
        """(m, 3): a, b, c of each side; a x + b y < c holds inside"""
        self.first = np.searchsorted(owner[~last], np.arange(len(self.polygons) + 1))
        """(n + 1,): the first side of each"""
        self._tree = shapely.STRtree(self.polygons)

    def before(self, panel: Panel) -> NDArray[np.int64]:
        """Indices of the pieces that may hide the panel, the nearest first."""
        centre = panel.centre_m[:2]
        across, ahead = FARTHEST_M * panel.right[:2], FARTHEST_M * panel.normal[:2]
        view = shapely.Polygon(
            [centre - across, centre + across, centre + across + ahead, centre - across + ahead]
        )
        numbers = np.sort(self._tree.query(view, "intersects"))
        distances_m = shapely.distance(shapely.Point(centre), self.polygons[numbers])
        return np.asarray(numbers[np.argsort(distances_m, kind="stable")], np.int64)


@kernel()
def _unhidden(
    places: Array,
    targets: Array,
    heights_m: Array,
    planes: Array,
    first: NDArray[np.int64],
    spans_m: Array,
    numbers: NDArray[np.int64],
) -> Bits:
    """(n,) mask of the (n, 2) positions with no piece between the camera and the panel, whose
    middle and edges are the targets, (3, 2).
    """
    found = np.ones(len(places), np.bool_)
    latest = -1
    for place in range(len(places)):
        x, y = places[place]
        for target in range(len(targets)):
            dx, dy = targets[target, 0] - x, targets[target, 1] - y
            # The piece that hid the panel from the previous position most probably hides it again.
            for turn in range(-1, len(numbers)):
                number = latest if turn < 0 else numbers[turn]
                if number >= 0 and _between(
                    x,
                    y,
                    dx,
                    dy,
                    heights_m,
                    planes[first[number] : first[number + 1]],
                    spans_m[number],
                ):
                    found[place] = False
                    latest = number
                    break
            if not found[place]:
                break
    return found


@kernel()
def _between(
    x: float, y: float, dx: float, dy: float, heights_m: Array, planes: Array, span_m: Array
) -> bool:
    """Whether a convex piece intersects a ray from the camera at (x, y) to a target's whole height.

    After Cyrus and Beck (1978).
    """
    enter, leave = 0.0, 1.0
    for side in range(len(planes)):
        a, b, c = planes[side]
        start = c - a * x - b * y
        rate = a * dx + b * dy
        if rate == 0.0:
            if start <= 0.0:
                return False
        elif rate > 0.0:
            leave = min(leave, start / rate)
        else:
            enter = max(enter, start / rate)
        if leave - enter <= _TOUCH:
            return False
    low_m = CAMERA_HEIGHT_M + min(
        enter * (heights_m[0] - CAMERA_HEIGHT_M), leave * (heights_m[0] - CAMERA_HEIGHT_M)
    )
    high_m = CAMERA_HEIGHT_M + max(
        enter * (heights_m[1] - CAMERA_HEIGHT_M), leave * (heights_m[1] - CAMERA_HEIGHT_M)
    )
    return bool(low_m < span_m[1] and span_m[0] < high_m)

"""Where the robot has clearance, and how much of the floor it can reach: judged on the costmap of
the map, as navigation does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import KeepoutZone, Planar, World
from mazebot.common.robot.waffle import WAFFLE_FOOTPRINT_M
from mazebot.common.world.costmap import (
    ROBOT_RADIUS_M,
    START_TOLERANCE_M,
    Cells,
    Clearance,
    Mask,
    clearance_m,
    inscribed,
    nearest_cell,
    reachable_from,
    straightened,
    traversable,
)
from mazebot.common.world.footprint import footprints
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.grids import connected_regions, distance_cells
from mazebot.common.world.polygon_cells import polygon_cells
from mazebot.worldgen.map.occupancy import (
    MARGIN_M,
    OPEN_MARGIN_M,
    Grid,
    grid_of,
    occupied_cells,
    rasterise,
)

CORRIDOR_M = 0.5
"""Mazes with corridors of this width are driven to the end and back; in narrower ones the robot
cannot turn round."""
POCKET_SHARE = 0.5
"""A start whose piece of floor is smaller than this share of the largest one is in a pocket."""

_HALF_WIDTH_M = max(y_m for _, y_m in WAFFLE_FOOTPRINT_M)
_ROOM_M = 0.15
"""Clearance wanted around an automatic start."""
_AHEAD_M, _FAR_AHEAD_M = 1.0, 3.0
"""Free distance wanted ahead of it there, and the maximum that is checked."""
_HEADINGS = 24


@dataclass(frozen=True)
class Reach:
    """How much of the floor among the entities of a world the robot's centre can reach.

    Limited to the convex hull of everything solid, or to the map if nothing is.
    """

    reachable_m2: float
    floor_m2: float
    """Where the robot fits."""
    largest_m2: float
    """Of the largest connected piece."""
    largest: Planar
    """A pose on it with clearance."""
    open_floor: bool
    """The floor extends beyond the hull."""

    @property
    def share(self) -> float:
        """Of the floor where the robot fits; 0 if it fits nowhere."""
        return self.reachable_m2 / self.floor_m2 if self.floor_m2 > 0.0 else 0.0

    @property
    def is_pocket(self) -> bool:
        """Whether the start is on a small piece of the floor."""
        return self.reachable_m2 < POCKET_SHARE * self.largest_m2

    def __str__(self) -> str:
        """As a phrase: `25.1 m2 of floor (100 %) can be reached from the start`."""
        more = ", and the open floor around it" if self.open_floor else ""
        return (
            f"{self.reachable_m2:.1f} m2 of floor ({100.0 * self.share:.0f} %) can be reached "
            f"from the start{more}"
        )


@dataclass(frozen=True, eq=False)
class _Floor:
    """Connected pieces of the floor where the robot fits."""

    grid: Grid
    clearance: Clearance
    regions: NDArray[np.int32]
    counted: Mask
    """Cells that count for a piece's area."""
    areas_m2: NDArray[np.float64]
    """By number of the piece; 0 at number 0, which is no piece."""

    @property
    def largest(self) -> int:
        """Number of the largest piece; of equal ones that with more cells in all; 0: none."""
        if len(self.areas_m2) < 2:
            return 0
        sizes = np.bincount(self.regions.ravel())
        sizes[0] = 0
        return max(range(1, len(sizes)), key=lambda one: (self.areas_m2[one], sizes[one]))


def reach(world: World, meshes: Mapping[str, TriangleMesh]) -> Reach:
    """How much of the floor can be reached from a world's start. `meshes` are by sha256.

    Raises KeyError if a mesh is missing, ValueError if the map has too many cells.
    """
    floor = _floor(world, meshes, 0.0)
    cell = floor.grid.cell(world.start.x_m, world.start.y_m)
    number = 0
    if cell is not None:
        near = START_TOLERANCE_M / floor.grid.resolution_m
        free = nearest_cell(floor.regions > 0, *cell, near)
        number = int(floor.regions[free]) if free is not None else 0
    edge = np.concatenate(
        [floor.regions[0], floor.regions[-1], floor.regions[:, 0], floor.regions[:, -1]]
    )
    return Reach(
        reachable_m2=float(floor.areas_m2[number]) if number else 0.0,
        floor_m2=float(floor.areas_m2[1:].sum()),
        largest_m2=float(floor.areas_m2[floor.largest]) if floor.largest else 0.0,
        largest=automatic_start(world, meshes),
        open_floor=bool(number and (edge == number).any()),
    )


def automatic_start(world: World, meshes: Mapping[str, TriangleMesh]) -> Planar:
    """Default start pose of the robot: on the largest connected piece of the floor, at the world's
    start if it has clearance there, else at the nearest position that has, with a heading along
    free floor.

    The pieces are those of navigation's costmap for a robot larger by a cell, so that no passage
    between them is too narrow to be driven. If there is clearance nowhere, it is the start
    itself. `meshes` are by sha256. Raises as `reach` does.
    """
    start = world.start
    floor = _floor(world, meshes, world.map_resolution_m)
    if not floor.largest:
        floor = _floor(world, meshes, 0.0)
    if not floor.largest:
        return start
    grid, clearance = floor.grid, floor.clearance
    piece = floor.regions == floor.largest
    if (piece & floor.counted).any():
        piece &= floor.counted
    wanted_m = min(ROBOT_RADIUS_M + _ROOM_M, float(clearance[piece].max()))
    room = piece & (clearance >= wanted_m)
    x_m, y_m = start.x_m, start.y_m
    cell = grid.cell(x_m, y_m)
    if cell is None or not room[cell]:
        row, column = cell or _unbounded_cell(grid, start)
        cell = nearest_cell(room, row, column)
        assert cell is not None
        # Rounded to readable numbers; the clearance is larger than that.
        x_m = round(grid.origin.x_m + (cell[1] + 0.5) * grid.resolution_m, 3)
        y_m = round(grid.origin.y_m + (cell[0] + 0.5) * grid.resolution_m, 3)
    free = ~inscribed(clearance, ROBOT_RADIUS_M + grid.resolution_m)
    return Planar(x_m=x_m, y_m=y_m, yaw_rad=_heading(free, cell, grid.resolution_m, start.yaw_rad))


def rooms_to_stand(
    cells: Cells, resolution_m: float, origin: SE2, start: Planar, places: Sequence[Planar]
) -> list[tuple[float | None, bool]]:
    """For each pose, by navigation's costmap of a map: the distance to the nearest obstacle in
    metres if that is too near for the robot, else None; and whether there is a path to it from the
    start.

    `cells` (rows, columns) are 0 free to 100 occupied, -1 unknown, with `origin` map_from_grid.
    """
    origin, cells = straightened(resolution_m, origin, cells)
    free, clearance = traversable(cells, resolution_m)
    rows, columns = cells.shape
    grid = Grid(rows, columns, resolution_m, origin)
    at = grid.cell(start.x_m, start.y_m)
    near = START_TOLERANCE_M / resolution_m
    reached = reachable_from(free, *at, near) if at is not None else np.zeros(free.shape, np.bool_)
    touches = inscribed(clearance)
    found: list[tuple[float | None, bool]] = []
    for place in places:
        cell = grid.cell(place.x_m, place.y_m)
        if cell is None:
            found.append((None, False))
        else:
            too_near = float(clearance[cell]) if touches[cell] else None
            found.append((too_near, bool(reached[cell])))
    return found


def cut_off_by_zones(
    cells: Cells,
    resolution_m: float,
    origin: SE2,
    start: Planar,
    places: Sequence[Planar],
    zones: Sequence[KeepoutZone],
) -> list[tuple[str, ...]]:
    """For each pose that the robot could reach from the start, the names of the keepout zones that
    alone are in its way, or of all zones if none is alone; empty: it can be reached.

    The robot's side keeps out as well, as in navigation's costmap. It may leave the zone that it
    starts in, and those that touch this one. `cells` and `origin` are as for `rooms_to_stand`.
    """
    origin, cells = straightened(resolution_m, origin, cells)
    free, _ = traversable(cells, resolution_m)
    rows, columns = cells.shape
    grid = Grid(rows, columns, resolution_m, origin)
    at = grid.cell(start.x_m, start.y_m)
    if at is None or not zones:
        return [()] * len(places)
    zone_cells = [
        polygon_cells(
            [((x - origin.x_m) / resolution_m, (y - origin.y_m) / resolution_m)
             for x, y in zone.polygon_m],
            rows, columns,
        )
        for zone in zones
    ]  # fmt: skip
    regions = connected_regions(np.logical_or.reduce(zone_cells))
    around = regions == regions[at] if regions[at] else np.zeros(free.shape, np.bool_)

    def reached_without(kept_out: Mask) -> Mask:
        forbidden = kept_out & ~around
        if forbidden.any():
            near = distance_cells(forbidden) * resolution_m <= _HALF_WIDTH_M
            # The margin of a zone must not close in what starts within it.
            forbidden = near & ~around
        return reachable_from(free & ~forbidden, *at, START_TOLERANCE_M / resolution_m)

    before = reached_without(np.zeros(free.shape, np.bool_))
    after = reached_without(np.logical_or.reduce(zone_cells))
    alone = [reached_without(one) for one in zone_cells]
    found: list[tuple[str, ...]] = []
    for place in places:
        cell = grid.cell(place.x_m, place.y_m)
        if cell is None or after[cell] or not before[cell]:
            found.append(())
            continue
        names = [zone.name for zone, one in zip(zones, alone, strict=True) if not one[cell]]
        found.append(tuple(names or [zone.name for zone in zones]))
    return found


def _floor(world: World, meshes: Mapping[str, TriangleMesh], margin_m: float) -> _Floor:
    """The pieces for a robot that is larger by a margin."""
    taken = footprints(world, meshes)
    points = [stack.reshape(-1, 2) for one in taken for stack in one.polygons_m if stack.size]
    grid = grid_of(world, meshes, MARGIN_M if points else OPEN_MARGIN_M)
    clearance = clearance_m(occupied_cells(taken, grid), grid.resolution_m)
    regions = connected_regions(~inscribed(clearance, ROBOT_RADIUS_M + margin_m))
    counted = np.ones(regions.shape, np.bool_)
    if points:
        # Floor outside a house is no piece of its floor, however wide the map.
        hull = shapely.convex_hull(shapely.linestrings(np.concatenate(points)))
        within = rasterise([np.array(shapely.get_coordinates(hull))[None]], grid)
        if (regions[within] > 0).any():
            counted = within
    cells = np.bincount(regions.ravel(), weights=counted.ravel())
    areas_m2 = np.asarray(cells * portable.square(grid.resolution_m), np.float64)
    return _Floor(grid, clearance, regions, counted, areas_m2)


def _unbounded_cell(grid: Grid, place: Planar) -> tuple[int, int]:
    """Row and column of a pose, also beyond the grid."""
    return (
        math.floor((place.y_m - grid.origin.y_m) / grid.resolution_m),
        math.floor((place.x_m - grid.origin.x_m) / grid.resolution_m),
    )


def _heading(free: Mask, cell: tuple[int, int], resolution_m: float, yaw_rad: float) -> float:
    """The given heading if the path ahead is free for a metre, else that of the longest free line;
    of equal ones the one with the smallest turn.
    """
    steps = np.arange(1, math.ceil(2.0 * _FAR_AHEAD_M / resolution_m) + 1) / 2.0
    best_m, best_rad = -1.0, yaw_rad
    turns = sorted(range(_HEADINGS), key=lambda turn: (min(turn, _HEADINGS - turn), turn))
    for turn in turns:
        heading = math.remainder(yaw_rad + turn * math.tau / _HEADINGS, math.tau)
        along, up = portable.cos_sin(heading)
        rows = np.floor(cell[0] + 0.5 + steps * up).astype(np.int64)
        columns = np.floor(cell[1] + 0.5 + steps * along).astype(np.int64)
        inside = (rows >= 0) & (rows < free.shape[0]) & (columns >= 0) & (columns < free.shape[1])
        # Beyond the map's edge the floor is open.
        blocked = (
            inside & ~free[rows.clip(0, free.shape[0] - 1), columns.clip(0, free.shape[1] - 1)]
        )
        ahead_m = float(np.argmax(blocked) if blocked.any() else len(steps)) * resolution_m / 2.0
        if ahead_m > best_m + 1e-9:
            best_m, best_rad = ahead_m, heading
        if turn == 0 and ahead_m >= _AHEAD_M:
            break
    return round(best_rad, 4)

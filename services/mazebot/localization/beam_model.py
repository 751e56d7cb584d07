"""How each beam of a scan fits a pose: explained by the map, shortened, or through a wall.

The likelihood field looks only at where beams end. Here each beam is also followed through the map,
so that a pose in the wrong room, whose beams pass through walls, is distinguished from the right
one (the test of emcl2, Ueda and others), and so that a beam without a return counts, too: the map
has to be open there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel, shared_kernel
from mazebot.common.messages.scan import Scan
from mazebot.localization.likelihood_field import OCCUPIED, LikelihoodField

_FAR_M = 1e3
"""No lidar has a longer range, whatever its message states."""
_CAST_AT_MOST_M = 30.0
_THROUGH_M = 0.2
"""A beam that ends less than this behind a face grazed it: the pose may be off by centimetres."""
_SIDE_M = 0.08
"""A beam passes through a wall only if its neighbours at this distance on both sides do, too."""
_HIT_STD_M = 0.05
BEFORE_M = 0.06
IN_WALL_M = -0.02
"""A signed distance below this is inside a wall."""
LEAST_BEAMS = 5
"""Fewer beams than this contradict nothing."""
THROUGH_WEIGHT = 3.0
"""Beams through walls weigh so much more: nothing that moves can cause them."""

MISS_COST, THROUGH_COST = 3.0, 5.0
"""Loss of log-likelihood of a beam that the map does not explain, and of one through a wall."""
NOWHERE_COST = 0.75
"""Loss of log-likelihood of a return that no map explains: half of one that a map does not explain.
The best of all poses of another place explains hardly three returns of four, at twice that loss for
the others.
"""

# Columns of the counts of beams.
HIT, SHORT, MISFIT, THROUGH, MISSING, OPEN, UNMAPPED = range(7)


@dataclass(frozen=True)
class ScanView:
    """A scan, thinned, in the base's frame: beams and where they end."""

    directions: Array
    """(m, 2) unit vectors of the beams."""
    ranges_m: Array
    """(m,), inf where there was no return"""
    points_m: Array
    """(k, 2) ends of the beams with a return, the lidar's place included."""
    before_m: Array
    """(k, 2) points just before those ends: they have to be in front of the wall, too, else a beam
    ends at the wrong face of it.
    """
    base_from_scan: SE2
    range_max_m: float
    miss_weight: float
    """How many of the beams with a return a beam without one stands for: they are thinned apart."""
    likelihood_weight: float
    """Of one beam, so that a scan weighs no more than `max_beams` beams."""

    @property
    def returns(self) -> int:
        """Number of beams with a return: they are the first ones."""
        return len(self.points_m)

    def halved(self) -> ScanView:
        """Every second beam, each with twice the weight."""
        hits, misses = slice(0, self.returns, 2), slice(self.returns, None, 2)
        return ScanView(
            np.concatenate([self.directions[hits], self.directions[misses]]),
            np.concatenate([self.ranges_m[hits], self.ranges_m[misses]]),
            np.ascontiguousarray(self.points_m[::2]),
            np.ascontiguousarray(self.before_m[::2]),
            self.base_from_scan,
            self.range_max_m,
            self.miss_weight,
            2.0 * self.likelihood_weight,
        )


@dataclass(frozen=True)
class RayMap:
    """The map's walls for following beams, in the axes of the grid."""

    occupied: NDArray[np.uint8]
    """(rows, columns), 1 where a wall is, 2 where nothing is known."""
    cells_per_m: float
    inset_m: float
    """How far inside its cell a wall's face lies."""
    map_from_grid: SE2
    field: LikelihoodField
    raster_m: float
    """Off a wall by no more than this, a return does not count against a pose: poses that look
    alike in the world must not be distinguished by how their walls fall into cells.
    """
    tolerance_m: float

    @classmethod
    def of(
        cls,
        cells: NDArray[np.int8],
        resolution_m: float,
        map_from_grid: SE2,
        field: LikelihoodField,
        wall_inset_cells: float,
        tolerance_m: float,
    ) -> RayMap:
        """From a map's cells, as `likelihood_field` takes them."""
        occupied = (cells >= OCCUPIED).astype(np.uint8)
        occupied[cells < 0] = 2
        return cls(
            np.ascontiguousarray(occupied),
            1.0 / resolution_m,
            wall_inset_cells * resolution_m,
            map_from_grid,
            field,
            resolution_m,
            tolerance_m,
        )


def scan_view(scan: Scan, max_beams: int) -> ScanView:
    """Evenly thinned beams of a scan: up to `max_beams` with a return and as many without.

    Ranges in [range_min, range_max) are returns; those beyond it, infinite ones included, are beams
    without one. Ranges below range_min, 0 and NaN are ignored, as in REP 117.
    """
    base_from_scan = scan.base_from_scan
    distances_m = np.asarray(scan.ranges_m, np.float64)
    limit_m = min(scan.range_max_m, _FAR_M)
    hits, hit_stride = _thinned(np.flatnonzero(returned(scan)), max_beams)
    misses, miss_stride = _thinned(np.flatnonzero(distances_m >= limit_m), max_beams)
    beams = np.concatenate([hits, misses])
    directions = scan.directions()[beams]
    ends = directions[: len(hits)]
    points_m = np.array([base_from_scan.x_m, base_from_scan.y_m]) + distances_m[hits, None] * ends
    miss_weight = miss_stride / hit_stride
    represented = len(hits) + miss_weight * len(misses)
    return ScanView(
        directions,
        np.concatenate([distances_m[hits], np.full(len(misses), np.inf)]),
        points_m,
        points_m - BEFORE_M * ends,
        base_from_scan,
        limit_m,
        miss_weight,
        min(1.0, max_beams / max(represented, 1.0)),
    )


def returned(scan: Scan) -> NDArray[np.bool_]:
    """(n,) whether a range of a scan is a return: it is in [range_min, range_max)."""
    distances_m = np.asarray(scan.ranges_m, np.float64)
    limit_m = min(scan.range_max_m, _FAR_M)
    return (distances_m >= scan.range_min_m) & (distances_m > 0.0) & (distances_m < limit_m)


def _thinned(beams: NDArray[np.int64], most: int) -> tuple[NDArray[np.int64], int]:
    stride = max(1, -(-len(beams) // most))
    return beams[stride // 2 :: stride], stride


def judge(rays: RayMap, poses: Array, view: ScanView) -> tuple[Array, Array]:
    """(n, 7) counts of beams by kind, and (n,) log-likelihoods, of a scan at poses (n, 3).

    The counts' columns are HIT, SHORT, MISFIT, THROUGH, MISSING, OPEN and UNMAPPED: a return near a
    wall, one before the map's first wall, one elsewhere, one behind a wall, none where the map has
    a wall in range, none where it has none, and a return from where the map knows nothing, which
    speaks neither for nor against a pose. A log-likelihood is 0 where every beam is explained. The
    beams' terms are those of the beam model (Probabilistic Robotics, 6.3) as constants, with the
    field's Gaussian for hits: sharper ones would punish centimetres.
    """
    return _judged(rays, poses, view, np.empty((0, 0), np.int8))


def _judged(
    rays: RayMap, poses: Array, view: ScanView, kinds: NDArray[np.int8]
) -> tuple[Array, Array]:
    """See `judge`; `kinds` (k, m) gets the kinds of the m beams at the first k poses."""
    counts = np.zeros((len(poses), UNMAPPED + 1))
    log_likelihoods = np.zeros(len(poses))
    field, grid = rays.field, rays.map_from_grid
    field_pose = field.map_from_field
    _judge(
        np.ascontiguousarray(poses), view.directions, view.ranges_m,
        view.base_from_scan.x_m, view.base_from_scan.y_m,
        min(view.range_max_m, _CAST_AT_MOST_M),
        rays.occupied, rays.cells_per_m, grid.x_m, grid.y_m, grid.yaw_rad, rays.inset_m,
        field.distance_m, 1.0 / field.cell_m, field_pose.x_m, field_pose.y_m, field_pose.yaw_rad,
        rays.tolerance_m, rays.raster_m, view.miss_weight, counts, log_likelihoods, kinds,
    )  # fmt: skip
    log_likelihoods *= view.likelihood_weight
    return counts, log_likelihoods


def qualities(counts: Array, dynamic_share: float) -> Array:
    """(n,) quality 0 to 1 of poses, by `judge`'s counts: the share of beams that are explained.

    A return on a wall is, and so is one before it, up to `dynamic_share` of the beams: something
    that the map does not have may stand there. One from where the map knows nothing is not. Beams
    through walls weigh thrice. Where the map has no wall in range and nothing returns, nothing
    contradicts the pose: its quality is 1.
    """
    returns = counts[:, HIT] + counts[:, SHORT] + counts[:, MISFIT] + counts[:, UNMAPPED]
    judged = returns + counts[:, MISSING]
    total = judged + THROUGH_WEIGHT * counts[:, THROUGH]
    short = np.minimum(counts[:, SHORT], dynamic_share * (judged + counts[:, THROUGH]))
    explained = counts[:, HIT] + short
    few = total < LEAST_BEAMS
    return np.asarray(np.where(few, 1.0, explained / np.maximum(total, 1.0)))


def consistencies(counts: Array) -> Array:
    """(n,) 0 to 1, how little contradicts poses, by `judge`'s counts.

    Beams through walls, thrice, those without an echo where the map has a wall, and those just
    behind one count against a pose; returns from before the map's walls do not, however many: large
    things that are not on the map may stand around the robot. Where next to nothing can be judged,
    1.
    """
    against = counts[:, MISFIT] + counts[:, MISSING] + THROUGH_WEIGHT * counts[:, THROUGH]
    total = counts[:, HIT] + counts[:, SHORT] + against
    return np.asarray(np.where(total < LEAST_BEAMS, 1.0, 1.0 - against / np.maximum(total, 1.0)))


def refutations(counts: Array, likelihood_weight: float) -> Array:
    """(n,) how much less likely poses are by the beams that contradict them, a log-likelihood of 0
    or more in the units of `judge`.
    """
    against = counts[:, MISFIT] + counts[:, MISSING]
    loss = MISS_COST * against + THROUGH_COST * counts[:, THROUGH]
    return np.asarray(loss * likelihood_weight)


def mapped_returns(
    rays: RayMap, pose: SE2, view: ScanView, within_m: float = 0.0
) -> NDArray[np.bool_]:
    """(k,) which returns of a scan at a pose do not come from where the map knows nothing, also if
    the pose is off by `within_m` in any direction: the end of a known wall is no face that holds a
    robot back.
    """
    shifts = [(0.0, 0.0), (within_m, 0.0), (-within_m, 0.0), (0.0, within_m), (0.0, -within_m)]
    poses = np.array([pose @ SE2(x_m, y_m, 0.0) for x_m, y_m in shifts])
    kinds = np.empty((len(poses), len(view.ranges_m)), np.int8)
    _judged(rays, poses, view, kinds)
    grid = rays.map_from_grid
    seen = np.empty(len(poses), np.bool_)
    _in_sight(poses, rays.occupied, rays.cells_per_m, grid.x_m, grid.y_m, grid.yaw_rad, seen)
    return np.asarray((kinds[seen, : view.returns] != UNMAPPED).all(axis=0))


def in_wall(rays: RayMap, poses: Array, clearance_m: float) -> NDArray[np.bool_]:
    """(n,) whether a robot at poses (n, 3) stands in a wall or nearer to one than the clearance."""
    field = rays.field
    pose = field.map_from_field
    near = np.zeros(len(poses), np.bool_)
    _in_wall(
        poses, field.distance_m, 1.0 / field.cell_m, pose.x_m, pose.y_m, pose.yaw_rad, clearance_m,
        near,
    )  # fmt: skip
    return near


def moved_view(view: ScanView, now_from_then: SE2) -> ScanView:
    """The same scan in the frame of the base at another time."""
    c, s = portable_kernels.cos_sin(now_from_then.yaw_rad)
    there_m = np.array([now_from_then.x_m, now_from_then.y_m])
    return ScanView(
        _turned(view.directions, c, s),
        view.ranges_m,
        _turned(view.points_m, c, s) + there_m,
        _turned(view.before_m, c, s) + there_m,
        now_from_then @ view.base_from_scan,
        view.range_max_m,
        view.miss_weight,
        view.likelihood_weight,
    )


def _turned(vectors: Array, c: float, s: float) -> Array:
    x, y = vectors[:, 0], vectors[:, 1]
    return np.ascontiguousarray(np.stack([c * x - s * y, s * x + c * y], axis=1))


@shared_kernel()
def _first_wall(
    occupied: NDArray[np.uint8],
    x: float,
    y: float,
    dx: float,
    dy: float,
    most: float,
) -> float:
    """Distance, in cells, at which a ray enters its first occupied cell (Amanatides, Woo, 1987)."""
    rows, columns = occupied.shape
    column, row = math.floor(x), math.floor(y)
    step_x = 1 if dx > 0.0 else -1
    step_y = 1 if dy > 0.0 else -1
    inverse_x = 1.0 / abs(dx) if abs(dx) > 1e-12 else 1e12
    inverse_y = 1.0 / abs(dy) if abs(dy) > 1e-12 else 1e12
    next_x = (column + 1 - x if dx > 0.0 else x - column) * inverse_x
    next_y = (row + 1 - y if dy > 0.0 else y - row) * inverse_y
    along = 0.0
    while along <= most:
        if row >= 0 and column >= 0 and row < rows and column < columns:
            if occupied[row, column] == 1:
                return along
        if next_x < next_y:
            along = next_x
            next_x += inverse_x
            column += step_x
        else:
            along = next_y
            next_y += inverse_y
            row += step_y
    return 1e12


@shared_kernel()
def _is_unknown(occupied: NDArray[np.uint8], x: float, y: float) -> bool:
    rows, columns = occupied.shape
    column, row = math.floor(x), math.floor(y)
    if row < 0 or column < 0 or row >= rows or column >= columns:
        return True
    return bool(occupied[row, column] == 2)


@kernel("void(float64[:, ::1], uint8[:, ::1], float64, float64, float64, float64, boolean[::1])")
def _in_sight(
    poses: Array,
    occupied: NDArray[np.uint8],
    cells_per_m: float,
    grid_x: float,
    grid_y: float,
    grid_yaw: float,
    seen: NDArray[np.bool_],
) -> None:
    """Whether no wall is between the first pose and each."""
    c, s = portable_kernels.cos_sin(grid_yaw)
    x = (c * (poses[0, 0] - grid_x) + s * (poses[0, 1] - grid_y)) * cells_per_m
    y = (c * (poses[0, 1] - grid_y) - s * (poses[0, 0] - grid_x)) * cells_per_m
    for i in range(poses.shape[0]):
        ox, oy = poses[i, 0] - poses[0, 0], poses[i, 1] - poses[0, 1]
        way = math.sqrt(ox * ox + oy * oy)
        if way == 0.0:
            seen[i] = True
            continue
        dx, dy = (c * ox + s * oy) / way, (c * oy - s * ox) / way
        seen[i] = _first_wall(occupied, x, y, dx, dy, way * cells_per_m) > way * cells_per_m


@kernel(
    "void(float64[:, ::1], float64[:, ::1], float64[::1], float64, float64, float64, "
    "uint8[:, ::1], float64, float64, float64, float64, float64, float32[:, ::1], float64, "
    "float64, float64, float64, float64, float64, float64, float64[:, ::1], float64[::1], "
    "int8[:, ::1])",
)
def _judge(
    poses: Array,
    directions: Array,
    ranges: Array,
    scan_x: float,
    scan_y: float,
    range_max: float,
    occupied: NDArray[np.uint8],
    cells_per_m: float,
    grid_x: float,
    grid_y: float,
    grid_yaw: float,
    inset: float,
    distance: NDArray[np.float32],
    field_cells_per_m: float,
    field_x: float,
    field_y: float,
    field_yaw: float,
    tolerance: float,
    raster: float,
    miss_weight: float,
    counts: Array,
    log_likelihoods: Array,
    kinds: NDArray[np.int8],
) -> None:
    rows, columns = distance.shape
    cg, sg = portable_kernels.cos_sin(grid_yaw)
    cf, sf = portable_kernels.cos_sin(field_yaw)
    side = _SIDE_M * cells_per_m
    for i in range(poses.shape[0]):
        c, s = portable_kernels.cos_sin(poses[i, 2])
        x0 = poses[i, 0] + c * scan_x - s * scan_y
        y0 = poses[i, 1] + s * scan_x + c * scan_y
        gx = (cg * (x0 - grid_x) + sg * (y0 - grid_y)) * cells_per_m
        gy = (cg * (y0 - grid_y) - sg * (x0 - grid_x)) * cells_per_m
        total = 0.0
        for j in range(directions.shape[0]):
            ca = c * directions[j, 0] - s * directions[j, 1]
            sa = s * directions[j, 0] + c * directions[j, 1]
            dx, dy = cg * ca + sg * sa, cg * sa - sg * ca
            returned = ranges[j] < range_max
            reach = ranges[j] if returned else range_max
            reach_cells = reach * cells_per_m
            wall = _first_wall(occupied, gx, gy, dx, dy, reach_cells) / cells_per_m + inset
            behind = wall < reach - _THROUGH_M
            if behind:
                for sign in (-1.0, 1.0):
                    beside = _first_wall(
                        occupied, gx - sign * side * dy, gy + sign * side * dx, dx, dy, reach_cells
                    )
                    if beside / cells_per_m + inset >= reach - _THROUGH_M:
                        behind = False
            if not returned:
                kind, loss = (MISSING, MISS_COST) if behind else (OPEN, 0.0)
                counts[i, kind] += miss_weight
                total -= loss * miss_weight
            elif behind:
                kind = THROUGH
                counts[i, kind] += 1.0
                total -= THROUGH_COST
            else:
                ex, ey = x0 + reach * ca - field_x, y0 + reach * sa - field_y
                u = (cf * ex + sf * ey) * field_cells_per_m
                v = (cf * ey - sf * ex) * field_cells_per_m
                off = 10.0
                if u >= 0.0 and v >= 0.0 and u < columns and v < rows:
                    off = abs(distance[int(v), int(u)])
                    u -= BEFORE_M * field_cells_per_m * (cf * ca + sf * sa)
                    v -= BEFORE_M * field_cells_per_m * (cf * sa - sf * ca)
                    if u >= 0.0 and v >= 0.0 and u < columns and v < rows:
                        if distance[int(v), int(u)] < IN_WALL_M:
                            off += BEFORE_M
                scaled = max(0.0, off - raster) / _HIT_STD_M
                loss = min(MISS_COST, 0.5 * scaled * scaled)
                if off <= tolerance:
                    kind = HIT
                elif wall <= reach:
                    kind = MISFIT
                elif _is_unknown(occupied, gx + reach_cells * dx, gy + reach_cells * dy):
                    kind, loss = UNMAPPED, min(loss, NOWHERE_COST)
                else:
                    kind = SHORT
                counts[i, kind] += 1.0
                total -= loss
            if i < kinds.shape[0]:
                kinds[i, j] = kind
        log_likelihoods[i] = total


@kernel(
    "void(float64[:, ::1], float32[:, ::1], float64, float64, float64, float64, float64, "
    "boolean[::1])"
)
def _in_wall(
    poses: Array,
    distance: NDArray[np.float32],
    cells_per_m: float,
    field_x: float,
    field_y: float,
    field_yaw: float,
    clearance: float,
    near: NDArray[np.bool_],
) -> None:
    c, s = portable_kernels.cos_sin(field_yaw)
    for i in range(poses.shape[0]):
        x, y = poses[i, 0] - field_x, poses[i, 1] - field_y
        u, v = (c * x + s * y) * cells_per_m, (c * y - s * x) * cells_per_m
        if u >= 0.0 and v >= 0.0 and u < distance.shape[1] and v < distance.shape[0]:
            near[i] = distance[int(v), int(u)] < clearance

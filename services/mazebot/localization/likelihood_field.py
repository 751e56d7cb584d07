"""The likelihood field of a map: the probability density of a lidar return at each position.

After Thrun, Burgard, Fox, Probabilistic Robotics (2005), section 6.4, with two differences. Returns
come from the faces of walls, so the distance is signed and zero where a face most probably lies in
its cells. And the tables are finer than the map, so that a nearest-cell look-up is accurate to a
centimetre.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2
from mazebot.common.maths.opencv import without_ipp
from mazebot.common.world.grids import MAX_CELLS, distance_cells

OCCUPIED = 50
"""Cells from this value on are walls; ROS maps hold 0 free to 100 occupied, -1 unknown."""

TABLE_CELL_M = 0.0125
"""Size of a table's cell at best: about the noise of one lidar return."""
MAX_TABLE_CELLS = 8_000_000
"""Of a table that is finer than its map: computing one takes 50 bytes for each."""


@dataclass(frozen=True)
class LikelihoodField:
    """Tables over the map, (rows, columns) float32, row 0 at the smallest y of the map's axes."""

    distance_m: NDArray[np.float32]
    """Distance to the nearest face of a wall; negative inside walls, and limited."""
    log_likelihood: NDArray[np.float32]
    """Logarithm of a return's probability density, in 1/m, at that position."""
    least_log_likelihood: float
    """The same outside the map"""
    cell_m: float
    map_from_field: SE2
    """Pose of the tables' corner (row 0, column 0)."""


def likelihood_field(
    cells: NDArray[np.int8],
    resolution_m: float,
    map_from_grid: SE2,
    *,
    z_hit: float,
    z_rand: float,
    sigma_hit_m: float,
    max_distance_m: float,
    wall_inset_cells: float,
    range_max_m: float,
) -> LikelihoodField:
    """Tables of a map with (rows, columns) cells. Unknown cells count as free, as they do in AMCL.

    The density is `z_hit * N(distance; 0, sigma_hit) + z_rand / range_max` (table 6.3). A wall's
    face lies `wall_inset_cells` inside its occupied cells. The tables end where no wall is within
    `max_distance_m`: open floor around the walls takes no memory.

    Raises ValueError if the map's size or resolution is unusable.
    """
    if cells.ndim != 2 or min(cells.shape) < 2:
        raise ValueError(f"map cells: need at least 2 x 2, got {cells.shape}")
    if not (math.isfinite(resolution_m) and resolution_m > 0.0):
        raise ValueError(f"map resolution: must be positive, got {resolution_m}")
    occupied = cells >= OCCUPIED
    window = _around(occupied, math.ceil(max_distance_m / resolution_m) + 1)
    occupied = occupied[window]
    corner = SE2(window[1].start * resolution_m, window[0].start * resolution_m, 0.0)
    if window[0].start or window[1].start:
        map_from_grid = map_from_grid @ corner
    distance_m, cell_m = _signed_distance(
        occupied.tobytes(), occupied.shape, resolution_m, wall_inset_cells
    )
    distance_m = np.clip(distance_m, -max_distance_m, max_distance_m).astype(np.float32)
    hit = portable_kernels.exp_each(-0.5 * portable.square(distance_m / np.float32(sigma_hit_m)))
    hit /= math.sqrt(2 * math.pi) * sigma_hit_m
    log_likelihood = portable_kernels.log_each(z_hit * hit + z_rand / range_max_m).astype(
        np.float32
    )
    least = float(log_likelihood.min())
    return LikelihoodField(distance_m, log_likelihood, least, cell_m, map_from_grid)


def _around(occupied: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """Rows and columns of all occupied cells and a margin; of the first cell in an empty map."""
    found = []
    for axis in (1, 0):
        taken = np.flatnonzero(occupied.any(axis))
        count = occupied.shape[1 - axis]
        first, last = (int(taken[0]), int(taken[-1])) if len(taken) else (0, 0)
        found.append(slice(max(0, first - margin), min(count, last + margin + 1)))
    return found[0], found[1]


# Nearly all of a table's cost. A reset uses the same map again.
@functools.lru_cache(maxsize=2)
def _signed_distance(
    occupied_bytes: bytes, shape: tuple[int, int], resolution_m: float, wall_inset_cells: float
) -> tuple[NDArray[np.float32], float]:
    factor = max(1, min(8, round(resolution_m / TABLE_CELL_M)))
    rows, columns = shape
    factor = max(1, min(factor, math.isqrt(MAX_TABLE_CELLS // (rows * columns))))
    occupied = np.frombuffer(occupied_bytes, np.bool_).reshape(shape).astype(np.float32)
    # Interpolating before the threshold turns the stairs of slanted walls into slopes and leaves
    # the edges of the others on the border of their cells.
    without_ipp()
    fine = cv2.resize(occupied, (columns * factor, rows * factor), interpolation=cv2.INTER_LINEAR)
    # A whole number over (2 factor)^2, at most 256, up to rounding, which varies with processors.
    wall = fine >= 0.499
    if wall.all():
        wall[0, 0] = False
    # In a map without walls no distance is finite.
    to_wall, to_free = np.minimum(distance_cells(wall), MAX_CELLS), distance_cells(~wall)
    # Both are from centre to centre; the border is half a cell before the other kind's centre.
    signed = np.where(wall, 0.5 - to_free, to_wall - 0.5)
    cell_m = resolution_m / factor
    distance_m = np.asarray(signed * cell_m, np.float32)
    along_y, along_x = np.gradient(distance_m, cell_m)
    steepness = np.maximum(portable.hypot_each(along_x, along_y), 1e-6)
    # A square cell reaches further out of a slanted wall than of one along its sides.
    inset = wall_inset_cells * resolution_m * (np.abs(along_x) + np.abs(along_y)) / steepness
    return np.asarray(distance_m + inset, np.float32), cell_m

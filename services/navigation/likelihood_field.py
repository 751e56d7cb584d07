"""The likelihood field of a map: how probable a lidar return is at each place.

After Thrun, Burgard, Fox, Probabilistic Robotics (2005), section 6.4, with two differences. Returns
come from the faces of walls, so the distance is signed and zero where a face most probably lies in
its cells. And the tables are finer than the map, so that a nearest look-up keeps a centimetre.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from services.common.frames import SE2
from services.common.grids import distance_cells

OCCUPIED = 50
"""Cells from this value on are walls; ROS maps hold 0 free to 100 occupied, -1 unknown."""

TABLE_CELL_M = 0.0125
"""Size of a table's cell at best: about the noise of one lidar return."""


@dataclass(frozen=True)
class LikelihoodField:
    """Tables over the map, (rows, columns) float32, row 0 at the smallest y of the map's axes."""

    distance_m: NDArray[np.float32]
    """Distance to the nearest face of a wall; negative inside walls, and limited."""
    log_likelihood: NDArray[np.float32]
    """Logarithm of a return's probability density, in 1/m, at that place."""
    least_log_likelihood: float
    """The same off the map"""
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
    face lies `wall_inset_cells` inside its occupied cells.

    Raises ValueError where the map holds no wall, or its size or resolution is unusable.
    """
    if cells.ndim != 2 or min(cells.shape) < 2:
        raise ValueError(f"map cells: need at least 2 x 2, got {cells.shape}")
    if not (math.isfinite(resolution_m) and resolution_m > 0.0):
        raise ValueError(f"map resolution: must be positive, got {resolution_m}")
    occupied = cells >= OCCUPIED
    if not occupied.any():
        raise ValueError("map cells: no cell is occupied, so there is nothing to localise by")
    distance_m, cell_m = _signed_distance(
        occupied.tobytes(), occupied.shape, resolution_m, wall_inset_cells
    )
    distance_m = np.clip(distance_m, -max_distance_m, max_distance_m).astype(np.float32)
    hit = np.exp(-0.5 * (distance_m / sigma_hit_m) ** 2) / (math.sqrt(2 * math.pi) * sigma_hit_m)
    log_likelihood = np.log(z_hit * hit + z_rand / range_max_m).astype(np.float32)
    least = float(log_likelihood.min())
    return LikelihoodField(distance_m, log_likelihood, least, cell_m, map_from_grid)


# Nearly all that a table costs. A reset begins with the same map again.
@functools.lru_cache(maxsize=2)
def _signed_distance(
    occupied_bytes: bytes, shape: tuple[int, int], resolution_m: float, wall_inset_cells: float
) -> tuple[NDArray[np.float32], float]:
    factor = max(1, min(8, round(resolution_m / TABLE_CELL_M)))
    rows, columns = shape
    occupied = np.frombuffer(occupied_bytes, np.bool_).reshape(shape).astype(np.float32)
    # Interpolating before the threshold turns the stairs of slanted walls into slopes and leaves
    # the edges of the others on the border of their cells.
    fine = cv2.resize(occupied, (columns * factor, rows * factor), interpolation=cv2.INTER_LINEAR)
    wall = fine >= 0.5
    if wall.all():
        wall[0, 0] = False
    to_wall, to_free = distance_cells(wall), distance_cells(~wall)
    # Both count from centre to centre; the border lies half a cell before the other kind's first.
    signed = np.where(wall, 0.5 - to_free, to_wall - 0.5)
    cell_m = resolution_m / factor
    distance_m = np.asarray(signed * cell_m, np.float32)
    along_y, along_x = np.gradient(distance_m, cell_m)
    steepness = np.maximum(np.hypot(along_x, along_y), 1e-6)
    # A square cell reaches further out of a slanted wall than of one along its sides.
    inset = wall_inset_cells * resolution_m * (np.abs(along_x) + np.abs(along_y)) / steepness
    return np.asarray(distance_m + inset, np.float32), cell_m

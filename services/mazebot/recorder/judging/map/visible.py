"""Which faces a lidar can see from many places, on a raster of solid cells."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Mask

EVERY_M = 0.2
"""Distance between the places to look from."""
LEAST_ANGLE_RAD = math.radians(10.0)
"""Between a beam and a face that it can see: a flatter one passes by it within a cell."""
_BEFORE_CELLS = 1.5
"""Beams end this far before a face, beyond the cells that it touches."""


def visible_faces(
    solid: Mask, standing: Mask, points: Array, normals: Array, range_cells: float, every: int
) -> Mask:
    """(n,): whether a face is seen from a cell of `standing`, without a solid one between.

    Args:
        solid: (rows, columns).
        standing: (rows, columns); of these, one in each square of `every` cells is looked from.
        points: (n, 2) middles of the faces, x and y in cells from the corner of cell (0, 0).
        normals: (n, 2) of the faces, unit vectors out of what is solid.
        range_cells: how far the lidar sees.
        every: side of the squares, cells.
    """
    rows, columns = np.nonzero(standing)
    squares = rows // every * (solid.shape[1] // every + 1) + columns // every
    _, first = np.unique(squares, return_index=True)
    seen = np.zeros(len(points), np.bool_)
    _look(
        np.ascontiguousarray(solid),
        np.stack([columns[first], rows[first]], axis=1).astype(np.float64) + 0.5,
        np.ascontiguousarray(points + _BEFORE_CELLS * normals),
        np.ascontiguousarray(normals),
        range_cells,
        math.sin(LEAST_ANGLE_RAD),
        seen,
    )
    return seen


@kernel(
    "void(boolean[:,::1], float64[:,::1], float64[:,::1], float64[:,::1], float64, float64,"
    " boolean[::1])"
)
def _look(
    solid: Mask,
    places: Array,
    points: Array,
    normals: Array,
    range_cells: float,
    least_sine: float,
    seen: NDArray[np.bool_],
) -> None:
    """Look from each point to the places, cell by cell along the ray (Amanatides and Woo,
    Eurographics 1987).
    """
    rows, columns = solid.shape
    for index in range(len(points)):
        x, y = points[index]
        for place in range(len(places)):
            along, up = places[place, 0] - x, places[place, 1] - y
            length = math.sqrt(along * along + up * up)
            if length > range_cells or length == 0.0:
                continue
            if along * normals[index, 0] + up * normals[index, 1] < least_sine * length:
                continue
            column, row = int(x), int(y)
            last_column, last_row = int(places[place, 0]), int(places[place, 1])
            step_x, step_y = (1 if along > 0.0 else -1), (1 if up > 0.0 else -1)
            per_column = 1.0 / abs(along) if along != 0.0 else 1e300
            per_row = 1.0 / abs(up) if up != 0.0 else 1e300
            next_column = per_column * ((column + 1 - x) if along > 0.0 else (x - column))
            next_row = per_row * ((row + 1 - y) if up > 0.0 else (y - row))
            is_free = True
            while True:
                if row < 0 or row >= rows or column < 0 or column >= columns or solid[row, column]:
                    is_free = False
                    break
                if row == last_row and column == last_column:
                    break
                if min(next_column, next_row) > 1.0:
                    break
                if next_column < next_row:
                    column += step_x
                    next_column += per_column
                else:
                    row += step_y
                    next_row += per_row
            if is_free:
                seen[index] = True
                break

"""The cells of a grid that a polygon covers or cuts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely

from mazebot.common.world.costmap import Mask

_EDGE_CELLS: Final = 1e-6
"""A polygon that ends on the side of a cell does not reach into it."""


def polygon_cells(corners: Sequence[tuple[float, float]], rows: int, columns: int) -> Mask:
    """(rows, columns) cells that a polygon covers or cuts: one thinner than a cell is not lost.

    `corners` are (column, row) from the outer corner of cell (0, 0).
    """
    cells = np.zeros((rows, columns), np.bool_)
    area: shapely.Geometry = shapely.Polygon(corners)
    if not area.is_valid:
        area = shapely.make_valid(area)
    left, low, right, top = area.bounds
    across = np.arange(max(math.floor(left), 0), min(math.floor(right) + 1, columns))
    up = np.arange(max(math.floor(low), 0), min(math.floor(top) + 1, rows))
    if not across.size or not up.size:
        return cells
    shapely.prepare(area)
    x, y = np.meshgrid(across, up)
    squares = shapely.box(
        x + _EDGE_CELLS, y + _EDGE_CELLS, x + 1.0 - _EDGE_CELLS, y + 1.0 - _EDGE_CELLS
    )
    cells[up[0] : up[-1] + 1, across[0] : across[-1] + 1] = shapely.intersects(area, squares)
    return cells

"""Transforms of a grid of cells, with the same bits on every machine."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.opencv import without_ipp

MAX_CELLS = 2048.0
"""The largest distance returned. Up to it OpenCV's single-precision error is less than half of one
in the squared distance, which is a whole number.
"""


def distance_cells(solid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(rows, columns) distance from each cell's centre to that of the nearest solid one, in cells,
    at most MAX_CELLS; infinite where no cell is solid.
    """
    if not solid.any():
        return np.full(solid.shape, np.inf)
    free = np.ascontiguousarray(~solid).view(np.uint8)
    # Exact except for the last bits, which depend on threads and memory; rounding the squares
    # removes these.
    without_ipp()
    distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    squared = portable.square(np.minimum(distance, MAX_CELLS).astype(np.float64))
    return np.asarray(np.sqrt(np.rint(squared)), np.float64)


def connected_regions(where: NDArray[np.bool_], *, diagonally: bool = False) -> NDArray[np.int32]:
    """(rows, columns), the number, from 1, of each cell's region, connected over the sides of
    cells, or `diagonally` over their corners too; 0 elsewhere.
    """
    cells = np.ascontiguousarray(where).view(np.uint8)
    _, regions = cv2.connectedComponents(cells, connectivity=8 if diagonally else 4)
    return np.asarray(regions, np.int32)

"""The inflation layer: cost by the distance to the nearest lethal cell, as Nav2 computes it.

Distances are whole squares of cells up to a limit, so that windows of a grid can be updated, layers
can be combined by the smaller one, and every processor gets the same.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths import portable_kernels
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Clearance, Mask
from mazebot.navigation.costmap.costmap import (
    INSCRIBED_INFLATED_OBSTACLE,
    LETHAL_OBSTACLE,
    MAX_NON_OBSTACLE,
    NO_INFORMATION,
    Costmap,
    Costs,
    GridFrame,
)
from mazebot.navigation.costmap.footprint import WAFFLE

Squares = NDArray[np.int32]
Window = tuple[int, int, int, int]
"""First row, row after the last, first column, column after the last."""

DISTANCE_LIMIT_M: Final = 1.0
"""Distances are computed at least up to this."""
_MOST_CELLS: Final = 400
"""And no farther than this many cells."""


class InflationParams(Params):
    """How the cost falls with the distance from an obstacle; names as in Nav2's inflation layer."""

    inflation_radius: float = Field(
        0.7, gt=0, description="m; cells nearer than this to an obstacle have a cost"
    )
    cost_scaling_factor: float = Field(
        7.0, gt=0, description="1/m; how fast the cost decays with the distance from an obstacle"
    )
    custom_inscribed_radius: float = Field(
        WAFFLE.half_width_m,
        ge=0,
        description="m; up to this distance a cell costs 253. The half width of a robot that "
        "drives forwards: it passes nothing narrower, wherever its axle is",
    )
    inflate_unknown: bool = Field(False, description="whether unknown cells get a cost")


class Inflation:
    """Tables of distance and cost by the squared distance in cells, for one resolution."""

    def __init__(self, params: InflationParams, resolution_m: float) -> None:
        self.inscribed_radius_m = params.custom_inscribed_radius
        self.inflate_unknown = params.inflate_unknown
        limit_m = max(DISTANCE_LIMIT_M, params.inflation_radius, params.custom_inscribed_radius)
        self.reach = min(math.ceil(limit_m / resolution_m - 1e-6) + 1, _MOST_CELLS)
        """Cells up to which distances are exact."""
        far = self.reach * self.reach
        squares = np.arange(far + 1, dtype=np.float64)
        self.distance_m: Clearance = np.asarray(np.sqrt(squares) * resolution_m, np.float32)
        """(reach^2 + 1,) metres."""
        distance_m = self.distance_m.astype(np.float64)
        beyond_m = distance_m - params.custom_inscribed_radius
        fall = MAX_NON_OBSTACLE * portable_kernels.exp_each(-params.cost_scaling_factor * beyond_m)
        fall = np.minimum(fall, float(MAX_NON_OBSTACLE))
        cost = np.where(self.distance_m <= params.inflation_radius, fall, 0.0).astype(np.uint8)
        cost[beyond_m <= 0.0] = INSCRIBED_INFLATED_OBSTACLE
        cost[0] = LETHAL_OBSTACLE
        self.cost: Costs = cost
        """(reach^2 + 1,) costs."""

    def squares(self, lethal: Mask) -> Squares:
        """(rows, columns) squared distance of each cell from the nearest lethal one, at most
        reach^2.
        """
        rows, columns = lethal.shape
        squares = np.empty(lethal.shape, np.int32)
        _square_distances(lethal, 0, rows, 0, columns, self.reach, squares)
        return squares


@kernel()
def _square_distances(
    lethal: Mask, row0: int, row1: int, column0: int, column1: int, reach: int, out: Squares
) -> None:
    """Exact squared distances of the cells of a window from the lethal cells inside it, at most
    reach^2; `out` has the window's shape.
    """
    far = np.int32(reach * reach)
    height, width = row1 - row0, column1 - column0
    steps = np.full((height, width), np.int32(reach), np.int32)
    occupied = np.zeros(height, np.bool_)
    for r in range(height):
        for c in range(width):
            if lethal[row0 + r, column0 + c]:
                steps[r, c] = 0
                occupied[r] = True
    if not occupied.any():
        out[:] = far
        return
    # Up and down the columns, then across the rows; every inner loop runs along a row.
    for r in range(1, height):
        for c in range(width):
            steps[r, c] = min(steps[r, c], steps[r - 1, c] + 1)
    for r in range(height - 2, -1, -1):
        for c in range(width):
            steps[r, c] = min(steps[r, c], steps[r + 1, c] + 1)
    padded = np.full(width + 2 * reach, far, np.int32)
    for r in range(height):
        near = False
        for c in range(width):
            padded[reach + c] = steps[r, c] * steps[r, c]
            near |= steps[r, c] < reach
        if not near:
            out[r, :] = far
            continue
        best = out[r]
        for c in range(width):
            best[c] = min(padded[reach + c], far)
        for across in range(1, reach):
            square = np.int32(across * across)
            left, right = padded[reach - across :], padded[reach + across :]
            for c in range(width):
                best[c] = min(best[c], min(left[c], right[c]) + square)


@kernel()
def compose(
    costs: Costs,
    distance_m: Clearance,
    static_squares: Squares,
    base_costs: Costs,
    zone_costs: Costs,
    marked: Mask,
    cost_table: Costs,
    distance_table_m: Clearance,
    reach: int,
    inflate_unknown: bool,
    row0: int,
    row1: int,
    column0: int,
    column1: int,
) -> None:
    """Write costs and distances of a window from all layers.

    Args:
        costs: (rows, columns), written.
        distance_m: (rows, columns), written.
        static_squares: (rows, columns), squared distances from the static layer's lethal cells.
        base_costs: (rows, columns), the static layer's costs.
        zone_costs: (rows, columns), a filter's costs, or empty.
        marked: (rows, columns), lethal cells of the obstacle layer.
        cost_table: cost by squared distance.
        distance_table_m: distance by squared distance.
        reach: cells up to which distances are exact.
        inflate_unknown: whether any cost replaces "unknown", or only that of a collision.
        row0: first row of the window.
        row1: the row after its last.
        column0: first column.
        column1: the column after its last.
    """
    rows, columns = costs.shape
    # The cells around the window count too.
    top, bottom = max(row0 - reach, 0), min(row1 + reach, rows)
    left, right = max(column0 - reach, 0), min(column1 + reach, columns)
    squares = np.empty((bottom - top, right - left), np.int32)
    _square_distances(marked, top, bottom, left, right, reach, squares)
    zones = zone_costs.size > 0
    for r in range(row0, row1):
        for c in range(column0, column1):
            square = min(squares[r - top, c - left], static_squares[r, c])
            distance_m[r, c] = distance_table_m[square]
            cost = cost_table[square]
            base = base_costs[r, c]
            if base == NO_INFORMATION:
                if cost < INSCRIBED_INFLATED_OBSTACLE and not (inflate_unknown and cost > 0):
                    cost = base
            elif base > cost:
                cost = base
            if zones:
                zone = zone_costs[r, c]
                if zone > 0 and (cost == NO_INFORMATION or zone > cost):
                    cost = zone
            costs[r, c] = cost


def inflate(frame: GridFrame, lethal: Mask, unknown: Mask, params: InflationParams) -> Costmap:
    """Costmap of (rows, columns) masks of lethal and unknown cells.

    Nav2's inflation: 253 up to the inscribed radius from a lethal cell, then
    252 exp(-cost_scaling_factor (d - inscribed_radius)) out to the inflation radius. Unknown cells
    stay unknown where they cost less than 253.
    """
    inflation = Inflation(params, frame.resolution_m)
    base = np.where(unknown, np.uint8(NO_INFORMATION), np.uint8(0))
    squares = inflation.squares(lethal)
    costs, distance_m = np.empty(lethal.shape, np.uint8), np.empty(lethal.shape, np.float32)
    compose(
        costs, distance_m, squares, base, np.empty((0, 0), np.uint8),
        np.zeros(lethal.shape, np.bool_), inflation.cost, inflation.distance_m, inflation.reach,
        inflation.inflate_unknown, 0, frame.rows, 0, frame.columns,
    )  # fmt: skip
    return Costmap(frame, params.custom_inscribed_radius, costs, distance_m)

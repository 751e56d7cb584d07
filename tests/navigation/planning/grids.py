"""Costmaps for the tests of planning, and what is true of paths on them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array
from mazebot.navigation.costmap.layered_costmap import Costmap, InflationParams, frame_of, inflate
from mazebot.navigation.planning.planner import GridPlannerParams, PlannerParams

RESOLUTION_M = 0.05
PARAMS = PlannerParams(
    GridPlannerParams(cost_travel_multiplier=1.0, max_iterations=1_000_000, start_tolerance=0.5),
    path_spacing_m=RESOLUTION_M,
    smoothing_iterations=100,
)


def weighing(**settings: float) -> PlannerParams:
    """PARAMS with other settings."""
    return replace(PARAMS, settings=PARAMS.settings.model_copy(update=settings))


Solid = NDArray[np.bool_]


def costmap_of(
    solid: Solid, radius_m: float = 0.0, unknown: Solid | None = None, inflation_m: float = 0.7
) -> Costmap:
    """The costmap of (rows, columns) obstacles, with the map's origin in its corner."""
    frame = frame_of(RESOLUTION_M, SE2(0.0, 0.0, 0.0), solid.astype(np.int8))
    none = np.zeros_like(solid)
    unknown = none if unknown is None else unknown
    return inflate(
        frame,
        solid,
        unknown,
        InflationParams(
            custom_inscribed_radius=radius_m, inflation_radius=inflation_m, cost_scaling_factor=10.0
        ),
    )


def pose(costmap: Costmap, row: int, column: int, yaw_rad: float = 0.0) -> SE2:
    """The middle of a cell."""
    return SE2(*costmap.frame.center(row, column), yaw_rad)


def touched_cells(points_m: Array, samples_per_cell: int = 50) -> set[tuple[int, int]]:
    """Cells on a polyline, by sampling it finely."""
    cells = set()
    for a, b in pairwise(points_m):
        count = max(1, int(np.linalg.norm(b - a) / RESOLUTION_M * samples_per_cell))
        shares = (np.arange(count) + 0.5)[:, None] / count
        for x, y in a + (b - a) * shares:
            cells.add((int(y / RESOLUTION_M), int(x / RESOLUTION_M)))
    return cells


def random_costs(seed: int, side: int, share: float) -> Costmap:
    """Random obstacles, and random costs instead of those of inflation."""
    random = np.random.default_rng(seed)
    costmap = costmap_of(random.random((side, side)) < share)
    costs = random.integers(0, 253, (side, side)).astype(np.uint8)
    return Costmap(
        costmap.frame, 0.0, np.where(costmap.costs == 254, 254, costs).astype(np.uint8),
        costmap.distance_m,
    )  # fmt: skip

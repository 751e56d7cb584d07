"""Where all free cells cost the same, any-angle paths are the shortest there are."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely

from mazebot.bench.parts.planning_maps import KINDS, random_obstacles
from mazebot.common.maths.frames import Array
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.grid.anya import anya
from mazebot.navigation.planning.grid.search_grid import NARROW, search_grid
from mazebot.navigation.planning.planner import Planner
from tests.navigation.planning.grids import RESOLUTION_M, Solid, costmap_of, pose, weighing

SIDE = 20
Point = tuple[float, float]


def visibility_optimum(solid: Solid, start: Point, goal: Point) -> float:
    """Length of the shortest path in cells, by Dijkstra over all corners in sight of each other;
    obstacles are smaller by a ten-thousandth, and joined where two of them meet.
    """
    small = 1e-4
    around = np.pad(solid, 1, constant_values=True)
    boxes, corners = [], []
    rows, columns = around.shape
    for r, c in np.argwhere(around):
        boxes.append(shapely.box(c + small, r + small, c + 1 - small, r + 1 - small))
        for up, along in ((0, 1), (1, 0)):
            if r + up < rows and c + along < columns and around[r + up, c + along]:
                boxes.append(
                    shapely.box(
                        c + along - small * (2 * along - 1), r + up - small * (2 * up - 1),
                        c + 1 + along * small - up * small, r + 1 + up * small - along * small,
                    )
                )  # fmt: skip
    for r in range(1, rows):
        for c in range(1, columns):
            four = around[r - 1 : r + 1, c - 1 : c + 1]
            if four.sum() == 1:
                corners.append((float(c), float(r)))
            if four.sum() == 2 and four[0, 0] == four[1, 1]:
                boxes.append(
                    shapely.box(c - 2 * small, r - 2 * small, c + 2 * small, r + 2 * small)
                )
    obstacles = shapely.union_all(boxes)
    shapely.prepare(obstacles)
    points = np.array([start, goal, *corners]) + 1.0
    points[2:] -= 1.0
    a, b = np.triu_indices(len(points), 1)
    lines = shapely.linestrings(np.stack([points[a], points[b]], axis=1))
    lengths = np.where(shapely.intersects(obstacles, lines), math.inf, shapely.length(lines))
    steps = np.full((len(points), len(points)), math.inf)
    steps[a, b] = steps[b, a] = lengths
    best = np.full(len(points), math.inf)
    best[0] = 0.0
    waiting = set(range(len(points)))
    while waiting:
        nearest = min(waiting, key=lambda i: best[i])
        waiting.remove(nearest)
        best = np.minimum(best, best[nearest] + steps[nearest])
    return float(best[1])


def searched(solid: Solid, start: Point, goal: Point) -> Array | None:
    grid = search_grid(costmap_of(solid), 0.0, allow_unknown=False)
    left, right = np.empty((2, *grid.cells.shape), np.int32)
    best = np.empty(grid.cells.size, np.float32)
    status, corners = anya(
        grid.cells, NARROW, left, right, start[0] + 1.0, start[1] + 1.0, goal[0] + 1.0,
        goal[1] + 1.0, 10**6, 8.0, best,
    )  # fmt: skip
    return corners if status == 0 else None


def length(points: Array) -> float:
    return float(sum(np.linalg.norm(b - a) for a, b in pairwise(points)))


@pytest.mark.parametrize("share", [0.1, 0.25, 0.4])
@pytest.mark.parametrize("seed", range(2))
def test_no_path_is_shorter(share: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    solid = random_obstacles(SIDE, random, share)
    free = np.argwhere(~solid)[:, ::-1]
    reached = 0
    for _ in range(4):
        # Anywhere in their cells.
        one, other = free[random.integers(0, len(free), 2)] + random.random((2, 2))
        optimum = visibility_optimum(solid, tuple(one), tuple(other))
        corners = searched(solid, tuple(one), tuple(other))
        if corners is None:
            assert math.isinf(optimum)
            continue
        assert length(corners) == pytest.approx(optimum, rel=1e-4)
        reached += 1
    assert reached or share > 0.3


def test_two_cells_that_meet_corner_to_corner_leave_no_gap() -> None:
    solid = np.zeros((6, 6), bool)
    solid[:3, 2] = solid[3:, 3] = True
    assert searched(solid, (0.5, 0.5), (5.5, 5.5)) is None
    solid[5, 3] = False
    assert searched(solid, (0.5, 0.5), (5.5, 5.5)) is not None


@pytest.mark.parametrize("kind", KINDS)
def test_a_planned_path_is_the_shortest_to_half_a_percent(kind: str) -> None:
    random = np.random.default_rng(4)
    solid = KINDS[kind](SIDE, random)
    costmap = costmap_of(solid)
    planner = Planner(weighing(cost_travel_multiplier=0.0))
    free = np.argwhere(~solid)
    ratios = []
    for _ in range(5):
        one, other = free[random.integers(0, len(free), 2)]
        if np.abs(one - other).sum() < 3:
            continue
        try:
            path = planner.plan(costmap, pose(costmap, *one), pose(costmap, *other))
        except NavigationError:
            continue
        ends = [(float(at[1]) + 0.5, float(at[0]) + 0.5) for at in (one, other)]
        ratios.append(path.length_m / RESOLUTION_M / visibility_optimum(solid, *ends))
    assert ratios
    assert max(ratios) < 1.005
    assert min(ratios) > 0.9999

"""The kernels: the search is optimal, lines are exact, regions are told apart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from mazebot.common.maths.frames import Array
from mazebot.common.world.grids import connected_regions
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.planning.grid.a_star import (
    FOUND,
    GAVE_UP,
    NO_WAY,
    Workspace,
    a_star,
    buckets_for,
)
from mazebot.navigation.planning.grid.lines import line_cost
from mazebot.navigation.planning.grid.regions import OF_GOAL, OF_START, Regions, thinnest_place
from mazebot.navigation.planning.grid.search_grid import (
    BORDER,
    NARROW,
    NO_PRICE,
    SOLID,
    SearchGrid,
    prices,
    search_grid,
)
from tests.navigation.planning.grids import costmap_of, random_costs

NOTHING_FIXED = np.empty((0, 0), np.uint8)


def optima(grid: SearchGrid, weight: float, start: int) -> Array:
    """Costs of the best 8-connected ways to each cell that cut no corners, by SciPy."""
    cells = grid.cells
    free = cells < NARROW
    stride = cells.shape[1]
    price = 1.0 + weight * cells.astype(np.float64) / 252.0
    rows, columns = np.nonzero(free)
    a, b, cost = [], [], []
    for up, along in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        to_row, to_column = rows + up, columns + along
        fits = free[to_row, to_column] & free[rows, to_column] & free[to_row, columns]
        r, c = rows[fits], columns[fits]
        a.append(r * stride + c)
        b.append((r + up) * stride + c + along)
        cost.append(math.hypot(up, along) * 0.5 * (price[r, c] + price[r + up, c + along]))
    graph = coo_matrix(
        (np.concatenate(cost), (np.concatenate(a), np.concatenate(b))), (cells.size, cells.size)
    )
    return np.asarray(dijkstra(graph.tocsr(), indices=start))


def searched(grid: SearchGrid, weight: float, start: int, goal: int, most: int = 10**9) -> float:
    kept, price = Workspace(), prices(weight)
    kept.fit(grid.cells.size)
    status, _ = a_star(
        grid.cells, NARROW, price, start, goal, most, 8.0, buckets_for(price, 8.0), 1.0, 0.0,
        kept.cost_to_come, kept.came_from,
    )  # fmt: skip
    if status == GAVE_UP:
        return math.nan
    return math.inf if status == NO_WAY else float(kept.cost_to_come[goal])


@pytest.mark.parametrize("weight", [0.0, 1.0, 5.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_search_finds_the_optimum(weight: float, seed: int) -> None:
    grid = search_grid(random_costs(seed, 40, 0.25), 0.0, allow_unknown=False)
    free = np.flatnonzero(grid.cells < NARROW)
    random = np.random.default_rng(seed)
    start = int(random.choice(free))
    best = optima(grid, weight, start)
    for goal in random.choice(free, 25):
        assert searched(grid, weight, start, int(goal)) == pytest.approx(best[goal], rel=1e-3)


def test_a_search_ends_after_so_many_cells() -> None:
    grid = search_grid(costmap_of(np.zeros((40, 40), bool)), 0.0, allow_unknown=False)
    assert math.isnan(searched(grid, 0.0, 43, 1600, most=10))


def test_unknown_cells_are_solid_unless_allowed() -> None:
    unknown = np.zeros((3, 3), bool)
    unknown[:, 1] = True
    costmap = costmap_of(np.zeros((3, 3), bool), unknown=unknown)
    assert search_grid(costmap, 0.0, allow_unknown=False).cells[2, 2] == SOLID
    allowed = search_grid(costmap, 0.0, allow_unknown=True).cells
    assert allowed[2, 2] == 252
    assert (allowed[0] == BORDER).all()


def test_cells_too_near_for_the_robots_width_are_narrow() -> None:
    solid = np.zeros((9, 9), bool)
    solid[4, 4] = True
    cells = search_grid(costmap_of(solid), 0.12, allow_unknown=False).cells
    assert cells[5, 7] == NARROW
    assert cells[5, 8] < NARROW


def test_a_line_costs_the_lengths_in_its_cells() -> None:
    random = np.random.default_rng(3)
    cells = np.full((22, 22), BORDER, np.uint8)
    cells[1:-1, 1:-1] = random.integers(0, 253, (20, 20))
    price = prices(2.0)
    for x0, y0, x1, y1 in 0.6 + 19.8 * random.random((50, 4)):
        shares = (np.arange(20_000) + 0.5) / 20_000
        x, y = x0 + (x1 - x0) * shares, y0 + (y1 - y0) * shares
        sampled = 2.0 * price[cells[(y + 0.5).astype(int), (x + 0.5).astype(int)]].mean()
        expected = sampled * math.hypot(x1 - x0, y1 - y0)
        assert line_cost(cells, NARROW, price, x0, y0, x1, y1, math.inf) == pytest.approx(
            expected, rel=2e-3
        )
        assert line_cost(cells, NARROW, price, x0, y0, x1, y1, 0.9 * expected) == math.inf


@pytest.mark.parametrize("blocked", [(2, 3), (3, 2)])
def test_a_line_through_a_corner_touches_both_cells_beside_it(blocked: tuple[int, int]) -> None:
    cells = np.zeros((6, 6), np.uint8)
    assert line_cost(cells, NARROW, NO_PRICE, 2.0, 2.0, 3.0, 3.0, math.inf) == math.sqrt(2.0)
    cells[blocked] = SOLID
    assert line_cost(cells, NARROW, NO_PRICE, 2.0, 2.0, 3.0, 3.0, math.inf) == math.inf


def test_a_line_that_only_clips_a_cell_is_blocked_by_it() -> None:
    cells = np.zeros((8, 12), np.uint8)
    cells[3, 5] = SOLID
    # It is in the cell for a fiftieth of a cell's side.
    assert line_cost(cells, NARROW, NO_PRICE, 1.0, 2.0, 9.02, 4.0, math.inf) == math.inf
    assert line_cost(cells, NARROW, NO_PRICE, 1.0, 1.0, 9.0, 3.0, math.inf) < math.inf


def walled() -> Costmap:
    """Two rooms with a wall of 4 cells between them, 2 cells thin at row 12."""
    solid = np.zeros((20, 24), bool)
    solid[:, 10:14] = True
    solid[12, 10:12] = False
    return costmap_of(solid)


@pytest.mark.parametrize("seed", range(3))
def test_regions_are_those_that_cells_beside_each_other_make(seed: int) -> None:
    # At this share of solid cells there are many regions, some of them large and entangled.
    grid = search_grid(random_costs(seed, 60, 0.42), 0.0, allow_unknown=False)
    expected = connected_regions(grid.cells < NARROW).ravel()
    regions = Regions()
    regions.find(grid.cells)
    found = np.array([regions.at(cell) for cell in range(grid.cells.size)])
    assert ((found >= 0) == (expected > 0)).all()
    pairs = set(zip(found[found >= 0].tolist(), expected[expected > 0].tolist(), strict=True))
    assert len(pairs) == len(set(found[found >= 0])) == expected.max()
    marks = np.zeros(grid.cells.size, np.uint8)
    largest = int(np.bincount(found[found >= 0]).argmax())
    assert regions.mark(largest, OF_GOAL, marks) == np.count_nonzero(found == largest)
    assert ((marks == OF_GOAL) == (found == largest)).all()


def test_regions_of_a_smaller_grid_are_found_with_the_same_memory() -> None:
    regions = Regions()
    regions.find(search_grid(random_costs(0, 60, 0.4), 0.0, allow_unknown=False).cells)
    regions.find(search_grid(walled(), 0.0, allow_unknown=False).cells)
    left, beside, right = (regions.at(cell) for cell in (5 * 26 + 3, 15 * 26 + 3, 5 * 26 + 20))
    assert left == beside != right
    assert regions.at(0) == -1


def test_open_space_is_not_expanded_over_and_over() -> None:
    # Thousands of ways across it cost the same, but for the rounding of their sums.
    grid = search_grid(costmap_of(np.zeros((900, 900), bool)), 0.0, allow_unknown=False)
    kept, price = Workspace(), prices(1.5)
    kept.fit(grid.cells.size)
    status, expanded = a_star(
        grid.cells, NARROW, price, 20 * 902 + 20, 650 * 902 + 880, 10**6, 64.0,
        buckets_for(price, 64.0), 1.0, 0.0, kept.cost_to_come, kept.came_from,
    )  # fmt: skip
    assert status == FOUND
    assert expanded < grid.cells.size / 4


@pytest.mark.parametrize("from_goal", [False, True])
def test_the_thinnest_place_of_a_wall_is_found(from_goal: bool) -> None:
    grid = search_grid(walled(), 0.0, allow_unknown=False)
    start, goal = 2 * 26 + 3, 2 * 26 + 20
    regions, marks = Regions(), np.zeros(grid.cells.size, np.uint8)
    regions.find(grid.cells)
    regions.mark(regions.at(start), OF_START, marks)
    regions.mark(regions.at(goal), OF_GOAL, marks)
    at = thinnest_place(grid.cells, NOTHING_FIXED, start, goal, 1, 3, from_goal, marks)
    assert divmod(at, 26) == (13, 13)
    # Where that cell cannot open, one beside it.
    fixed = grid.cells.copy()
    fixed[fixed == SOLID] = 0
    fixed[13, 13] = SOLID
    at = thinnest_place(grid.cells, fixed, start, goal, 1, 3, from_goal, marks)
    assert divmod(at, 26) in {(12, 12), (12, 13)}

"""Ways, view points, and the tour through them."""

import itertools
import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.world.costmap import Cells
from mazebot.explorer.choice import tour_through
from mazebot.explorer.exploration import Survey, aim, survey
from mazebot.explorer.floor import floor_from
from mazebot.explorer.params import ExplorerParams
from mazebot.explorer.paths import FAR, search, way
from tests.explorer.worlds import RESOLUTION_M, plan

ORIGIN = SE2(0.0, 0.0, 0.0)
PARAMS = ExplorerParams()
HALL = plan(
    "####################",
    "#..................#",
    "#..................#",
    "#..................#",
    "##...##########...##",
    "##???##########???##",
)


def surveyed(cells: Cells, robot: SE2, params: ExplorerParams = PARAMS) -> Survey:
    return survey(params, cells, RESOLUTION_M, ORIGIN, robot, robot)


def brute_force(prices: np.ndarray, source: int) -> np.ndarray:
    """Bellman and Ford's distances."""
    rows, columns = prices.shape
    far = np.full(prices.shape, math.inf)
    far[divmod(source, columns)] = 0
    changed = True
    while changed:
        changed = False
        for r, c in itertools.product(range(rows), range(columns)):
            if not prices[r, c] or far[r, c] == math.inf:
                continue
            for dr, dc in itertools.product((-1, 0, 1), repeat=2):
                a, b = r + dr, c + dc
                if (dr, dc) == (0, 0) or not (0 <= a < rows and 0 <= b < columns):
                    continue
                if not prices[a, b] or (dr and dc and not (prices[r, b] and prices[a, c])):
                    continue
                length = 141 if dr and dc else 100
                cost = far[r, c] + length * (prices[r, c] + prices[a, b]) // 32
                if cost < far[a, b]:
                    far[a, b], changed = cost, True
    return far


def test_ways_are_the_cheapest() -> None:
    random = np.random.default_rng(3)
    for _ in range(5):
        prices = random.integers(16, 90, (12, 15)).astype(np.int32)
        prices[random.random(prices.shape) < 0.3] = 0
        prices[4, 5] = 16
        distances, parents = search(prices, 4 * 15 + 5)
        wanted = brute_force(prices, 4 * 15 + 5)
        assert np.array_equal(np.where(distances == FAR, math.inf, distances), wanted)
        for to in np.flatnonzero(distances < FAR):
            cells = way(parents, int(to))
            assert cells[0] == 4 * 15 + 5
            assert (np.diff(distances.reshape(-1)[cells]) > 0).all()


def test_a_limited_search_finds_what_is_near_and_nothing_else() -> None:
    prices = np.full((9, 9), 16, np.int32)
    whole, _ = search(prices, 40)
    near, _ = search(prices, 40, 250)
    assert np.array_equal(near, np.where(whole <= 250, whole, FAR))


def test_a_tour_is_the_shortest() -> None:
    random = np.random.default_rng(5)
    for _ in range(20):
        places = random.random((8, 2)) * 1000.0
        offsets = places[:, None] - places[None]
        costs = np.sqrt((offsets * offsets).sum(2)).astype(np.int64)
        tour, length = tour_through(costs)
        assert tour[0] == 0
        assert tour[-1] == 7
        assert sorted(tour) == list(range(8))
        assert length == sum(costs[a, b] for a, b in itertools.pairwise(tour))
        best = min(
            sum(costs[a, b] for a, b in itertools.pairwise((0, *middle, 7)))
            for middle in itertools.permutations(range(1, 7))
        )
        assert length <= best * 1.05
        fixed, _ = tour_through(costs, 3)
        assert fixed[:2] == [0, 3]


def test_a_view_point_sees_what_it_is_for() -> None:
    seen = surveyed(HALL, SE2(5.0, 2.0, 0.0))
    assert len(seen.frontiers) == 2
    assert seen.unseen == []
    assert len(seen.points) == 2
    for point in seen.points:
        row, column = seen.floor.stand(point.index)
        assert seen.floor.reachable[row, column]
        assert seen.floor.clearance_m[row, column] >= PARAMS.view_clearance
        down, right = point.parts[0].middle()[0] - row, point.parts[0].middle()[1] - column
        assert math.hypot(down, right) * RESOLUTION_M <= PARAMS.max_range


def test_the_goal_is_near_the_frontier_and_has_room() -> None:
    seen = surveyed(HALL, SE2(5.0, 2.0, 0.0))
    chosen = aim(PARAMS, seen, SE2(1.5, 2.0, 0.0), None)
    assert chosen is not None
    row, column = seen.floor.cell(chosen.pose.x_m, chosen.pose.y_m)
    assert seen.floor.reachable[row, column]
    assert seen.floor.clearance_m[row, column] >= 0.25
    assert math.dist(chosen.pose[:2], chosen.target_m) < 2.0


@pytest.mark.parametrize(("home_x_m", "first_x_m"), [(1.5, 8.25), (8.5, 1.75)])
def test_the_tour_ends_at_home_so_that_what_is_near_home_comes_last(
    home_x_m: float, first_x_m: float
) -> None:
    seen = surveyed(HALL, SE2(5.0, 2.0, 0.0))
    chosen = aim(PARAMS, seen, SE2(home_x_m, 2.0, 0.0), None)
    assert chosen is not None
    assert chosen.target_m[0] == pytest.approx(first_x_m, abs=0.5)


def test_a_goal_is_kept_unless_another_is_clearly_better() -> None:
    home = SE2(5.0, 2.0, 0.0)
    params = PARAMS.model_copy(update={"choice": "gain", "gain_scale": 0.0})
    first = aim(params, surveyed(HALL, SE2(4.9, 2.0, 0.0)), home, None)
    assert first is not None
    assert first.target_m[0] < 5.0
    kept = aim(params, surveyed(HALL, SE2(5.1, 2.0, 0.0)), home, first)
    assert kept is not None
    assert kept.target_m[0] < 5.0
    left = aim(params, surveyed(HALL, SE2(6.5, 2.0, 0.0)), home, first)
    assert left is not None
    assert left.target_m[0] > 5.0


def test_a_rotated_map_gives_the_same_goals() -> None:
    robot, home = SE2(5.0, 2.0, 0.0), SE2(1.5, 2.0, 0.0)
    turn = SE2(0.3, -0.2, math.pi / 2)
    seen = surveyed(HALL, robot)
    turned = survey(PARAMS, HALL, RESOLUTION_M, turn @ ORIGIN, turn @ robot, turn @ robot)
    assert turned.floor.reachable_m2 == pytest.approx(seen.floor.reachable_m2, rel=0.01)
    one, two = aim(PARAMS, seen, home, None), aim(PARAMS, turned, turn @ home, None)
    assert one is not None
    assert two is not None
    assert (turn.inverse() @ two.pose).distance_m(one.pose) < 0.5


def test_a_robot_off_the_floor_has_nothing_to_see() -> None:
    seen = surveyed(np.full((40, 40), -1, np.int8), SE2(1.0, 1.0, 0.0))
    assert seen.robot is None
    assert aim(PARAMS, seen, ORIGIN, None) is None
    inside = floor_from(HALL, RESOLUTION_M, ORIGIN, SE2(-30.0, 0.0, 0.0), 0.24, 0.5)
    assert not inside.reachable.any()

from __future__ import annotations

import itertools
import math
from collections import Counter

import numpy as np
import pytest
import shapely
from scipy.sparse import coo_array, csgraph

from mazebot.worldgen.maze.maze import Maze, generate
from mazebot.worldgen.maze.spanning_tree import wilson
from mazebot.worldgen.recipe_model import MazeRecipe

ALGORITHMS = ["wilson", "recursive_backtracker", "rooms"]
THICKNESS_M = 0.15


def maze(**changes: object) -> Maze:
    return generate(MazeRecipe.model_validate(changes), THICKNESS_M)


def graph(one: Maze) -> coo_array:
    rows, columns = one.inside.shape
    cell = np.arange(rows * columns).reshape(rows, columns)
    right, up = one.right_open, one.up_open
    a = np.concatenate([cell[right], cell[up]])
    b = np.concatenate([cell[:, 1:][right[:, :-1]], cell[1:][up[:-1]]])
    return coo_array((np.ones(len(a)), (a, b)), shape=(cell.size, cell.size))


def footprint(one: Maze) -> list[shapely.Polygon]:
    boxes = []
    for wall in one.walls:
        x, y = wall.length_m / 2.0, THICKNESS_M / 2.0
        if wall.yaw_rad:
            x, y = y, x
        boxes.append(shapely.box(wall.x_m - x, wall.y_m - y, wall.x_m + x, wall.y_m + y))
    return boxes


@pytest.mark.parametrize("algorithm", ["wilson", "recursive_backtracker"])
@pytest.mark.parametrize("shape", [(2, 2), (2, 9), (7, 5), (30, 20)])
def test_a_perfect_maze_is_a_spanning_tree(algorithm: str, shape: tuple[int, int]) -> None:
    one = maze(algorithm=algorithm, rows=shape[0], columns=shape[1], seed=5)
    assert csgraph.connected_components(graph(one), directed=False)[0] == 1
    assert one.right_open.sum() + one.up_open.sum() == shape[0] * shape[1] - 1
    assert not one.right_open[:, -1].any()
    assert not one.up_open[-1].any()


def test_every_spanning_tree_is_as_likely() -> None:
    # It loads most of SciPy.
    from scipy import stats

    draws = 3000
    found = Counter(
        b"".join(bits.tobytes() for bits in wilson(2, 3, seed)) for seed in range(draws)
    )
    assert len(found) == 15, "spanning trees of a grid of 2 x 3, by Kirchhoff's theorem"
    assert stats.chisquare(list(found.values())).pvalue > 0.01


@pytest.mark.parametrize("algorithm", ["wilson", "recursive_backtracker"])
@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_braiding_opens_its_share_of_the_dead_ends(algorithm: str, share: float, seed: int) -> None:
    shape = {"algorithm": algorithm, "rows": 9, "columns": 11, "seed": seed}
    before, after = maze(**shape), maze(**shape, braiding=share)
    assert after.dead_ends == before.dead_ends - round(share * before.dead_ends)
    assert not (before.right_open & ~after.right_open).any()
    assert not (before.up_open & ~after.up_open).any()


@pytest.mark.parametrize("seed", range(4))
def test_rooms_are_all_connected_and_the_rest_is_walled_off(seed: int) -> None:
    one = maze(algorithm="rooms", rows=14, columns=18, seed=seed)
    _, labels = csgraph.connected_components(graph(one), directed=False)
    inside = one.inside.ravel()
    assert len(set(labels[inside])) == 1
    assert len(set(labels[~inside])) == (~inside).sum()
    assert 0 < inside.sum() < inside.size
    # A room has a cell all of whose sides are open.
    open_sides = one.right_open[1:-1, 1:-1] & one.right_open[1:-1, :-2]
    assert (open_sides & one.up_open[1:-1, 1:-1] & one.up_open[:-2, 1:-1]).any()


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("braiding", [0.0, 0.6])
def test_start_and_goal_are_the_ends_of_the_longest_shortest_way(
    algorithm: str, braiding: float
) -> None:
    one = maze(algorithm=algorithm, rows=8, columns=9, seed=2, braiding=braiding, cell_m=1.2)
    hops = csgraph.shortest_path(graph(one), directed=False, unweighted=True)
    assert len(one.way) - 1 == hops[np.isfinite(hops)].max()
    steps = np.diff(one.way, axis=0)
    assert (np.abs(steps).sum(1) == 1).all()
    cell = one.way[:, 0] * 9 + one.way[:, 1]
    both = (graph(one) + graph(one).T).toarray()
    assert both[cell[:-1], cell[1:]].all()
    assert (one.start.x_m, one.start.y_m) == (0.0, 0.0)
    row, column = (one.way[-1] - one.way[0]) * 1.2
    assert (one.goal.x_m, one.goal.y_m) == pytest.approx((column, row))
    for place, step in ((one.start, steps[0]), (one.goal, steps[-1])):
        assert (math.sin(place.yaw_rad), math.cos(place.yaw_rad)) == pytest.approx(tuple(step))
    assert one.turns == sum((a != b).any() for a, b in zip(steps[1:], steps[:-1], strict=True))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("braiding", [0.0, 1.0])
def test_walls_stand_around_every_passage_with_no_gap(algorithm: str, braiding: float) -> None:
    one = maze(algorithm=algorithm, rows=9, columns=7, seed=4, braiding=braiding)
    rows, columns = one.inside.shape
    low = -(one.way[0] + 0.5)
    expected = []
    for row in range(-1, rows):
        for column in range(-1, columns):
            x, y = low[1] + column + 1.0, low[0] + row + 1.0
            here = row >= 0 and column >= 0 and one.inside[row, column]
            right = row >= 0 and column + 1 < columns and one.inside[row, column + 1]
            above = column >= 0 and row + 1 < rows and one.inside[row + 1, column]
            if (here or right) and not (here and one.right_open[row, column]):
                expected.append(shapely.box(x - 0.075, y - 1.075, x + 0.075, y + 0.075))
            if (here or above) and not (here and one.up_open[row, column]):
                expected.append(shapely.box(x - 1.075, y - 0.075, x + 0.075, y + 0.075))
    walls = footprint(one)
    apart = shapely.union_all(walls).symmetric_difference(shapely.union_all(expected))
    assert apart.buffer(-1e-9).area < 1e-9
    # Joints are closed: no more pieces than there are islands of walls.
    whole = shapely.union_all(shapely.buffer(walls, 1e-7, join_style="mitre"))
    parts = shapely.union_all(shapely.buffer(expected, 1e-7, join_style="mitre"))
    assert len(shapely.get_parts(whole)) == len(shapely.get_parts(parts))


@pytest.mark.parametrize("seed", range(3))
def test_no_faces_lie_upon_each_other(seed: int) -> None:
    one = maze(rows=8, columns=8, seed=seed)
    faces: dict[tuple[str, float], list[tuple[float, float]]] = {}
    for box in footprint(one):
        x0, y0, x1, y1 = (round(value, 6) for value in box.bounds)
        for key, span in (
            (("-x", x0), (y0, y1)), (("+x", x1), (y0, y1)),
            (("-y", y0), (x0, x1)), (("+y", y1), (x0, x1)),
        ):  # fmt: skip
            faces.setdefault(key, []).append(span)
    for spans in faces.values():
        spans.sort()
        assert all(b[0] >= a[1] - 1e-6 for a, b in itertools.pairwise(spans))


def test_the_same_seed_makes_the_same_maze_and_another_one_another() -> None:
    assert maze(seed=10**30).walls == maze(seed=10**30).walls
    assert maze(seed=1).walls != maze(seed=2).walls
    # What the numbers of PCG64 make on any machine.
    rows = maze(rows=3, columns=4, seed=1).right_open.astype(int).tolist()
    assert rows == [[0, 1, 0, 0], [1, 1, 1, 0], [1, 1, 1, 0]]


def test_the_largest_maze_is_made_as_well() -> None:
    one = maze(rows=200, columns=200, braiding=0.5)
    assert one.inside.all()
    assert len(one.way) > 200


def test_walls_that_leave_no_room_for_the_robot_are_refused() -> None:
    with pytest.raises(ValueError, match=r"must be at least 0.94, for the robot to pass"):
        generate(MazeRecipe(cell_m=0.9), 0.5)
    generate(MazeRecipe(cell_m=0.94), 0.5)

"""Which poses of a path collide: by the costs, by the footprint, and not where they did before."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.layered_costmap import Costmap, InflationParams, frame_of, inflate
from mazebot.navigation.costmap.path_check import new_collisions


def costmap_of(*solid: tuple[int, int]) -> Costmap:
    """3 m by 3 m about the cells of obstacles, by row and column."""
    cells = np.zeros((60, 60), np.bool_)
    for cell in solid:
        cells[cell] = True
    frame = frame_of(0.05, SE2(-1.5, -1.5, 0.0), cells.astype(np.int8))
    return inflate(
        frame,
        cells,
        np.zeros_like(cells),
        InflationParams(
            custom_inscribed_radius=0.13, inflation_radius=0.5, cost_scaling_factor=5.0
        ),
    )


ALONG = np.stack([np.linspace(-1.0, 1.0, 41), np.zeros(41)], axis=1)
AHEAD = np.zeros(41)
# A cell ahead at x 0.5, aside by 0.125.
BOX, EMPTY = costmap_of((32, 40)), costmap_of()


def found(costmap: Costmap, before: Costmap, max_cost: int = 254, first: bool = False) -> list[int]:
    hit = new_collisions(costmap, before, WAFFLE, ALONG, AHEAD, max_cost, first)
    return [int(index) for index in hit]


def test_the_footprint_touches_where_the_circle_need_not() -> None:
    hit = found(BOX, EMPTY)
    assert hit == list(range(hit[0], hit[-1] + 1))
    # The box is 0.525 ahead of the origin; a waffle reaches 0.077 ahead and 0.205 back.
    assert ALONG[hit[0], 0] == pytest.approx(0.45, abs=0.051)
    assert ALONG[hit[-1], 0] == pytest.approx(0.73, abs=0.051)
    assert found(BOX, EMPTY, first=True) == hit[:1]


def test_what_collided_before_is_no_collision() -> None:
    assert found(BOX, BOX) == []
    both = costmap_of((32, 40), (32, 12))
    assert found(both, BOX) == found(costmap_of((32, 12)), EMPTY)


def test_below_the_inscribed_cost_only_cells_count() -> None:
    near = found(BOX, EMPTY, max_cost=1)
    costs = [BOX.cost_at(*point) for point in ALONG.tolist()]
    assert near == [i for i, cost in enumerate(costs) if cost >= 1]
    assert set(found(BOX, EMPTY)) < set(near)


def test_outside_the_map_is_unknown() -> None:
    far = np.array([[1.4, 0.0], [1.6, 0.0]])
    hit = new_collisions(BOX, EMPTY, WAFFLE, far, np.zeros(2), 254, False)
    # It is outside both.
    assert hit.tolist() == []

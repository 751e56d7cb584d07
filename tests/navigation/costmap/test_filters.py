from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.navigation.costmap.costmap import GridFrame, frame_of
from mazebot.navigation.costmap.filters import (
    KEEPOUT,
    SPEED_M_S,
    SPEED_PERCENT,
    FilterInfo,
    FilterMask,
    keepout_costs,
)
from mazebot.navigation.costmap.inflation_layer import InflationParams
from mazebot.navigation.costmap.layered_costmap import LayeredCostmap, ObstacleParams

INFLATION = InflationParams(
    custom_inscribed_radius=0.153, inflation_radius=0.7, cost_scaling_factor=3.0
)
OBSTACLE = ObstacleParams(static_margin=0.1)


def mask(info: FilterInfo, *values: int) -> FilterMask:
    """A row of cells of 1 m from x = 0 on."""
    return FilterMask(GridFrame(1.0, 0.0, 0.0, 1, len(values)), np.array([values], np.int8), info)


def test_a_keepout_mask_costs_by_its_values_on_the_costmaps_grid() -> None:
    zones = mask(FilterInfo(KEEPOUT), 0, 100, 50, -1)
    costs = keepout_costs(zones, GridFrame(0.5, -1.0, 0.0, 2, 12))
    # The mask begins two cells into the grid and ends two before its end.
    assert costs[0].tolist() == [0, 0, 0, 0, 254, 254, 127, 127, 0, 0, 0, 0]
    assert costs[0].tolist() == costs[1].tolist()


def test_the_robots_side_stays_out_too() -> None:
    zones = mask(FilterInfo(KEEPOUT), 0, 100, 0)
    costs = keepout_costs(zones, GridFrame(0.1, 0.0, 0.0, 10, 30), half_width_m=0.15)
    assert costs[5, 8:22].tolist() == [0, 253] + [254] * 10 + [253, 0]


def test_zones_cost_on_the_static_and_the_combined_map_and_are_no_obstacles() -> None:
    cells = np.zeros((40, 60), np.int8)
    cells[:, 0] = 100
    costmap = LayeredCostmap(frame_of(0.05, SE2(0.0, 0.0, 0.0), cells), cells, INFLATION, OBSTACLE)
    before = costmap.master.distance_m.copy()
    free = costmap.master.costs.copy()
    zones = mask(FilterInfo(KEEPOUT), 0, 100, 0)
    costmap.set_keepout(keepout_costs(zones, costmap.frame))
    assert costmap.master.cost_at(1.5, 0.5) == costmap.static.cost_at(1.5, 0.5) == 254
    assert np.array_equal(costmap.master.distance_m, before)
    revision = costmap.revision
    costmap.set_keepout(None)
    assert costmap.revision > revision
    assert np.array_equal(costmap.master.costs, free)
    with pytest.raises(ValueError, match=r"must be \(40, 60\)"):
        costmap.set_keepout(np.zeros((3, 3), np.uint8))


@pytest.mark.parametrize(
    ("info", "field"),
    [
        (FilterInfo(3), "type"),
        (FilterInfo(SPEED_M_S, float("nan")), "base"),
        (FilterInfo(SPEED_M_S, 0.0, float("inf")), "multiplier"),
        (FilterInfo(KEEPOUT, 1.0), "base"),
    ],
)
def test_a_mask_of_nothing_known_is_refused_by_its_field(info: FilterInfo, field: str) -> None:
    with pytest.raises(ValueError, match=field):
        info.check()


def test_a_mask_for_speed_is_no_keepout_mask() -> None:
    with pytest.raises(ValueError, match="must be 0"):
        keepout_costs(mask(FilterInfo(SPEED_PERCENT), 0), GridFrame(1.0, 0.0, 0.0, 1, 1))

from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.world.costmap import straightened
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


@pytest.mark.parametrize("resolution_m", [0.01, 0.02, 0.03, 0.049])
@pytest.mark.parametrize("yaw_rad", [0.0, 0.3, -2.0])
def test_a_thin_line_of_a_finer_mask_is_not_lost(resolution_m: float, yaw_rad: float) -> None:
    side = round(2.0 / resolution_m)
    cells = np.zeros((side, side), np.int8)
    cells[:, side // 2] = 100
    turned = SE2(0.0, 0.0, yaw_rad)
    origin, cells = straightened(resolution_m, turned @ SE2(-1.0, -1.0, 0.0), cells)
    zones = FilterMask(frame_of(resolution_m, origin, cells), cells, FilterInfo(KEEPOUT))
    frame = GridFrame(0.05, -1.5, -1.5, 60, 60)
    rows, columns = np.nonzero(keepout_costs(zones, frame) == 254)
    forbidden_m = np.column_stack([columns + 0.5, rows + 0.5]) * 0.05 - 1.5
    across_m = (side // 2 + 0.5) * resolution_m - 1.0
    for along_m in np.linspace(-0.9, 0.9, 100).tolist():
        place_m = (turned @ SE2(across_m, along_m, 0.0))[:2]
        assert np.abs(forbidden_m - place_m).max(1).min() < 0.05
    for x_m, y_m in forbidden_m.tolist():
        assert abs((turned.inverse() @ SE2(x_m, y_m, 0.0)).x_m - across_m) < 0.1


def test_beyond_a_finer_mask_there_is_no_zone() -> None:
    zones = FilterMask(GridFrame(0.1, 0.0, 0.0, 10, 10), np.full((10, 10), 100, np.int8),
                       FilterInfo(KEEPOUT))  # fmt: skip
    costs = keepout_costs(zones, GridFrame(0.25, -0.5, -0.5, 8, 8))
    assert costs[2:6, 2:6].tolist() == [[254] * 4] * 4
    assert costs.sum() == 16 * 254


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

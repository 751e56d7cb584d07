from __future__ import annotations

import numpy as np
import pytest

from services.common.frames import SE2
from services.navigation.costmap.costmap import GridFrame, frame_of
from services.navigation.costmap.filters import (
    KEEPOUT,
    SPEED_M_S,
    SPEED_PERCENT,
    FilterInfo,
    FilterMask,
    SpeedLimit,
    in_keepout,
    keepout_costs,
    occupancy_of_picture,
    speed_limit,
)
from services.navigation.costmap.inflation_layer import InflationParams
from services.navigation.costmap.layered_costmap import LayeredCostmap, ObstacleParams

INFLATION = InflationParams(0.153, 0.7, 3.0)
OBSTACLE = ObstacleParams(2.5, 3.0, 0.1)


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


def test_a_robot_in_a_zone_may_leave_it() -> None:
    zones = mask(FilterInfo(KEEPOUT), 0, 100)
    assert in_keepout(zones, 1.5, 0.5)
    assert not in_keepout(zones, 0.5, 0.5)
    assert not in_keepout(zones, 5.0, 0.5)
    grid = GridFrame(0.1, 0.0, 0.0, 10, 20)
    assert keepout_costs(zones, grid, 0.15, lethal_override_cost=252).max() == 252


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


def test_speed_limits_in_percent_and_in_metres_a_second() -> None:
    percent = mask(FilterInfo(SPEED_PERCENT, 100.0, -1.0), 0, 60, 100, -1)
    assert speed_limit(percent, 1.5, 0.5) == SpeedLimit(True, 40.0)
    assert speed_limit(percent, 1.5, 0.5).linear_m_s(0.46) == pytest.approx(0.184)
    for x_m in (0.5, 2.5, 3.5, 9.0):
        assert speed_limit(percent, x_m, 0.5).linear_m_s(0.46) == 0.46
    metres = mask(FilterInfo(SPEED_M_S, 0.0, 0.01), 0, 20, 100)
    assert speed_limit(metres, 1.5, 0.5).speed_limit == pytest.approx(0.2)
    assert not speed_limit(metres, 1.5, 0.5).percentage
    assert speed_limit(metres, 2.5, 0.5).linear_m_s(0.46) == 0.46


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
    with pytest.raises(ValueError, match="must be"):
        speed_limit(mask(info, 0), 0.5, 0.5)


def test_a_mask_for_speed_is_no_keepout_mask() -> None:
    with pytest.raises(ValueError, match="must be 0"):
        keepout_costs(mask(FilterInfo(SPEED_PERCENT), 0), GridFrame(1.0, 0.0, 0.0, 1, 1))
    with pytest.raises(ValueError, match="must be 1"):
        speed_limit(mask(FilterInfo(KEEPOUT), 0), 0.5, 0.5)


def test_pictures_are_read_as_nav2s_map_server_does() -> None:
    picture = np.array([[0, 128, 205], [254, 255, 100]], np.uint8)
    assert occupancy_of_picture(picture).tolist() == [[0, 0, -1], [100, -1, 0]]
    assert occupancy_of_picture(picture, "raw").tolist() == [[-1, -1, 100], [0, -1, -1]]
    assert occupancy_of_picture(picture, negate=True).tolist() == [[100, 100, -1], [0, -1, 100]]
    scaled = occupancy_of_picture(picture, "scale", occupied_thresh=1.0, free_thresh=0.0)
    assert scaled.tolist() == [[1, 0, 61], [100, 50, 20]]

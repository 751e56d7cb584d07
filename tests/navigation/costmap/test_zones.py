from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import KeepoutZone, Point2, SpeedZone
from mazebot.navigation.build import planner_params
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.control.collision import Surroundings, Velocity, first_contact_s
from mazebot.navigation.costmap.costmap import GridFrame, frame_of
from mazebot.navigation.costmap.filters import (
    KEEPOUT,
    SPEED_M_S,
    SPEED_PERCENT,
    FilterInfo,
    FilterMask,
)
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.inflation_layer import InflationParams
from mazebot.navigation.costmap.layered_costmap import LayeredCostmap, ObstacleParams
from mazebot.navigation.costmap.zones import NamedMask, Zones, cells_of, zones_of
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planners import make_planner

FRAME = GridFrame(0.1, -1.0, -1.0, 20, 30)
SQUARE: tuple[Point2, ...] = ((0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.0, 0.5))


def moved(x_m: float, y_m: float = 0.0) -> tuple[Point2, ...]:
    return tuple((x + x_m, y + y_m) for x, y in SQUARE)


def keepout(*zones: KeepoutZone, frame: GridFrame = FRAME) -> Zones:
    made = zones_of(frame, 0.46, zones)
    assert made is not None
    return made


def test_a_zone_has_the_cells_that_it_covers_or_cuts() -> None:
    cells = cells_of(SQUARE, FRAME)
    assert cells.sum() == 25
    assert cells[10:15, 10:15].all()
    # A strip of 1 cm between two centres of cells is not lost.
    strip = ((0.01, -0.9), (0.02, -0.9), (0.02, 0.9), (0.01, 0.9))
    assert cells_of(strip, FRAME).sum() == 18
    assert not cells_of(moved(50.0), FRAME).any()
    assert cells_of(moved(1.8), FRAME).sum() == 10


def test_without_zones_there_are_none() -> None:
    assert zones_of(FRAME, 0.46) is None


def test_zones_are_known_by_their_names() -> None:
    zones = keepout(
        KeepoutZone(name="a", polygon_m=SQUARE), KeepoutZone(name="b", polygon_m=moved(1.0))
    )
    assert zones.keepout_at(0.25, 0.25) == "keepout zone a"
    assert zones.keepout_at(1.25, 0.25) == "keepout zone b"
    assert zones.keepout_at(0.75, 0.25) is None
    assert zones.keepout_at(99.0, 0.25) is None
    assert zones.limits_at(np.array([(0.25, 0.25), (99.0, 0.0)])).tolist() == [math.inf] * 2


def test_the_lowest_limit_counts_and_percent_are_of_the_highest_speed() -> None:
    zones = zones_of(
        FRAME, 0.4, (),
        (SpeedZone(name="slow", polygon_m=SQUARE, percent=50.0),
         SpeedZone(name="slower", polygon_m=moved(0.25), speed_limit_m_s=0.1)),
    )  # fmt: skip
    assert zones is not None
    places = np.array([(0.1, 0.2), (0.35, 0.2), (0.6, 0.2), (0.9, 0.2)])
    assert zones.limits_at(places).tolist() == [0.2, 0.1, 0.1, math.inf]
    values = zones.speed_values(0.4)
    assert (values[12, 11], values[12, 14], values[12, 25]) == (50, 75, 0)
    assert zones.forbidden is None
    assert zones.costs(0.15) is None


def test_masks_and_zones_of_the_world_add_up() -> None:
    grid = GridFrame(1.0, -1.0, -1.0, 2, 3)
    forbidden = np.array([[0, 100, 0], [0, 0, -1]], np.int8)
    slow = np.array([[60, 0, 0], [100, 0, -1]], np.int8)
    zones = zones_of(
        FRAME, 0.5, (KeepoutZone(name="a", polygon_m=SQUARE),), (),
        (NamedMask("keep.yaml", FilterMask(grid, forbidden, FilterInfo(KEEPOUT))),),
        (NamedMask("slow.yaml", FilterMask(grid, slow, FilterInfo(SPEED_PERCENT, 100.0, -1.0))),
         NamedMask("fast.yaml", FilterMask(grid, slow, FilterInfo(SPEED_M_S, 0.0, 0.003)))),
    )  # fmt: skip
    assert zones is not None
    assert zones.keepout_at(0.25, 0.25) == "keepout zone a"
    assert zones.keepout_at(0.5, -0.5) == "the keepout zone of keep.yaml"
    places = np.array([(-0.5, -0.5), (-0.5, 0.5), (1.5, 0.5)])
    assert zones.limits_at(places) == pytest.approx([0.18, 0.3, math.inf])
    with pytest.raises(ValueError, match="must be 1"):
        zones_of(
            FRAME, 0.5,
            speed_masks=(NamedMask("x", FilterMask(grid, slow, FilterInfo(KEEPOUT))),),
        )  # fmt: skip


@pytest.mark.parametrize(
    ("info", "limit_m_s"),
    [
        (FilterInfo(SPEED_PERCENT, 0.0, 1.0), 0.12),
        (FilterInfo(SPEED_PERCENT, 20.0, 0.5), 0.14),
        (FilterInfo(SPEED_M_S, 0.05, 0.003), 0.14),
    ],
)
def test_there_is_no_limit_where_a_mask_is_0_and_beyond_it(
    info: FilterInfo, limit_m_s: float
) -> None:
    """As in nav2_costmap_2d, whatever the base."""
    grid = GridFrame(1.0, -1.0, -1.0, 1, 2)
    slow = FilterMask(grid, np.array([[30, 0]], np.int8), info)
    zones = zones_of(FRAME, 0.4, speed_masks=(NamedMask("slow.yaml", slow),))
    assert zones is not None
    places = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5)])
    assert zones.limits_at(places) == pytest.approx([limit_m_s, math.inf, math.inf])


def test_a_thin_line_of_a_finer_speed_mask_is_not_lost() -> None:
    values = np.zeros((200, 100), np.int8)
    values[:, 50], values[:, 51] = 20, 60
    fine = FilterMask(GridFrame(0.01, 0.0, -1.0, 200, 100), values, FilterInfo(SPEED_PERCENT))
    zones = zones_of(FRAME, 0.5, speed_masks=(NamedMask("slow.yaml", fine),))
    assert zones is not None
    # The lowest of the limits within a cell.
    places = np.array([(0.45, 0.0), (0.55, 0.0), (0.65, 0.0)])
    assert zones.limits_at(places) == pytest.approx([math.inf, 0.1, math.inf])


def test_only_the_zone_around_the_robot_opens_for_it() -> None:
    zones = keepout(
        KeepoutZone(name="a", polygon_m=SQUARE), KeepoutZone(name="b", polygon_m=moved(1.0))
    )
    shut, opened = zones.costs(0.15), zones.costs(0.15, leaving_m=(0.25, 0.25))
    assert shut is not None
    assert opened is not None
    assert (shut[12, 12], shut[12, 22], shut[12, 9]) == (254, 254, 253)
    assert (opened[12, 12], opened[12, 22], opened[12, 9]) == (252, 254, 252)
    outside = zones.costs(0.15, leaving_m=(-0.5, 0.0))
    assert outside is not None
    assert np.array_equal(outside, shut)


@pytest.mark.parametrize("planner_id", ["any_angle", "a_star"])
def test_no_path_leads_into_a_keepout_zone(planner_id: str) -> None:
    rng = np.random.default_rng(3)
    cells = np.zeros((80, 100), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    params = InflationParams(
        custom_inscribed_radius=WAFFLE.half_width_m, inflation_radius=0.7, cost_scaling_factor=7.0
    )
    planner = make_planner(planner_id, planner_params(NavigationConfig(), 0.05, WAFFLE))
    found = 0
    for _ in range(25):
        polygons = [
            tuple((x + a, y + b) for a, b in SQUARE)
            for x, y in zip(rng.uniform(0.8, 3.6, 4), rng.uniform(0.3, 3.2, 4), strict=True)
        ]
        zones = keepout(
            *(KeepoutZone(name=f"z{i}", polygon_m=one) for i, one in enumerate(polygons)),
            frame=frame,
        )
        costmap = LayeredCostmap(frame, cells, params, ObstacleParams(static_margin=0.1))
        costmap.set_keepout(zones.costs(WAFFLE.half_width_m))
        start, goal = SE2(0.5, float(rng.uniform(0.5, 3.5)), 0.0), SE2(4.5, 2.0, 0.0)
        try:
            path = planner.plan(costmap.master, start, goal)
        except NavigationError:
            continue
        found += 1
        assert not [1 for x, y in path.points_m.tolist() if zones.keepout_at(x, y)]
    assert found > 15


def test_a_goal_beside_a_zone_is_not_reached_along_its_border() -> None:
    """Two zones in a doorway leave a gap of 11 cm, and the goal is too near to one of them for the
    robot's side, so that its footprint is searched for.
    """
    cells = np.zeros((80, 100), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = cells[40, :45] = cells[40, 60:] = 100
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    east = ((2.39, 2.23), (3.07, 2.23), (3.07, 2.91), (2.39, 2.91))
    west = ((1.44, 1.73), (2.28, 1.73), (2.28, 2.57), (1.44, 2.57))
    zones = keepout(
        KeepoutZone(name="east", polygon_m=east), KeepoutZone(name="west", polygon_m=west),
        frame=frame,
    )  # fmt: skip
    costmap = LayeredCostmap(
        frame,
        cells,
        InflationParams(
            custom_inscribed_radius=WAFFLE.half_width_m,
            inflation_radius=0.7,
            cost_scaling_factor=7.0,
        ),
        ObstacleParams(static_margin=0.1),
    )
    costmap.set_keepout(zones.costs(WAFFLE.half_width_m))
    planner = make_planner("any_angle", planner_params(NavigationConfig(), 0.05, WAFFLE))
    with pytest.raises(NavigationError, match="no path from"):
        planner.plan(costmap.master, SE2(3.92, 1.08, -2.3), SE2(2.19, 2.72, -1.85))


def test_entering_a_zone_is_a_contact_and_leaving_one_is_none() -> None:
    cells = np.zeros((40, 60), np.int8)
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    costmap = LayeredCostmap(
        frame,
        cells,
        InflationParams(
            custom_inscribed_radius=0.153, inflation_radius=0.7, cost_scaling_factor=3.0
        ),
        ObstacleParams(static_margin=0.1),
    )
    zones = keepout(KeepoutZone(name="a", polygon_m=moved(1.5, 0.75)), frame=frame)

    def contact_s(pose: SE2, *velocity: float) -> float:
        around = Surroundings(
            pose, costmap.master, np.empty((0, 2)), forbidden=zones.forbidden
        )  # fmt: skip
        return first_contact_s(around, Velocity(*velocity), 4.0)

    outside = SE2(1.0, 1.0, 0.0)
    assert contact_s(outside, 0.2, 0.0) == pytest.approx(2.5, abs=0.2)
    assert contact_s(outside, -0.2, 0.0) == math.inf
    assert contact_s(outside, 0.0, 1.0) == math.inf
    # A quarter of a circle to the left, radius 0.25 m, passes before the zone.
    assert contact_s(outside, 0.2, 0.8) == math.inf
    assert contact_s(SE2(1.0, 1.0, math.pi), -0.2, 0.0) == pytest.approx(2.5, abs=0.2)
    assert contact_s(SE2(1.75, 1.0, 0.0), 0.2, 0.0) == math.inf

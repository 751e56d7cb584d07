"""The shortest way of a disc among walls."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import pytest

from services.common.documents import Wall, World
from services.recorder.shortest_path import ROBOT_RADIUS_M, ShortestPath
from services.worldgen.loader import load_world


def wall(x_m: float, y_m: float, length_m: float, yaw_rad: float = 0.0) -> Wall:
    return Wall(
        name="wall",
        length_m=length_m,
        thickness_m=0.15,
        height_m=1.0,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=yaw_rad,
        material="plain",
    )


@pytest.fixture(scope="module")
def house() -> World:
    return load_world("original").world


@pytest.fixture(scope="module")
def ways(house: World) -> ShortestPath:
    return ShortestPath(house.walls)


def test_nothing_in_the_way_is_a_straight_line() -> None:
    assert ShortestPath([]).length_m((0.0, 0.0), (3.0, 4.0)) == pytest.approx(5.0)
    assert ShortestPath([wall(0.0, 9.0, 1.0)]).length_m((0.0, 0.0), (3.0, 4.0)) == 5.0


def test_round_the_end_of_a_wall_it_follows_the_tangents_and_the_arc() -> None:
    """The ends of a wall 0.15 m thick, grown by the radius, are two quarter circles and a flat."""
    radius_m, half_m = ROBOT_RADIUS_M, 0.075
    way = ShortestPath([wall(0.0, 0.0, 2.0)]).length_m((0.0, -1.0), (0.0, 1.0))
    # From (0, -1) to the circle about the corner (1, -0.075): tangent, arc, then along the flat.
    to_corner_m = math.hypot(1.0, 1.0 - half_m)
    tangent_m = math.sqrt(to_corner_m**2 - radius_m**2)
    heading_rad = math.atan2(1.0 - half_m, 1.0) - math.asin(radius_m / to_corner_m)
    arc_m = radius_m * (math.pi / 2 - heading_rad)
    assert way == pytest.approx(2 * (tangent_m + arc_m + half_m), rel=5e-4)


@pytest.mark.parametrize(
    ("start", "goal", "on_a_grid_m"),
    [
        ("start", "location1", 2.07),
        ("start", "location2", 3.48),
        ("start", "location3", 3.67),
        ("start", "location4", 8.55),
        ("location1", "location2", 4.85),
        ("location1", "location3", 5.24),
        ("location1", "location4", 10.12),
        ("location2", "location3", 7.14),
        ("location2", "location4", 12.02),
        ("location3", "location4", 4.96),
    ],
)
def test_the_house_has_the_lengths_of_a_search_on_a_grid(
    house: World, ways: ShortestPath, start: str, goal: str, on_a_grid_m: float
) -> None:
    """A grid of 2.5 cm measures up to 2.5 % too long, and never too short."""
    places = {place.name: (place.x_m, place.y_m) for place in house.locations}
    places["start"] = (house.start.x_m, house.start.y_m)
    way = ways.length_m(places[start], places[goal])
    assert way is not None
    assert 0.975 * on_a_grid_m <= way <= on_a_grid_m


def test_a_way_is_no_shorter_than_the_line_and_the_same_both_ways(
    house: World, ways: ShortestPath
) -> None:
    places = [(place.x_m, place.y_m) for place in (house.start, *house.locations)]
    for a, b in itertools.combinations(places, 2):
        there, back = ways.length_m(a, b), ways.length_m(b, a)
        assert there is not None
        assert there == pytest.approx(back)
        assert there >= math.dist(a, b) - 1e-9


def test_a_wider_disc_takes_a_longer_way(house: World, ways: ShortestPath) -> None:
    goal = next((g.x_m, g.y_m) for g in house.locations if g.name == "location4")
    narrow, wide = ways.length_m((0.0, 0.0), goal), ShortestPath(house.walls, 0.30)
    wide_m = wide.length_m((0.0, 0.0), goal)
    assert narrow is not None
    assert wide_m is not None
    assert narrow + 0.2 < wide_m < narrow + 0.5


def test_a_start_that_touches_a_wall_is_moved_out_first() -> None:
    ways = ShortestPath([wall(0.0, 0.0, 2.0)])
    way = ways.length_m((0.0, 0.2), (0.0, 1.0))
    # 9.5 cm out to where the disc fits, and straight on.
    assert way == pytest.approx(0.8, abs=1e-3)


def ring(gap_m: float = 0.0) -> Sequence[Wall]:
    """Four walls round the origin, with a gap in the eastern one's middle."""
    half_m = (2.0 - gap_m) / 2
    return (
        wall(0.0, 1.0, 2.15),
        wall(0.0, -1.0, 2.15),
        wall(-1.0, 0.0, 2.15, math.pi / 2),
        wall(1.0, 1.0 - half_m / 2, half_m, math.pi / 2),
        wall(1.0, -1.0 + half_m / 2, half_m, math.pi / 2),
    )


def test_no_way_out_of_a_closed_room() -> None:
    assert ShortestPath(ring()).length_m((0.0, 0.0), (3.0, 0.0)) is None


def test_a_gap_narrower_than_the_disc_is_closed() -> None:
    assert ShortestPath(ring(0.43)).length_m((0.0, 0.0), (3.0, 0.0)) is None
    assert ShortestPath(ring(0.45)).length_m((0.0, 0.0), (3.0, 0.0)) == pytest.approx(3.0)


def test_a_goal_inside_a_thick_wall_has_no_way() -> None:
    block = Wall(
        name="block",
        length_m=2.0,
        thickness_m=2.0,
        height_m=1.0,
        x_m=0.0,
        y_m=0.0,
        yaw_rad=0.0,
        material="plain",
    )
    assert ShortestPath([block]).length_m((3.0, 0.0), (0.0, 0.0)) is None

"""The shortest way of a disc among walls."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest

from mazebot.common.messages.documents import (
    Body,
    Box,
    Cylinder,
    Geometry,
    Material,
    Mesh,
    Planar,
    Polyline,
    Shape,
    Wall,
    World,
)
from mazebot.common.robot.waffle import WAFFLE_RADIUS_M
from mazebot.common.world.geometry import TriangleMesh, triangles_of
from mazebot.recorder.judging.goals.shortest_path import ShortestPath
from mazebot.recorder.judging.obstacles import obstacles
from mazebot.worldgen.recipe.loader import load_world


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


def world_of(walls: Sequence[Wall], bodies: Sequence[Body] = ()) -> World:
    return World(
        name="w", recipe="w.yaml", hash="", walls=tuple(walls), bodies=tuple(bodies),
        materials=(Material(name="plain"),), start=Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0),
    )  # fmt: skip


def among(*walls: Wall) -> ShortestPath:
    return ShortestPath(obstacles(world_of(walls), {}))


@pytest.fixture(scope="module")
def house() -> World:
    return load_world("original").world


@pytest.fixture(scope="module")
def ways(house: World) -> ShortestPath:
    return ShortestPath(obstacles(house, {}))


def test_nothing_in_the_way_is_a_straight_line() -> None:
    assert among().length_m((0.0, 0.0), (3.0, 4.0)) == pytest.approx(5.0)
    assert among(wall(0.0, 9.0, 1.0)).length_m((0.0, 0.0), (3.0, 4.0)) == 5.0


def test_round_the_end_of_a_wall_it_follows_the_tangents_and_the_arc() -> None:
    """The ends of a wall 0.15 m thick, grown by the radius, are two quarter circles and a flat."""
    radius_m, half_m = WAFFLE_RADIUS_M, 0.075
    way = among(wall(0.0, 0.0, 2.0)).length_m((0.0, -1.0), (0.0, 1.0))
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
    narrow, wide = ways.length_m((0.0, 0.0), goal), ShortestPath(obstacles(house, {}), 0.30)
    wide_m = wide.length_m((0.0, 0.0), goal)
    assert narrow is not None
    assert wide_m is not None
    assert narrow + 0.2 < wide_m < narrow + 0.5


def test_a_start_that_touches_a_wall_is_moved_out_first() -> None:
    ways = among(wall(0.0, 0.0, 2.0))
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
    assert among(*ring()).length_m((0.0, 0.0), (3.0, 0.0)) is None


def test_a_gap_narrower_than_the_disc_is_closed() -> None:
    assert among(*ring(0.43)).length_m((0.0, 0.0), (3.0, 0.0)) is None
    assert among(*ring(0.45)).length_m((0.0, 0.0), (3.0, 0.0)) == pytest.approx(3.0)


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
    assert among(block).length_m((3.0, 0.0), (0.0, 0.0)) is None


def past(geometry: Geometry, z_m: float = 0.5, mass_kg: float = 0.0, solid: bool = True) -> float:
    """How much longer than the line is the way from one side of a body to the other."""
    shape = Shape(name="shape", geometry=geometry, solid=solid)
    body = Body(name="body", position_m=(0.0, 0.0, z_m), mass_kg=mass_kg, shapes=(shape,))
    meshes = {"ab": triangles_of(Box(size_m=(1.0, 1.0, 1.0)), {})}
    way = ShortestPath(obstacles(world_of([], [body]), meshes)).length_m((-2.0, 0.0), (2.0, 0.0))
    assert way is not None
    return way - 4.0


def test_bodies_are_gone_around_by_their_footprints() -> None:
    box = past(Box(size_m=(1.0, 1.0, 1.0)))
    tangent_m = 2.0 * math.sqrt(1.5**2 + 0.5**2 - WAFFLE_RADIUS_M**2)
    assert box + 4.0 > 1.0 + tangent_m
    square = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    assert past(Mesh(sha256="ab")) == pytest.approx(box, rel=1e-3)
    assert past(Polyline(polygons_m=(square,), height_m=0.3), 0.0) == pytest.approx(box, rel=1e-3)
    half = past(Mesh(sha256="ab", scale=(1.0, 0.5, 1.0)))
    assert 0.0 < half < box - 0.05
    radius_m = 0.5 + WAFFLE_RADIUS_M
    turn_rad = math.pi - 2.0 * math.acos(radius_m / 2.0)
    round_m = 2.0 * math.sqrt(4.0 - radius_m**2) + radius_m * turn_rad - 4.0
    assert past(Cylinder(radius_m=0.5, length_m=1.0)) == pytest.approx(round_m, abs=0.01)


def test_what_the_robot_does_not_meet_is_in_nobody_s_way() -> None:
    box = Box(size_m=(1.0, 1.0, 1.0))
    assert past(box, z_m=0.9) == pytest.approx(0.0)  # it ends 0.4 m above the floor
    assert past(box, z_m=-0.49) == pytest.approx(0.0)  # a doorstep of 1 cm
    assert past(box, solid=False) == pytest.approx(0.0)
    assert past(box, mass_kg=1.0) == pytest.approx(0.0)  # it may have been pushed away
    assert past(Mesh(sha256="unknown")) == pytest.approx(0.0)


def test_a_mesh_of_many_triangles_is_as_wide_as_one_of_few() -> None:
    box = triangles_of(Box(size_m=(1.0, 1.0, 1.0)), {})
    for _ in range(6):
        box = halved(box)
    assert len(box.triangles) > 10_000
    body = Body(
        name="body", position_m=(0.0, 0.0, 0.5),
        shapes=(Shape(name="shape", geometry=Mesh(sha256="ab")),),
    )  # fmt: skip
    ways = ShortestPath(obstacles(world_of([], [body]), {"ab": box}))
    way = ways.length_m((-2.0, 0.0), (2.0, 0.0))
    assert way == pytest.approx(past(Box(size_m=(1.0, 1.0, 1.0))) + 4.0, abs=0.1)


def halved(mesh: TriangleMesh) -> TriangleMesh:
    """Each triangle as four."""
    corners = mesh.vertices_m[mesh.triangles]
    middles = (corners + np.roll(corners, -1, axis=1)) / 2.0
    parts = [middles, *(np.stack([corners[:, i], middles[:, i], middles[:, i - 1]], 1)
                        for i in range(3))]  # fmt: skip
    vertices = np.concatenate(parts).reshape(-1, 3)
    triangles = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    return TriangleMesh(vertices, np.ones_like(vertices), vertices[:, :2], triangles)


def test_a_maze_of_hundreds_of_walls_has_one_way_and_its_length() -> None:
    """A meander of 30 corridors a metre wide: all of them have to be driven."""
    rows, width_m = 30, 10.0
    walls = [wall(0.0, 0.0, width_m + 0.15), wall(0.0, float(rows), width_m + 0.15)]
    for row in range(rows):
        for side in (-1.0, 1.0):
            walls.append(wall(side * width_m / 2.0, row + 0.5, 1.15, math.pi / 2))
        if row:
            gap = 1.0 if row % 2 else -1.0
            pieces = 10
            length_m = (width_m - 1.0) / pieces
            for piece in range(pieces):
                x_m = -gap * (width_m / 2.0 - (piece + 0.5) * length_m)
                walls.append(wall(x_m, float(row), length_m + 0.01))
    assert len(walls) > 300
    start, goal = (4.0, 0.5), (-4.0, rows - 0.5)
    assert rows % 2 == 0
    way = among(*walls).length_m(start, goal)
    there, back = among(*walls).length_m(start, goal), among(*walls).length_m(goal, start)
    assert way == there == pytest.approx(back)
    # Between two gaps on opposite sides it runs past 9 m of wall and round its end.
    assert way is not None
    assert 28 * 9.0 < way < 30 * (9.0 + math.pi * 0.5)


def test_parallel_corridors_of_a_grid_do_not_lose_the_way() -> None:
    """Corners in rows and columns: many of them on one line, and no three ways alike."""
    walls = [wall(x, y, 1.0) for x in range(0, 6, 2) for y in range(6)]
    ways = among(*walls)
    way = ways.length_m((0.0, 0.5), (4.0, 4.5))
    assert way is not None
    assert math.dist((0.0, 0.5), (4.0, 4.5)) <= way < 7.0


def test_the_path_itself_has_that_length_and_is_free(ways: ShortestPath) -> None:
    start, goal = (0.0, 0.0), (3.322, -0.178)
    path = ways.path(start, goal)
    assert path is not None
    assert (tuple(path[0]), tuple(path[-1])) == (start, goal)
    assert np.hypot(*np.diff(path, axis=0).T).sum() == pytest.approx(ways.length_m(start, goal))
    assert ways.path((-10.0, 0.0), (0.0, 0.0)) is None

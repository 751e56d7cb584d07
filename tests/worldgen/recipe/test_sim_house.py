"""The two worlds that come with the product, against figures of the house that they re-create."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import World
from mazebot.common.world.footprint import wall_corners
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world
from mazebot.worldgen.recipe.sources import known_worlds

WORLDS = ("sim_house", "sim_house_enhanced")
NUMBERS = (0, 1, 10, 11, 13, 14, 15, 17, 18, 19, 2, 20, 21, 22, 24, 25, 29, 3, 30, 31, 32, 33, 35,
           36, 4, 5, 6, 7, 8, 9)  # fmt: skip


@pytest.fixture(scope="module", params=WORLDS)
def loaded(request: pytest.FixtureRequest) -> LoadedWorld:
    return load_world(str(request.param))


@pytest.fixture(scope="module")
def original() -> World:
    return load_world("sim_house").world


@pytest.fixture(scope="module")
def enhanced() -> World:
    return load_world("sim_house_enhanced").world


def test_the_house_has_its_thirty_walls_in_file_order(loaded: LoadedWorld) -> None:
    walls = loaded.world.walls
    assert [wall.name for wall in walls] == [f"Wall_{number}" for number in NUMBERS]
    assert sum(wall.length_m for wall in walls) == pytest.approx(53.212, abs=5e-4)
    assert {wall.thickness_m for wall in walls} == {0.15}
    corners = np.array([corner for wall in walls for corner in wall_corners(wall)])
    assert corners.min(0) == pytest.approx([-2.602, -2.140], abs=1e-3)
    assert corners.max(0) == pytest.approx([5.576, 4.434], abs=1e-3)


def test_the_two_houses_have_one_footprint(original: World, enhanced: World) -> None:
    for plain, textured in zip(original.walls, enhanced.walls, strict=True):
        assert plain.name == textured.name
        assert np.abs(np.subtract(wall_corners(plain), wall_corners(textured))).max() <= 1e-9
    assert original.start == enhanced.start
    assert original.locations == enhanced.locations


def test_the_original_is_one_metre_high_plain_and_bare(original: World) -> None:
    assert {wall.height_m for wall in original.walls} == {1.0}
    assert [(m.name, m.texture_sha256, m.ambient) for m in original.materials] == [
        ("plain", "", (1.0, 1.0, 1.0, 1.0)),
        ("grey_floor", "", (0.5, 0.5, 0.5, 1.0)),
    ]
    assert original.floor_material == "grey_floor"
    assert original.markers == ()


def test_the_enhanced_is_three_metres_high_with_textures_in_turn(enhanced: World) -> None:
    assert {wall.height_m for wall in enhanced.walls} == {3.0}
    assert [wall.material for wall in enhanced.walls] == ["bricks", "concrete", "wood"] * 10
    looks = [(m.texture_name, m.ambient[:3], m.diffuse[:3]) for m in enhanced.materials]
    assert looks == [
        ("bricks.png", (0.7, 0.3, 0.2), (0.8, 0.4, 0.3)),
        ("concrete.png", (0.6, 0.6, 0.6), (0.7, 0.7, 0.7)),
        ("wood_.png", (0.5, 0.35, 0.2), (0.6, 0.4, 0.25)),
        ("", (0.5, 0.5, 0.5), (0.5, 0.5, 0.5)),
    ]


def test_the_locations_have_the_clearance_they_are_known_for(loaded: LoadedWorld) -> None:
    footprints = [shapely.Polygon(wall_corners(wall)) for wall in loaded.world.walls]
    clearance = {
        place.name: min(shapely.Point(place.x_m, place.y_m).distance(f) for f in footprints)
        for place in loaded.world.locations
    }
    assert clearance == pytest.approx(
        {"location1": 0.734, "location2": 0.601, "location3": 0.847, "location4": 0.595}, abs=6e-4
    )
    assert [p.yaw_rad for p in loaded.world.locations] == [-2.25, 0.785, 1.571, -1.571]
    assert loaded.world.start.se2() == SE2(0.0, 0.0, 0.0)


def test_the_markers_hang_on_the_east_faces(enhanced: World) -> None:
    walls = {wall.name: wall for wall in enhanced.walls}
    faces = {}
    for marker in enhanced.markers:
        wall = walls[marker.wall]
        across = (1.0 if marker.side == "left" else -1.0) * wall.thickness_m / 2.0
        face = wall.map_from_wall() @ SE2(marker.offset_m, across, 0.0)
        faces[marker.id] = (face.x_m, face.y_m)
        assert marker.size_m == 0.3
        assert marker.height_m - marker.size_m * 8 / 6 / 2 > 0.04, "the panel is off the floor"
    assert faces == {
        60: pytest.approx((1.482, 2.081), abs=0.01),
        80: pytest.approx((-1.798, 0.427), abs=0.01),
    }


def test_a_world_without_aruco_is_another_world(enhanced: World) -> None:
    bare = load_world("sim_house_enhanced", use_aruco=False).world
    assert bare.markers == ()
    assert bare.walls == enhanced.walls
    assert bare.hash != enhanced.hash


def test_short_names_mean_the_same_worlds(original: World, enhanced: World) -> None:
    assert load_world("original").world == original
    assert load_world("enhanced").world == enhanced
    assert set(WORLDS) <= set(known_worlds())


def test_the_hash_is_of_the_content(loaded: LoadedWorld) -> None:
    world = loaded.world
    assert world.hash == world.content_hash()
    moved = world.walls[0].model_copy(update={"x_m": world.walls[0].x_m + 1e-9})
    assert (
        world.model_copy(update={"walls": (moved, *world.walls[1:])}).content_hash() != world.hash
    )


def test_the_inside_is_free_and_the_outside_unknown(loaded: LoadedWorld) -> None:
    resolution, origin, cells = 0.05, loaded.map_origin, loaded.map_cells
    assert math.remainder(origin.x_m, resolution) == pytest.approx(0.0, abs=1e-9)
    assert set(np.unique(cells)) == {-1, 0, 100}
    edge = np.concatenate([cells[0], cells[-1], cells[:, 0], cells[:, -1]])
    assert set(edge) == {-1}
    for place in (*loaded.world.locations, loaded.world.start):
        row = int((place.y_m - origin.y_m) / resolution)
        column = int((place.x_m - origin.x_m) / resolution)
        assert cells[row, column] == 0
    # The rooms have about 34 square metres of floor.
    assert 33.0 < (cells == 0).sum() * resolution**2 < 35.0

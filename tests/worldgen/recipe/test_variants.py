"""Every world that comes with the product can be driven, and is what it says."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import shapely
from scipy import ndimage

from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import SE2, rotation_from_quaternion
from mazebot.common.messages.documents import Planar, Room, World
from mazebot.common.world.costmap import FREE, OCCUPIED
from mazebot.common.world.marker_entities import marker_entities
from mazebot.common.world.placement import panel_of
from mazebot.worldgen.check import problems_of
from mazebot.worldgen.markers.visibility import Sight, covered_share
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world
from mazebot.worldgen.recipe.sources import SHORT_NAMES, known_worlds

ROBOT_RADIUS_M = 0.24
NAMES = known_worlds()


def reaches_everything(loaded: LoadedWorld, radius_m: float) -> bool:
    """Whether a disc comes from the start to every location, by the cells of the map."""
    resolution, origin = loaded.world.map_resolution_m, loaded.map_origin
    clear_m = ndimage.distance_transform_edt(loaded.map_cells != OCCUPIED) * resolution
    regions, _ = ndimage.label((clear_m >= radius_m) & (loaded.map_cells == FREE))

    def region(place: Planar) -> int:
        row = math.floor((place.y_m - origin.y_m) / resolution)
        column = math.floor((place.x_m - origin.x_m) / resolution)
        return int(regions[row, column])

    start = region(loaded.world.start)
    return start != 0 and all(region(place) == start for place in loaded.world.locations)


def test_the_worlds_are_these() -> None:
    assert {
        "sim_house", "sim_house_enhanced", "sim_house_floor", "sim_house_rooms", "sim_house_slam",
        "sim_house_markers", "maze", "maze_rooms",
    } <= set(NAMES)  # fmt: skip
    assert set(SHORT_NAMES.values()) <= set(NAMES)
    assert not set(SHORT_NAMES) & set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_world_has_no_problem_and_every_place_can_be_reached(name: str) -> None:
    assert problems_of(name) == ()
    loaded = load_world(name)
    assert loaded.world.locations
    assert reaches_everything(loaded, ROBOT_RADIUS_M)
    entities, _ = marker_entities(loaded.world)
    assert entities.refused == ()
    assert len(entities.markers) == len(loaded.world.markers)


def test_a_gap_too_narrow_is_found() -> None:
    assert not reaches_everything(load_world("sim_house"), 0.6)


def polygon(room: Room) -> shapely.Polygon:
    return shapely.Polygon(room.polygon_m)


def faces(world: World) -> Iterator[tuple[shapely.Point, str]]:
    """Points 2 cm before the walls' faces, every 10 cm, each with the face's material there."""
    for wall in world.walls:
        for side, sign in (("left", 1.0), ("right", -1.0)):
            for along in np.arange(-wall.length_m / 2 + 0.05, wall.length_m / 2, 0.1):
                point = wall.map_from_wall() @ SE2(
                    float(along), sign * (wall.thickness_m / 2 + 0.02), 0.0
                )
                covers = [
                    cover.material
                    for cover in wall.coverings
                    if cover.side == side and cover.from_m <= along <= cover.to_m
                ]
                yield shapely.Point(point.x_m, point.y_m), (covers or [wall.material])[0]


def test_the_rooms_are_the_free_floor_and_do_not_overlap() -> None:
    loaded = load_world("sim_house")
    rooms = [polygon(room) for room in loaded.world.rooms]
    union = shapely.union_all(rooms)
    assert all(room.is_valid for room in rooms)
    assert sum(room.area for room in rooms) == pytest.approx(union.area, abs=1e-9)
    rows, columns = np.nonzero(loaded.map_cells == FREE)
    x = (columns + 0.5) * loaded.world.map_resolution_m + loaded.map_origin.x_m
    y = (rows + 0.5) * loaded.world.map_resolution_m + loaded.map_origin.y_m
    assert shapely.contains_xy(union, x, y).mean() > 0.999


def test_each_location_lies_in_its_room() -> None:
    world = load_world("sim_house").world
    found = {
        place.name: room.name
        for place in world.locations
        for room in world.rooms
        if polygon(room).contains(shapely.Point(place.x_m, place.y_m))
    }
    assert found == {
        "location1": "south_west", "location2": "north_west", "location3": "south_east",
        "location4": "north_east",
    }  # fmt: skip


@pytest.mark.parametrize("name", ["sim_house_rooms", "sim_house_slam"])
def test_no_two_rooms_have_the_same_walls_or_the_same_floor(name: str) -> None:
    world = load_world(name).world
    textures = {material.name: material.texture_sha256 for material in world.materials}
    walls: dict[str, set[str]] = {}
    for room in world.rooms:
        inside = shapely.buffer(polygon(room), -0.01)
        walls[room.name] = {textures[m] for point, m in faces(world) if inside.contains(point)}
    assert [len(found) for found in walls.values()] == [1] * 8, "one texture on a room's walls"
    assert len(set.union(*walls.values())) == 8
    assert len({textures[room.floor_material] for room in world.rooms}) == 8
    assert all(textures[room.floor_material] for room in world.rooms)


def test_the_floor_and_the_ceiling_are_textured() -> None:
    world = load_world("sim_house_floor").world
    textures = {material.name: material.texture_name for material in world.materials}
    assert textures[world.floor_material] == "floor_tiles.png"
    assert world.ceiling is not None
    assert textures[world.ceiling.material] == "ceiling_panels.png"
    assert world.ceiling.height_m == 3.0


def test_every_room_for_slam_has_a_marker_and_things_of_its_own() -> None:
    loaded = load_world("sim_house_slam")
    world = loaded.world
    before = []
    for entity in marker_entities(world)[0].markers:
        normal = rotation_from_quaternion(*entity.orientation_xyzw)[:, 2]
        before.append(shapely.Point(*(np.array(entity.position_m) + 0.2 * normal)[:2]))
    looks = []
    for room in world.rooms:
        assert sum(polygon(room).contains(point) for point in before) == 1
        things = [
            body for body in world.bodies if polygon(room).contains(shapely.Point(*body.position_m))
        ]
        assert things
        looks += [(body.shapes[0].geometry, body.shapes[0].material) for body in things]
    assert len(looks) == len(set(looks)) == len(world.bodies)
    # Half a metre of way and more, by cells that make things larger than they are.
    assert reaches_everything(loaded, 0.3)


@pytest.mark.parametrize("name", ["maze", "maze_rooms"])
def test_another_seed_is_another_maze(name: str) -> None:
    one, other = load_world(name).world, load_world(name, overrides=("maze.seed=77",)).world
    assert one.walls != other.walls
    assert [place.name for place in one.locations] == ["goal"]
    assert load_world(name).world == one


def test_twelve_markers_show_from_nearly_everywhere() -> None:
    loaded = load_world("sim_house_markers")
    panels = [panel_of(entity) for entity in marker_entities(loaded.world)[0].markers]
    assert len(panels) == 12
    sight = Sight(loaded.world, loaded.map_cells, loaded.map_origin)
    count = np.zeros(loaded.map_cells.shape, int)
    for panel in panels:
        rows, columns, cells = sight.window(panel)
        count[rows, columns] += cells
    assert (count[sight.reachable] >= 1).mean() >= 0.9
    assert (count[sight.reachable] >= 2).mean() >= 0.9
    # Fewer show from less: the figure is not one of any set of markers.
    args = loaded.world, panels[:3], loaded.map_cells, loaded.map_origin
    assert covered_share(*args) < 0.9


def test_the_page_of_worlds_is_right(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "worlds.md").read_text()
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == set(NAMES)
    (recipe,) = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "den.yaml").write_text(recipe)
    (tmp_path / "textures").symlink_to(ROOT / "worlds" / "textures")
    assert problems_of("den", worlds_dir=tmp_path) == ()
    (tmp_path / "den.yaml").write_text(recipe.replace("wall: east", "wall: est"))
    (problem,) = problems_of("den", worlds_dir=tmp_path)
    said = re.search(r"^worlds/(den\.yaml:\d+: .*)$", page, re.MULTILINE)
    assert said
    assert str(problem).endswith(said.group(1))

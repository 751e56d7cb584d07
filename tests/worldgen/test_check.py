"""Every problem at once, each with its place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import trimesh

from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.costmap.layered_costmap import (
    INSCRIBED_INFLATED_OBSTACLE,
    LayeredCostmap,
    frame_of,
)
from mazebot.worldgen.check import findings_of, problems_of
from mazebot.worldgen.files import rough_bodies
from mazebot.worldgen.recipe.loader import load_world
from mazebot.worldgen.sdf.convert import to_recipe
from mazebot.worldgen.sdf.reading.read import read_sdf
from tests.physics.driver import URCHIN
from tests.worldgen import folder


def said(worlds_dir: Path, recipe: dict[str, Any], *overrides: str) -> list[str]:
    """What is wrong, after the file's name and the line."""
    folder.make(worlds_dir, recipe)
    found = problems_of("room", worlds_dir=worlds_dir, overrides=overrides)
    return [str(problem).partition(": ")[2] for problem in found]


def box(name: str, **changes: Any) -> dict[str, Any]:
    return {"name": name, "size_m": [0.2, 0.2, 0.2], "x_m": 1.5, "y_m": -0.5} | changes


def body(**changes: Any) -> dict[str, Any]:
    shape = {"name": "s", "geometry": {"kind": "sphere", "radius_m": 0.1}}
    return {"name": "b", "position_m": [1.5, -0.5, 0.1], "shapes": [shape]} | changes


SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]


def test_a_good_world_has_no_problem(tmp_path: Path) -> None:
    assert said(tmp_path, folder.room()) == []


def test_every_problem_is_told_at_once_with_its_line(tmp_path: Path) -> None:
    recipe = folder.room()
    recipe["walls"][1]["length_m"] = -1
    recipe["walls"][2]["material"] = "gold"
    recipe["locations"]["corner"]["y_m"] = 1.0
    recipe["locations"]["den"] = {"x_m": "far", "y_m": 0.0}
    recipe["markers"] += [
        {"id": 3, "wall": "north", "side": "left", "height_m": 0.3},
        {"id": 4, "wall": "south", "side": "left", "height_m": 3.0},
        {"id": 5, "wall": "east", "side": "left", "height_m": 0.3},
    ]
    folder.make(tmp_path, recipe)
    found = problems_of("room", worlds_dir=tmp_path)
    by_field = {problem.field: problem for problem in found}
    assert set(by_field) == {
        "walls[1].length_m", "walls[2].material", "locations.corner", "locations.den.x_m",
        "markers[1].id", "markers[2]",
    }  # fmt: skip
    assert by_field["markers[1].id"].must == "must be unique: already on south"
    assert "above the top of south" in by_field["markers[2]"].must
    lines = (tmp_path / "room.yaml").read_text().splitlines()
    assert lines[by_field["walls[2].material"].line - 1] == "  material: gold"
    assert lines[by_field["locations.den.x_m"].line - 1] == "    x_m: far"
    fatal = {field for field, problem in by_field.items() if problem.fatal}
    assert fatal == {
        "walls[1].length_m", "walls[2].material", "locations.corner", "locations.den.x_m"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"boxes": [box("south")]},
            "boxes[0].name: 'south': must be unique: already used by walls[0]",
        ),
        (
            {"maze": {"rows": 2, "columns": 2}, "boxes": [box("maze_0", x_m=1.5)], "markers": []},
            "boxes[0].name: 'maze_0': must be unique: already used by maze",
        ),
        ({"boxes": [box("a", material="gold")]}, "boxes[0].material: 'gold': must be one of brick"),
        ({"boxes": [box("a", x_m=0.0, y_m=0.0)]}, "start: (0.0, 0.0): must not lie in a wall or"),
        (
            {"bodies": [body(orientation_xyzw=[0.0, 0.0, 0.0, 2.0])]},
            "bodies[0].orientation_xyzw: (0.0, 0.0, 0.0, 2.0): must have length 1, not 2",
        ),
        ({"bodies": [body(name="base_link", mass_kg=1.0)]}, "bodies[0].name: 'base_link': must no"),
        ({"bodies": [body(name="a\nb")]}, "bodies[0].name: 'a\\nb': must be printable"),
        (
            {"bodies": [body(shapes=[{"name": "s", "geometry": {"kind": "cube"}}])]},
            "bodies[0].shapes[0].geometry: {'kind': 'cube'}: "
            "must have a `kind` that is one of 'box'",
        ),
        (
            {
                "bodies": [
                    body(shapes=[{"name": "s", "geometry": {"kind": "sphere", "radius_m": 1e308}}])
                ]
            },
            "bodies[0].shapes[0].geometry.radius_m: 1e+308: must be <= 1000",
        ),
        (
            {"meshes": [{"name": "m", "file": "m.obj", "x_m": 0, "y_m": 0, "scale": [1, 0, 1]}]},
            "meshes[0].scale: (1.0, 0.0, 1.0): must not be zero along any axis",
        ),
        (
            {"meshes": [{"name": "m", "file": "m.obj", "x_m": 0, "y_m": 0}]},
            "meshes[0].file: 'm.obj': ",
        ),
        ({"ceiling": {"material": "plain", "height_m": 0.5}}, "ceiling.height_m: 0.5: must be at"),
        (
            {"rooms": {"a": {"polygon_m": [[0, 0], [1, 1], [1, 0], [0, 1]]}}},
            "rooms.a.polygon_m: ((0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)): must not cross",
        ),
        (
            {"rooms": {"a": {"polygon_m": SQUARE}, "b": {"polygon_m": [*SQUARE]}}},
            "rooms.b.polygon_m: ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)): must not overlap",
        ),
        (
            {"lights": [{"name": "l", "position_m": [0.0, 0.0, 1.0], "constant": 0.0}]},
            "lights[0].constant: 0.0: must be > 0, or linear",
        ),
        ({"map": "none.yaml"}, "map: 'none.yaml': "),
        ({"start": {"x_m": 0.0, "y_m": 0.8}}, "start: (0.0, 0.8): must have 0.24 m clear around"),
        ({"maze": {"cell_m": 0.6}, "wall_thickness_m": 0.3}, "maze.cell_m: 0.6: must be at least"),
        ({"wall_height_m": 0.2}, "markers[0]: 'aruco_3': extends"),
        (
            {"materials": folder.room()["materials"] | {"spare": {"texture": "gone.png"}}},
            "materials.spare.texture: 'gone.png': ",
        ),
    ],
)
def test_a_mistake_of_geometry_is_named(
    tmp_path: Path, changes: dict[str, Any], expected: str
) -> None:
    found = said(tmp_path, folder.room() | changes)
    assert any(line.startswith(expected) for line in found), found


@pytest.mark.parametrize(
    ("covering", "expected"),
    [
        ({"from_m": 1.0, "to_m": 1.0}, "to_m: 1.0: must be greater than from_m, 1"),
        ({"from_m": -3.0, "to_m": 1.0}, "from_m: -3.0: must lie on the wall: at least -2"),
        ({"from_m": 0.0, "to_m": 2.1}, "to_m: 2.1: must lie on the wall: at most 2"),
    ],
)
def test_a_covering_lies_on_its_wall(
    tmp_path: Path, covering: dict[str, float], expected: str
) -> None:
    recipe = folder.room()
    recipe["walls"][0]["coverings"] = [{"side": "left", "material": "plain", **covering}]
    assert said(tmp_path, recipe) == [f"walls[0].coverings[0].{expected}"]


def test_a_narrow_way_is_told(tmp_path: Path) -> None:
    recipe = folder.room()
    recipe["walls"].append(
        {"name": "across", "length_m": 1.6, "x_m": 0.5, "y_m": -0.2, "yaw_rad": 1.5708}
    )
    (found,) = said(tmp_path, recipe | {"map_resolution_m": 0.02, "markers": []})
    assert found.startswith("locations.corner: (1.0, 0.5): must be reached from the start by a way")


def test_what_can_run_all_the_same_is_loaded(tmp_path: Path) -> None:
    recipe = folder.room()
    recipe["markers"][0]["offset_m"] = 5.0
    (found,) = said(tmp_path, recipe)
    assert found.startswith("markers[0]: 'aruco_3': extends 3.")
    assert len(load_world("room", worlds_dir=tmp_path).world.markers) == 1


def test_a_file_is_checked_where_it_lies(tmp_path: Path) -> None:
    folder.make(tmp_path)
    assert problems_of(tmp_path / "room.yaml") == ()
    (found,) = problems_of(tmp_path / "none.yaml")
    assert str(found) == f"{tmp_path}/none.yaml: cannot be read: No such file or directory"
    (tmp_path / "junk.sdf").write_bytes(b"\x00\xff")
    assert problems_of(tmp_path / "junk.sdf")
    (found,) = problems_of("../room", worlds_dir=tmp_path)
    assert found.field == "world_name"


@pytest.mark.parametrize("name", ["sim_house", "sim_house_enhanced"])
def test_the_house_has_no_problem(name: str) -> None:
    assert problems_of(name) == ()


def test_what_an_import_cannot_bring_in_is_a_problem(tmp_path: Path) -> None:
    body = '<static>1</static><link name="l"><collision name="c">{}</collision></link>'
    mesh = body.format("<geometry><mesh><uri>a.dae</uri></mesh></geometry>")
    (tmp_path / "a.dae").write_text("no mesh")
    file = tmp_path / "mesh.SDF"
    inside = f'<model name="m">{mesh}</model>'
    file.write_text(f'<sdf version="1.9"><world name="w">{inside}</world></sdf>')
    (problem,) = problems_of(file)
    assert "MESH_INVALID" in str(problem)
    assert str(problem).count("\n") == 0


def test_a_maze_that_is_too_narrow_to_be_driven_is_told() -> None:
    narrow, wide = (
        problems_of("maze", overrides=(f"maze.cell_m={cell_m}", "maze.rows=4", "maze.columns=4"))
        for cell_m in (0.6, 0.7)
    )
    assert [str(problem) for problem in narrow][:1] == [
        "override maze.cell_m=0.6: maze.cell_m: 0.6: must be at least 0.65: in corridors narrower "
        "than 0.5 m the robot cannot turn round"
    ]
    assert wide == ()


def test_a_start_in_a_pocket_is_told_with_a_better_one(tmp_path: Path) -> None:
    """A bin of 0.9 m in the corner of the room."""
    recipe = folder.room() | {"markers": [], "map_resolution_m": 0.05, "locations": {}}
    recipe["walls"] += [
        {"name": "bin_east", "length_m": 0.9, "x_m": -0.9, "y_m": -0.5, "yaw_rad": 1.5708},
        {"name": "bin_north", "length_m": 1.1, "x_m": -1.4, "y_m": -0.05, "yaw_rad": 0.0},
    ]
    recipe["start"] = {"x_m": -1.45, "y_m": -0.5}
    (found,) = said(tmp_path, recipe)
    assert found.startswith("start: (-1.45, -0.5): must not stand in a pocket of 0.2 m2: ")
    x_m, y_m = (float(part) for part in found.partition("around (")[2].rstrip(")").split(", "))
    assert said(tmp_path, recipe | {"start": {"x_m": x_m, "y_m": y_m}}) == []
    assert said(tmp_path, {key: recipe[key] for key in recipe if key != "start"}) == []


def test_a_place_leaves_room_to_turn_and_navigation_drives_to_it(tmp_path: Path) -> None:
    """The wall's face is at 0.945 m. Navigation drives nearer to it, by the footprint; a location
    must do with every heading.
    """
    recipe = folder.room() | {"markers": [], "map_resolution_m": 0.05, "wall_thickness_m": 0.11}
    params = NavigationConfig().global_costmap
    told = {}
    for y_m in (0.6, 0.69, 0.703, 0.76):
        recipe["locations"] = {"here": {"x_m": 0.0, "y_m": y_m}}
        told[y_m] = said(tmp_path, recipe)
        loaded = load_world("room", worlds_dir=tmp_path)
        frame = frame_of(0.05, loaded.map_origin, loaded.map_cells)
        costmap = LayeredCostmap(
            frame, loaded.map_cells, params.inflation_layer, params.obstacle_layer
        )
        stands = costmap.static.cost_at(0.0, y_m) < INSCRIBED_INFLATED_OBSTACLE
        assert stands or told[y_m], (y_m, told)
    assert told[0.69] == []
    assert told[0.703] == [
        "locations.here: (0.0, 0.703): must have 0.24 m clear around it, not 0.200"
    ]


def test_the_floor_that_can_be_reached_is_told(tmp_path: Path) -> None:
    recipe = folder.room() | {"markers": [], "map_resolution_m": 0.05}
    folder.make(tmp_path, recipe)
    reach = findings_of("room", worlds_dir=tmp_path).reach
    assert reach is not None
    # 3.85 x 1.85 m within the walls, less the robot's radius at each and a cell's rounding.
    assert reach.reachable_m2 == pytest.approx(3.35 * 1.35, abs=0.3)
    assert reach.share == 1.0
    assert not reach.open_floor
    recipe["walls"].append(
        {"name": "across", "length_m": 2.0, "x_m": 1.0, "y_m": 0.0, "yaw_rad": 1.5708}
    )
    folder.make(tmp_path, recipe | {"locations": {}})
    reach = findings_of("room", worlds_dir=tmp_path).reach
    assert reach is not None
    assert 0.7 < reach.share < 0.9
    recipe["walls"] = []
    folder.make(tmp_path, recipe)
    problems, reach = findings_of("room", worlds_dir=tmp_path)
    assert problems == ()
    assert reach is not None
    assert reach.open_floor
    assert str(reach).endswith("can be reached from the start, and the open floor around it")


@pytest.mark.parametrize(
    ("changes", "heights", "told"),
    [
        ({"wall_height_m": 0.05}, {}, "wall_height_m: 0.05: must be above the plane of the"),
        ({}, {2: 0.13}, "walls[2].height_m: 0.13: must be above the plane of the lidar, 0.132 m"),
        ({}, {2: 0.14}, ""),
    ],
)
def test_walls_that_the_lidar_does_not_see_are_told(
    tmp_path: Path, changes: dict[str, Any], heights: dict[int, float], told: str
) -> None:
    recipe = {**folder.room(), **changes, "markers": []}
    for index, height_m in heights.items():
        recipe["walls"][index]["height_m"] = height_m
    lines = said(tmp_path, recipe)
    assert len(lines) == bool(told)
    for line in lines:
        assert told in line
        count = len(heights) or 4
        assert f"it sees nothing of {count} of 4 walls (" in line


def test_bodies_of_which_the_lidar_sees_nothing_are_told(tmp_path: Path) -> None:
    urdf = """<robot name="kerbs"><link name="base"/><link name="a">
    <collision><origin xyz="1 0 Z"/><geometry><cylinder radius="0.2" length="0.1"/></geometry>
    </collision></link><joint name="j" type="fixed"><parent link="base"/><child link="a"/></joint>
    </robot>"""
    for z_m, seen in ((0.05, False), (0.1, True), (0.2, False)):
        file = tmp_path / "kerbs.urdf"
        file.write_text(urdf.replace("Z", f"{z_m}"))
        lines = [str(problem) for problem in problems_of(file)]
        assert len(lines) == (not seen)
        assert all("bodies: 1: must cross the plane of the lidar, 0.132 m" in one for one in lines)


def test_only_bodies_that_stand_still_are_told_as_those_to_localize_by(tmp_path: Path) -> None:
    bodies = [body(name="post", position_m=[1.0, 0.0, 0.05]), body(name="crate", mass_kg=1.0)]
    for one, height_m in zip(bodies, (0.1, 1.0), strict=True):
        one["shapes"][0]["geometry"] = {"kind": "box", "size_m": [0.2, 0.2, height_m]}
    bodies[1]["position_m"] = [-1.0, 0.0, 0.5]
    (line,) = said(tmp_path, {**folder.room(), "walls": [], "markers": [], "bodies": bodies})
    assert "it sees nothing of the 1 body that stands still" in line


def test_a_body_on_the_map_that_the_lidar_does_not_see_is_told_by_its_name(tmp_path: Path) -> None:
    seen, lamp = box("crate", x_m=-1.0), box("lamp", x_m=-1.5, z_m=1.0)
    boxes = [seen, lamp, box("shelf", z_m=0.2, size_m=[0.4, 0.2, 0.02])]
    assert said(tmp_path, {**folder.room(), "boxes": boxes[:2]}) == []
    (line,) = said(tmp_path, {**folder.room(), "boxes": boxes})
    assert line.startswith("boxes[2]: 'shelf': must cross the plane of the lidar, 0.132 m: ")
    assert line.endswith("sees nothing of 1 of 2 bodies on the map (shelf)")


def test_what_an_import_runs_without_is_told(tmp_path: Path) -> None:
    file = tmp_path / "walls.urdf"
    link = '<link name="{}"><visual><geometry><box size="0.1 2 1"/></geometry></visual></link>'
    file.write_text(f'<robot name="walls">{link.format("wall1")}</robot>')
    found = findings_of(file)
    (problem,) = found.problems
    assert not problem.fatal
    assert "walls::wall1 has a <visual> and no <collision>: nothing there can be hit" in str(
        problem
    )
    assert found.reach is not None


def test_a_mesh_that_physics_only_follows_roughly_is_told_if_it_moves(tmp_path: Path) -> None:
    spikes = trimesh.Trimesh(URCHIN.vertices_m, URCHIN.triangles)
    spikes.export(tmp_path / "urchin.obj")
    file = tmp_path / "sea.sdf"
    sdf = """<sdf version="1.9"><world name="sea"><model name="urchin"><static>STILL</static>
    <pose>1 0 0.1 0 0 0</pose><link name="l"><inertial><mass>2</mass></inertial>
    <collision name="c"><geometry><mesh><uri>urchin.obj</uri></mesh></geometry></collision>
    <visual name="v"><geometry><mesh><uri>urchin.obj</uri></mesh></geometry></visual>
    </link></model></world></sdf>"""
    for still, expected in ((True, 0), (False, 1)):
        file.write_text(sdf.replace("STILL", str(still).lower()))
        told = [str(one) for one in problems_of(file) if "collides as 32 convex parts" in str(one)]
        assert len(told) == expected
        imported = rough_bodies(to_recipe(read_sdf(file), "sea"))
        assert imported.startswith("body 'urchin'") == (not still)


def test_what_collides_in_gazebo_and_not_here_is_told(tmp_path: Path) -> None:
    file = tmp_path / "hall.world"
    plane = "<geometry><plane><normal>0 1 1</normal></plane></geometry>"
    file.write_text(
        '<sdf version="1.6"><world name="w"><gravity>0 0 -9.8</gravity>\n<population name="drums">'
        '<model_count>20</model_count></population><model name="slope"><static>1</static>'
        f'<link name="l"><collision name="c">{plane}</collision></link></model>\n'
        '<state world_name="w"><deletions><name>slope</name></deletions></state></world></sdf>'
    )
    (problem,) = problems_of(file)
    assert not problem.fatal
    assert str(problem).endswith(
        "collisions are not all as in Gazebo, for want of: "
        "population drums (hall.world:2: world w/population drums), "
        "deletions of state (hall.world:3: world w/state/deletions), "
        "plane collision that is not the floor (hall.world: slope::l::c)"
    )

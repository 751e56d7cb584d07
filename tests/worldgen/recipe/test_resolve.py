"""What becomes of a recipe's parts in the world."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import rotation_from_quaternion
from mazebot.common.messages.documents import Body, World
from mazebot.common.problems import WorldError
from mazebot.common.world.geometry import mesh_from_bytes
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_file, load_world
from tests.worldgen import folder

CUBE_OBJ = """\
mtllib cube.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 0 1
usemtl red
f 1 3 2
f 1 2 4
usemtl blue
f 2 3 4
f 3 1 4
"""
CUBE_MTL = "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n"


def load(worlds_dir: Path, *overrides: str, **changes: Any) -> LoadedWorld:
    folder.make(worlds_dir, folder.room() | changes)
    return load_world("room", worlds_dir=worlds_dir, overrides=overrides)


def body_of(world: World, name: str) -> Body:
    (body,) = [body for body in world.bodies if body.name == name]
    return body


def placed(name: str, **changes: Any) -> dict[str, Any]:
    return {"name": name, "x_m": 1.5, "y_m": -0.5} | changes


def test_things_stand_on_the_floor_however_they_are_turned(tmp_path: Path) -> None:
    boxes = [
        placed("flat", size_m=[0.2, 0.2, 0.4]),
        placed("tilted", size_m=[0.2, 0.3, 0.4], roll_rad=0.3, pitch_rad=-0.7, yaw_rad=1.0),
        placed("hung", size_m=[0.2, 0.2, 0.4], z_m=1.5, mass_kg=2.0),
    ]
    cans = [placed("lying", radius_m=0.1, height_m=0.3, pitch_rad=math.pi / 2)]
    world = load(tmp_path, boxes=boxes, cylinders=cans).world
    assert body_of(world, "flat").position_m == (1.5, -0.5, 0.2)
    assert body_of(world, "hung").position_m[2] == 1.5
    assert body_of(world, "hung").mass_kg == 2.0
    assert body_of(world, "lying").position_m[2] == pytest.approx(0.1)
    tilted = body_of(world, "tilted")
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.15, 0.15) for z in (-0.2, 0.2)])
    heights = corners @ rotation_from_quaternion(*tilted.orientation_xyzw)[2]
    assert tilted.position_m[2] + heights.min() == pytest.approx(0.0, abs=1e-12)
    assert {shape.material for body in world.bodies for shape in body.shapes} == {"brick"}


def test_bodies_are_on_the_map(tmp_path: Path) -> None:
    bare = load(tmp_path).map_cells
    boxed = load(tmp_path, boxes=[placed("box", size_m=[0.2, 0.2, 0.2])]).map_cells
    assert bare.shape == boxed.shape
    assert (bare == 100).sum() < (boxed == 100).sum()
    high = load(tmp_path, boxes=[placed("box", size_m=[0.2, 0.2, 0.2], z_m=0.8)]).map_cells
    assert (high == bare).all()


def test_a_maze_brings_walls_a_start_and_a_goal(tmp_path: Path) -> None:
    changes: dict[str, Any] = {
        "walls": [], "markers": [], "locations": {}, "start": None,
        "maze": {"rows": 3, "columns": 4, "seed": 3},
    }  # fmt: skip
    world = load(tmp_path, **changes).world
    assert [wall.name for wall in world.walls] == [f"maze_{i}" for i in range(len(world.walls))]
    assert [wall.material for wall in world.walls[:3]] == ["brick", "plain", "brick"]
    assert (world.start.x_m, world.start.y_m) == (0.0, 0.0)
    assert [place.name for place in world.locations] == ["goal"]
    again = load(tmp_path, "maze.seed=4", **changes).world
    assert again.hash != world.hash
    assert load(tmp_path, "maze.seed=3", **changes).world == world
    own = {"goal": {"x_m": 0.1, "y_m": 0.0}}
    (goal,) = load(tmp_path, **(changes | {"locations": own})).world.locations
    assert (goal.x_m, goal.y_m) == (0.1, 0.0)


def test_rooms_dress_the_faces_that_look_into_them(tmp_path: Path) -> None:
    """Two rooms side by side: the south wall's inner face changes at x = 0.5."""
    rooms = {
        "west": {"polygon_m": [[-2, -1], [0.5, -1], [0.5, 1], [-2, 1]], "wall_material": "plain"},
        "east": {"polygon_m": [[0.5, -1], [2, -1], [2, 1], [0.5, 1]], "wall_material": "other"},
    }
    materials = folder.room()["materials"] | {"other": {}, "own": {}}
    walls = folder.room()["walls"]
    own = {"side": "left", "from_m": -1.0, "to_m": -0.5, "material": "own"}
    walls[0]["coverings"] = [own]
    world = load(tmp_path, rooms=rooms, materials=materials, walls=walls).world
    south, east, north, _ = world.walls
    spans = [(c.side, c.from_m, c.to_m, c.material) for c in south.coverings]
    assert spans == [
        ("left", -1.0, -0.5, "own"),
        ("left", -2.0, -1.0, "plain"),
        ("left", -0.5, pytest.approx(0.5, abs=1e-12), "plain"),
        ("left", pytest.approx(0.5, abs=1e-12), 2.0, "other"),
    ]
    assert {covering.side for covering in east.coverings} == {"left"}
    # North runs the other way.
    assert [(c.material, round(c.from_m, 3)) for c in north.coverings] == [
        ("plain", -0.5), ("other", -2.0),
    ]  # fmt: skip
    assert {material.name for material in world.materials} == {"brick", "plain", "other", "own"}
    assert [room.name for room in world.rooms] == ["west", "east"]
    walls[2]["material"] = "own"
    north = load(tmp_path, rooms=rooms, materials=materials, walls=walls).world.walls[2]
    assert (north.material, north.coverings) == ("own", ())


def test_meshes_come_with_their_own_materials(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "cube.obj").write_text(CUBE_OBJ)
    (tmp_path / "meshes" / "cube.mtl").write_text(CUBE_MTL)
    meshes = [
        placed("small", file="cube.obj", scale=[0.2, 0.2, 0.4], pitch_rad=math.pi),
        placed("plain", file="cube.obj", scale=[0.2, 0.2, 0.2], material="plain"),
    ]
    geometry = {"kind": "mesh", "file": "cube.obj", "scale": [0.1, 0.1, 0.1]}
    shapes = [
        {"name": "seen", "geometry": geometry, "material": "cube.obj", "solid": False},
        {"name": "felt", "geometry": geometry},
    ]
    bodies = [{"name": "body", "position_m": [1.5, 0.5, 0.0], "shapes": shapes}]
    loaded = load(tmp_path, meshes=meshes, bodies=bodies)
    world = loaded.world
    small = body_of(world, "small")
    assert small.position_m[2] == pytest.approx(0.4)
    own = {shape.material for shape in small.shapes}
    assert len(own) == 2
    diffuse = {material.name: material.diffuse for material in world.materials}
    assert {diffuse[name] for name in own} == {(1, 0, 0, 1), (0, 0, 1, 1)}
    assert {shape.material for shape in body_of(world, "plain").shapes} == {"plain"}
    parts = body_of(world, "body").shapes
    assert {shape.material for shape in parts if not shape.solid} == own
    assert {shape.material for shape in parts if shape.solid} == {""}
    used = {shape.geometry.sha256 for shape in small.shapes}  # type: ignore[union-attr]
    assert set(loaded.meshes) == used
    for sha256, mesh in loaded.meshes.items():
        assert hashlib.sha256(loaded.assets[sha256]).hexdigest() == sha256
        again = mesh_from_bytes(loaded.assets[sha256])
        assert (again.vertices_m == mesh.vertices_m).all()


def test_only_what_is_used_is_in_the_world(tmp_path: Path) -> None:
    loaded = load(tmp_path, wall_materials=["plain"])
    assert [material.name for material in loaded.world.materials] == ["plain"]
    assert loaded.assets == {}


def test_a_quaternion_of_a_hand_is_made_a_unit_one(tmp_path: Path) -> None:
    shape = {"name": "s", "geometry": {"kind": "box", "size_m": [0.1, 0.1, 0.1]}}
    thing = {"name": "b", "position_m": [1.5, 0.5, 0.1], "shapes": [shape]}
    thing["orientation_xyzw"] = [0.0, 0.0, 0.7071, 0.7071]
    (body,) = load(tmp_path, bodies=[thing]).world.bodies
    assert math.hypot(*body.orientation_xyzw) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("override", "value"),
    [
        ("wall_height_m=2.5", 2.5), ("wall_height=2.5", 2.5), ("walls.0.height=2", 2.0),
        ("walls.south.height_m=2e0", 2.0), ("walls[0].height_m=2", 2.0),
    ],
)  # fmt: skip
def test_an_override_is_put_over_the_recipe(tmp_path: Path, override: str, value: float) -> None:
    assert load(tmp_path, override).world.walls[0].height_m == value


def test_overrides_come_one_after_the_other(tmp_path: Path) -> None:
    world = load(
        tmp_path, "wall_height=2", "locations.den={x_m: 0.5, y_m: 0}", "locations.den.x=0.6",
        "materials.brick.texture=", "wall_height=3",
    ).world  # fmt: skip
    assert world.walls[1].height_m == 3.0
    assert [(place.name, place.x_m) for place in world.locations][1] == ("den", 0.6)
    assert world.materials[0].texture_name == ""


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("wall_hight=2", "wall_hight: unknown field: must be one of about, wall_height_m, "),
        ("name=x", "name: unknown field: "),
        ("walls.9.length=2", "walls[9]: must be a number less than 4, or a name"),
        ("walls.3.length=-2", "walls[3].length_m: -2: must be > 0"),
        ("maze.sead=2", "maze.sead: unknown field: must be one of algorithm, rows, "),
        ("wall_height.x=2", "wall_height_m.x: no such field"),
        ("start={x_m: 1", "not YAML: "),
        ("start.x_m=x", "start.x_m: 'x': must be a number"),
        ("wall_height", "must be field=value"),
        ("locations.den.x_m=1", "locations.den.y_m: is missing"),
    ],
)
def test_a_wrong_override_is_one_line(tmp_path: Path, override: str, expected: str) -> None:
    with pytest.raises(WorldError) as caught:
        load(tmp_path, override)
    said = str(caught.value)
    assert expected in said
    assert "\n" not in said
    assert "missing" in said or said.startswith(f"override {override}: {expected}")


def test_a_file_is_loaded_where_it_lies(tmp_path: Path) -> None:
    named = load(tmp_path)
    loaded = load_file(tmp_path / "room.yaml")
    assert loaded.world == named.world
    assert loaded.recipe == named.recipe
    with pytest.raises(WorldError, match=r"none\.yaml: cannot be read: No such file"):
        load_file(tmp_path / "none.yaml")

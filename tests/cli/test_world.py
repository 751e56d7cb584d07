"""`mazebot world ...` and `mazebot markers ...`: what a person sees, and what is on the disk."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from mazebot.worldgen.recipe.loader import load_file, load_world
from tests.cli.test_app import assert_one_line, mazebot

ROOM = """
name: room
wall_height_m: 1.0
materials: {plain: {}, grey: {}}
wall_materials: [plain]
floor_material: grey
walls:
  - {name: north, length_m: 4.15, x_m: 0.0, y_m: 2.0, yaw_rad: 0.0}
  - {name: south, length_m: 4.15, x_m: 0.0, y_m: -2.0, yaw_rad: 0.0}
  - {name: east, length_m: 4.15, x_m: 2.0, y_m: 0.0, yaw_rad: 1.5708}
  - {name: west, length_m: 4.15, x_m: -2.0, y_m: 0.0, yaw_rad: 1.5708}
cylinders:
  - {name: pillar, x_m: 1.0, y_m: 1.0, radius_m: 0.2, height_m: 0.8}
locations: {corner: {x_m: -1.0, y_m: -1.0}}
"""

GAZEBO = """<?xml version="1.0"?>
<sdf version="1.9">
  <world name="yard">
    <include><uri>model://sun</uri></include>
    <include><uri>model://ground_plane</uri></include>
    <plugin name="physics" filename="gz-sim-physics-system"/>
    <model name="shed">
      <static>true</static>
      <pose>2 1 0 0 0 0.5</pose>
      <link name="wall">
        <pose>0 0 0.5 0 0 0</pose>
        <collision name="c"><geometry><box><size>3 0.2 1</size></box></geometry></collision>
        <visual name="v"><geometry><box><size>3 0.2 1</size></box></geometry></visual>
      </link>
    </model>
    <state world_name="yard"><model name="shed"><pose>2 1 0 0 0 0.5</pose></model></state>
  </world>
</sdf>
"""


@pytest.fixture
def room(tmp_path: Path) -> Path:
    file = tmp_path / "room.yaml"
    file.write_text(ROOM)
    return file


@pytest.fixture
def yard(tmp_path: Path) -> Path:
    file = tmp_path / "yard.sdf"
    file.write_text(GAZEBO)
    return file


def test_list_names_the_shipped_worlds() -> None:
    rows = json.loads(mazebot("world", "list", "--json").stdout)
    names = {row["name"] for row in rows}
    assert {"sim_house", "sim_house_enhanced", "maze"} <= names
    assert "sim_house_enhanced" in mazebot("world", "list").stdout


def test_show_says_what_is_in_a_world(room: Path) -> None:
    shown = mazebot("world", "show", str(room))
    assert shown.returncode == 0
    for word in ("room", "pillar", "corner"):
        assert word in shown.stdout or word == "pillar"
    world = json.loads(mazebot("world", "show", str(room), "--json").stdout)
    assert len(world["walls"]) == 4
    assert world["bodies"][0]["name"] == "pillar"
    higher = mazebot("world", "show", str(room), "--json", "--set", "wall_height=2.5")
    assert {wall["height_m"] for wall in json.loads(higher.stdout)["walls"]} == {2.5}


def test_show_resolves_the_frames_of_an_sdf_file(yard: Path) -> None:
    frames = json.loads(mazebot("world", "show", str(yard), "--frames", "--json").stdout)["frames"]
    (link,) = [f for f in frames if f["kind"] == "link" and f["name"] == "shed::wall"]
    assert link["pose_in_model"]["position_m"] == [0.0, 0.0, 0.5]
    assert link["pose_in_world"]["position_m"] == [2.0, 1.0, 0.5]
    assert np.allclose(link["pose_in_world"]["rpy_rad"], [0.0, 0.0, 0.5])


def test_a_urdf_is_a_world_with_one_model(tmp_path: Path) -> None:
    file = tmp_path / "post.urdf"
    box = "<collision><geometry><box size='{}'/></geometry></collision>"
    file.write_text(f"<robot name='p'><link name='l'>{box.format('1 1 1')}</link></robot>")
    said = mazebot("world", "check", str(file)).stdout
    assert said.startswith(f"{file}: no problems; ")
    assert said.endswith("can be reached from the start, and the open floor around it\n")
    file.write_text(f"<robot name='p'><link name='l'>{box.format('1 one 1')}</link></robot>")
    checked = mazebot("world", "check", str(file))
    assert (checked.returncode, checked.stderr.count("\n")) == (1, 1)
    assert "post.urdf:1: " in checked.stderr


def test_check_lists_every_problem_with_its_line(room: Path, yard: Path) -> None:
    assert mazebot("world", "check", str(room), str(yard), "enhanced").returncode == 0
    room.write_text(ROOM.replace("radius_m: 0.2", "radius_m: -1").replace("0.8}", ".nan}"))
    checked = mazebot("world", "check", str(room))
    assert checked.returncode == 1
    lines = checked.stderr.splitlines()
    assert len(lines) == 2, lines
    assert any("room.yaml:13: cylinders[0].radius_m: -1: must be > 0" in line for line in lines)
    assert any("cylinders[0].height_m" in line for line in lines)
    problems = json.loads(mazebot("world", "check", str(room), "--json").stdout)
    assert {problem["line"] for problem in problems[str(room)]} == {13}


def test_build_writes_everything_or_nothing(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "built"
    assert mazebot("world", "build", str(room), "--out", str(out)).returncode == 0
    assert {path.name for path in out.iterdir()} == {
        "world.json", "map.yaml", "map.pgm", "plan.png", "world.glb", "sdf", "figures.json",
    }  # fmt: skip
    made = json.loads((out / "figures.json").read_text())
    assert made["free_area_m2"] > made["reachable_m2"] > 7.0
    assert made["reachable_share"] == 1.0
    refused = mazebot("world", "build", str(room), "--out", str(out))
    assert_one_line(refused, "--out", "must be a new or an empty folder")
    room.write_text(ROOM.replace("4.15", "-4.15"))
    broken = mazebot("world", "build", str(room), "--out", str(tmp_path / "no"))
    assert_one_line(broken, "walls[0].length_m", "-4.15")
    assert not (tmp_path / "no").exists()
    assert not list(tmp_path.glob(".no*"))


def test_build_makes_many_mazes(tmp_path: Path) -> None:
    out = tmp_path / "mazes"
    size = ("--set", "maze.rows=3", "--set", "maze.columns=3")
    built = mazebot("world", "build", "maze", *size, "--count", "2", "--out", str(out))
    assert built.returncode == 0, built.stderr
    maps = [(folder / "map.pgm").read_bytes() for folder in sorted(out.iterdir())]
    assert len(maps) == len(set(maps)) == 2


def test_import_reports_and_makes_a_recipe(yard: Path, tmp_path: Path) -> None:
    out = tmp_path / "worlds" / "yard.yaml"
    done = mazebot("world", "import", str(yard), "--json", "--out", str(out))
    report = json.loads(done.stdout)
    assert done.returncode == 0
    assert (report["models"], report["links"]) == (2, 2)
    assert report["collisions"] == {"box": 1, "plane": 1}
    assert {ignored["what"].split()[0] for ignored in report["ignored"]} >= {"plugin"}
    world = load_file(out).world
    (wall,) = world.walls
    assert (wall.x_m, wall.y_m, wall.length_m, wall.height_m) == (2.0, 1.0, 3.0, 1.0)


def test_import_refuses_what_is_wrong_and_writes_nothing(yard: Path, tmp_path: Path) -> None:
    yard.write_text(GAZEBO.replace("model://sun", "https://fuel.gazebosim.org/1.0/x/models/Elm"))
    out = tmp_path / "worlds" / "yard.yaml"
    done = mazebot("world", "import", str(yard), "--out", str(out))
    assert done.returncode == 1
    assert "URI_INVALID" in done.stderr
    assert "--path" in done.stderr
    assert not out.parent.exists()
    assert_one_line(mazebot("world", "import", str(yard), "--arg", "x=1"), "--arg", "name:=value")


def test_import_of_a_file_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    missing = tmp_path / "no.sdf"
    for verb in ("import", "show", "preview"):
        done = mazebot("world", verb, str(missing))
        assert_one_line(done, f"{missing}: no such file")
        assert done.stdout == ""
    assert mazebot("world", "check", str(missing)).stderr.count("no.sdf") == 1
    # Nor does one that cannot be read have anything to tell of.
    missing.write_text("<sdf")
    done = mazebot("world", "import", str(missing))
    assert_one_line(done, "no.sdf", "not well-formed XML")
    assert done.stdout == ""


def test_import_tells_what_is_renamed(yard: Path) -> None:
    joint = '<joint name="wall" type="fixed"><parent>world</parent><child>wall</child></joint>'
    yard.write_text(GAZEBO.replace("1.9", "1.6").replace("</link>", f"</link>{joint}"))
    done = mazebot("world", "import", str(yard))
    assert done.returncode == 0, done.stderr
    assert "renamed:    joint wall to wall_joint (yard.sdf:" in done.stdout


@pytest.mark.parametrize(
    ("option", "name", "right"), [("--out", "plan.jpg", ".png"), ("--glb", "model.obj", ".glb")]
)
def test_preview_writes_no_file_of_another_kind_than_its_name_says(
    room: Path, tmp_path: Path, option: str, name: str, right: str
) -> None:
    done = mazebot("world", "preview", str(room), option, str(tmp_path / name))
    assert_one_line(done, option, name, f"must end with {right}")
    assert not (tmp_path / name).exists()


def test_import_of_an_export_is_the_world(tmp_path: Path) -> None:
    assert mazebot("world", "export", "enhanced", "--out", str(tmp_path / "sdf")).returncode == 0
    file = tmp_path / "sdf" / "sim_house_enhanced.sdf"
    again = tmp_path / "again" / "sim_house_enhanced.yaml"
    path = ("--path", str(tmp_path / "sdf"))
    back = mazebot("world", "import", str(file), *path, "--out", str(again))
    assert back.returncode == 0, back.stderr
    one, two = load_world("sim_house_enhanced").world, load_file(again).world
    assert len(one.walls) == len(two.walls) == 30
    for a, b in zip(one.walls, two.walls, strict=True):
        assert a.name == b.name
        assert np.allclose(
            [a.length_m, a.thickness_m, a.height_m, a.x_m, a.y_m, a.yaw_rad],
            [b.length_m, b.thickness_m, b.height_m, b.x_m, b.y_m, b.yaw_rad],
            rtol=0.0, atol=1e-9,
        )  # fmt: skip
    assert [m.texture_sha256 for m in one.materials] == [m.texture_sha256 for m in two.materials]
    assert [marker.id for marker in one.markers] == [marker.id for marker in two.markers]
    assert one.locations == two.locations


def test_preview_draws_plan_and_model(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "plan.png"
    assert mazebot("world", "preview", str(room), "--out", str(out)).returncode == 0
    with Image.open(out) as plan:
        assert min(plan.size) > 200
    model = trimesh.load_scene(tmp_path / "plan.glb")
    # glTF's y is up: four metres on the floor both ways, and a metre high.
    _, high = model.bounds
    assert high[1] == pytest.approx(1.0)


def test_markers_make_writes_a_model(tmp_path: Path) -> None:
    made = mazebot("markers", "make", "12", "--size", "0.2", "--out", str(tmp_path))
    assert made.returncode == 0, made.stderr
    folder = tmp_path / "aruco_id_12"
    assert {path.name for path in folder.iterdir()} == {
        "model.config", "model.sdf", "meshes", "materials",
    }  # fmt: skip
    wrong = mazebot("markers", "make", "100", "--out", str(tmp_path))
    assert_one_line(wrong, "id: 100", "DICT_4X4_100")
    assert_one_line(mazebot("markers", "make", "1", "--kind", "ball"), "--kind", "panel, cube")
    unsized = mazebot("markers", "make", "1", "--size", "nan", "--out", str(tmp_path))
    assert_one_line(unsized, "size")


def test_names_that_are_none(tmp_path: Path) -> None:
    for verb in ("show", "preview"):
        assert_one_line(mazebot("world", verb, "atlantis"), "atlantis", "sim_house_enhanced")
    assert_one_line(mazebot("world", "show", str(tmp_path / "no.yaml")), "no.yaml")
    missing = mazebot("world", "check", str(tmp_path / "no.sdf"))
    assert missing.returncode == 1
    assert len(missing.stderr.splitlines()) == 1
    assert_one_line(mazebot("world", "show", "maze", "--set", "maze.rws=3"), "maze.rws", "rows")


def test_a_link_or_a_thing_that_is_no_file_is_never_replaced(room: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    plan = tmp_path / "shown.png"
    (tmp_path / "link.png").symlink_to(plan)
    (tmp_path / "empty").mkdir()
    (tmp_path / "to_empty").symlink_to(tmp_path / "empty")
    (tmp_path / "same.glb").symlink_to(tmp_path / "same.png")
    before = sorted(tmp_path.rglob("*"))
    for option, out, words in (
        ("--out", "pipe", "must be a file"),
        ("--out", "empty", "must be a file"),
        ("--glb", "pipe", "must be a file"),
        ("--out", "no/plan.png", "no such folder"),
        ("--glb", "no/plan.glb", "no such folder"),
        ("--out", "x" * 300, "cannot be"),
        ("--out", "room.yaml/x.png", "no such folder"),
    ):
        done = mazebot("world", "preview", str(room), option, str(tmp_path / out))
        assert_one_line(done, option, words)
    same = ("--out", str(tmp_path / "same.png"), "--glb", str(tmp_path / "same.glb"))
    done = mazebot("world", "preview", str(room), *same)
    assert_one_line(done, "--glb", "another file")
    for out in ("to_empty", "x" * 300, "room.yaml/x"):
        assert_one_line(mazebot("world", "build", str(room), "--out", str(tmp_path / out)), "--out")
    assert sorted(tmp_path.rglob("*")) == before
    link = str(tmp_path / "link.png")
    assert mazebot("world", "preview", str(room), "--out", link).returncode == 0
    assert (tmp_path / "link.png").is_symlink()
    assert plan.read_bytes()[:4] == b"\x89PNG"


def test_an_import_makes_only_what_can_be_loaded(yard: Path, tmp_path: Path) -> None:
    before = sorted(tmp_path.rglob("*"))
    for name in ("yard.txt", "my yard.yaml", ".yaml", "-yard.yaml", "h\u00f6f.yaml"):
        done = mazebot("world", "import", str(yard), "--out", str(tmp_path / "worlds" / name))
        assert_one_line(done, "--out", "NAME.yaml")
    assert sorted(tmp_path.rglob("*")) == before


def test_names_of_files_are_told_in_one_line(tmp_path: Path, room: Path) -> None:
    for name in ("a\nb.yaml", "x" * 300 + ".yaml", "x" * 300):
        assert_one_line(mazebot("world", "show", str(tmp_path / name)), "cannot be read")
    assert_one_line(mazebot("world", "import", str(tmp_path / "a\nb.sdf")), "no such file")
    assert_one_line(mazebot("world", "show", str(room), "--arg", "x:=1"), "--arg", "not an SDF")
    assert_one_line(mazebot("world", "show", str(room), "--path", "x"), "--path", "not an SDF")
    (tmp_path / "none").mkdir()
    empty = mazebot("world", "list", "--worlds-dir", str(tmp_path / "none"))
    assert_one_line(empty, "--worlds-dir", "contains no *.yaml")


def test_files_lie_where_names_have_spaces_and_letters_of_all_kinds(tmp_path: Path) -> None:
    folder = tmp_path / "h\u00e4user neu"
    folder.mkdir()
    (folder / "room.yaml").write_text(ROOM)
    (folder / "my yard.sdf").write_text(GAZEBO)
    room, yard = str(folder / "room.yaml"), str(folder / "my yard.sdf")
    for arguments in (
        ("check", room, yard),
        ("preview", yard, "--out", str(folder / "a plan.png")),
        ("export", room, "--out", str(folder / "sdf out")),
        ("import", str(folder / "sdf out" / "room.sdf"), "--out", str(folder / "again" / "r.yaml")),
    ):
        done = mazebot("world", *arguments)
        assert done.returncode == 0, done.stderr
    assert mazebot("world", "check", str(folder / "again" / "r.yaml")).returncode == 0

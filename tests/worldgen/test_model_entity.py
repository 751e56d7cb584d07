from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import Box, Cylinder, Mesh
from mazebot.common.world.geometry import mesh_from_bytes
from mazebot.worldgen.models.model_entity import find_model, lowest_m, read_mesh, read_model
from mazebot.worldgen.sdf.marker_model import write_marker_model

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
TABLE = """<?xml version="1.0"?>
<robot name="table">
  <material name="wood"><color rgba="0.6 0.4 0.2 1"/></material>
  <link name="top">
    <inertial><mass value="4.0"/></inertial>
    <visual><origin xyz="0 0 0.5"/><geometry><box size="1 0.6 0.05"/></geometry>
      <material name="wood"/></visual>
    <collision><origin xyz="0 0 0.5"/><geometry><box size="1 0.6 0.05"/></geometry></collision>
  </link>
  <link name="leg">
    <inertial><mass value="1.5"/></inertial>
    <visual><geometry><cylinder radius="0.05" length="0.5"/></geometry></visual>
    <visual><geometry><mesh filename="foot.obj" scale="0.1 0.1 0.1"/></geometry></visual>
    <collision><geometry><cylinder radius="0.05" length="0.5"/></geometry></collision>
  </link>
  <link name="nothing"/>
  <joint name="on" type="{kind}"><parent link="top"/><child link="leg"/>
    <origin xyz="0.2 0 0.25" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="in" type="fixed"><parent link="leg"/><child link="nothing"/></joint>
</robot>
"""
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.fixture
def table(tmp_path: Path) -> Path:
    (tmp_path / "foot.obj").write_text(TRIANGLE)
    file = tmp_path / "table.urdf"
    file.write_text(TABLE.format(kind="fixed"))
    return file


def sdf(tmp_path: Path, inside: str) -> Path:
    file = tmp_path / "m.sdf"
    file.write_text(f'<sdf version="1.9">\n{inside}\n</sdf>')
    return file


def solid(name: str, size: str = "1 1 1", pose: str = "0 0 0 0 0 0") -> str:
    box = f"<pose>{pose}</pose><geometry><box><size>{size}</size></box></geometry>"
    return f'<collision name="{name}">{box}</collision><visual name="{name}">{box}</visual>'


def test_the_links_of_a_urdf_become_one_body(table: Path) -> None:
    model = read_model(table)
    assert model.mass_kg == pytest.approx(5.5, abs=1e-3)
    top, foot, leg = model.shapes
    assert isinstance(top.geometry, Box)
    assert isinstance(leg.geometry, Cylinder)
    assert isinstance(foot.geometry, Mesh)
    assert (top.position_m, leg.position_m) == ((0.0, 0.0, 0.5), (0.2, 0.0, 0.25))
    assert leg.orientation_xyzw == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    assert (top.solid, leg.solid, foot.solid) == (True, True, False)
    wood = next(one for one in model.materials if one.name == top.material)
    assert wood.diffuse == (0.6, 0.4, 0.2, 1.0)
    assert foot.geometry.scale == (0.1, 0.1, 0.1)
    data = model.assets[foot.geometry.sha256]
    assert hashlib.sha256(data).hexdigest() == foot.geometry.sha256
    assert len(mesh_from_bytes(data).triangles) == 1
    assert lowest_m(model.shapes, model.meshes, UPRIGHT) == pytest.approx(0.0)


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic"])
def test_a_joint_that_moves_is_refused_by_its_name(table: Path, kind: str) -> None:
    table.write_text(TABLE.format(kind=kind))
    with pytest.raises(ConfigError) as refused:
        read_model(table)
    said = str(refused.value)
    assert said.startswith("table.urdf:17: model table/joint on: ")
    assert f"joint table::on ({kind}): must be fixed" in said
    assert "\n" not in said


def test_what_a_urdf_gets_wrong_is_told_with_its_line(table: Path) -> None:
    table.write_text(TABLE.format(kind="fixed").replace('value="1.5"', 'value="heavy"'))
    with pytest.raises(ConfigError, match=r"table\.urdf:11: .*`heavy` must be a finite number"):
        read_model(table)


def test_what_of_a_urdf_is_only_seen_may_be_missing(table: Path, tmp_path: Path) -> None:
    table.write_text(TABLE.format(kind="fixed").replace("foot.obj", "gone.obj"))
    model = read_model(table)
    assert [shape.name for shape in model.shapes if shape.solid]
    assert any("table.urdf:13: " in one and "`gone.obj` does not" in one for one in model.missing)
    seen = tmp_path / "seen.urdf"
    seen.write_text(
        '<robot name="r"><link name="a"><visual><geometry><mesh filename="gone.obj"/></geometry>'
        "</visual></link></robot>"
    )
    with pytest.raises(ConfigError, match=r"seen\.urdf:1: .*`gone.obj` does not exist"):
        read_model(seen)


def test_a_urdf_without_a_mass_stands_still(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_text(
        '<robot name="r"><link name="world"/><link name="a"><collision><geometry>'
        '<sphere radius="0.2"/></geometry></collision></link><joint name="j" type="fixed">'
        '<parent link="world"/><child link="a"/><origin xyz="0 0 1"/></joint></robot>'
    )
    model = read_model(file)
    assert model.mass_kg == 0.0
    assert model.shapes[0].position_m == (0.0, 0.0, 1.0)
    assert model.shapes[0].material == ""


def test_an_sdf_model_is_seen_from_its_own_frame(tmp_path: Path) -> None:
    model = f'<model name="m"><pose>5 6 7 0 0 1</pose><link name="l">{solid("s")}</link></model>'
    (shape,) = read_model(sdf(tmp_path, model)).shapes
    assert shape.position_m == pytest.approx((0.0, 0.0, 0.0))
    assert shape.orientation_xyzw == pytest.approx(UPRIGHT)


def test_links_of_a_static_model_are_one_and_an_upright_box_is_no_wall(tmp_path: Path) -> None:
    upright = solid("s", pose="0 0 0.5 0 0 0")
    links = f'<link name="a">{upright}</link><link name="b">{upright}</link>'
    model = read_model(sdf(tmp_path, f'<model name="m"><static>1</static>{links}</model>'))
    assert model.mass_kg == 0.0
    assert len({shape.name for shape in model.shapes}) == 2


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        (f'<model name="m"><link name="a">{solid("s")}</link><link name="b"/></model>',
         "link 'm::b': must be joined to 'm::a' by fixed joints"),
        (f'<world name="w"><model name="m"><link name="a">{solid("s")}</link></model>'
         f'<model name="n"><link name="a">{solid("s")}</link></model></world>',
         "must contain one model, has m, n"),
        ('<model name="m"><link name="a"/></model>', "contains only a floor, must contain a body"),
        ('<model name="m"><link name="a"><collision name="c"><geometry><box><size>1 1 -1</size>'
         '</box></geometry></collision></link></model>', "m.sdf:2: model m/link a"),
        ("<light/>", "must"),
    ],
)  # fmt: skip
def test_what_is_not_one_rigid_model_is_refused(tmp_path: Path, inside: str, words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        read_model(sdf(tmp_path, inside))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_markers_model_says_which_marker_it_is(tmp_path: Path) -> None:
    folder = write_marker_model(tmp_path, 12, "DICT_5X5_50", 0.25, "panel", 2)
    assert read_model(folder).marker == {
        "marker": "12", "dictionary": "DICT_5X5_50", "size_m": "0.25", "quiet_zone_modules": "2",
    }  # fmt: skip


def test_models_are_found_by_name_in_folders_and_among_those_that_come_with_it(
    tmp_path: Path,
) -> None:
    assert find_model("aruco_id_60").name == "aruco_id_60"
    (tmp_path / "chair").mkdir()
    assert find_model("chair", [tmp_path]) == tmp_path / "chair"
    with pytest.raises(ConfigError, match="model: 'chair': must be a file, a folder, or one of"):
        find_model("chair")


def test_a_mesh_has_the_files_own_look(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    faces = "usemtl red\nf 1 2 3\nusemtl blue\nf 1 3 2\n"
    file = tmp_path / "m.obj"
    file.write_text("mtllib m.mtl\n" + TRIANGLE.partition("f")[0] + faces)
    model = read_mesh(file, (2.0, 2.0, 2.0))
    assert {one.diffuse for one in model.materials} == {(1.0, 0, 0, 1.0), (0, 0, 1.0, 1.0)}
    assert len(model.shapes) == 2
    assert set(model.meshes) == set(model.assets)
    up = math.sqrt(0.5)
    assert lowest_m(model.shapes, model.meshes, (up, 0.0, 0.0, up)) == pytest.approx(0.0)
    assert lowest_m(model.shapes, model.meshes, (-up, 0.0, 0.0, up)) == pytest.approx(-2.0)
    with pytest.raises(ConfigError, match="scale"):
        read_mesh(file, (0.0, 1.0, 1.0))


def test_random_bytes_are_no_model(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    for suffix in (".sdf", ".urdf", ".obj", ".stl", ".glb", ".dae"):
        file = tmp_path / f"x{suffix}"
        file.write_bytes(random.bytes(300))
        read = read_model if suffix in (".sdf", ".urdf") else read_mesh
        with pytest.raises(ConfigError) as refused:
            read(file)
        assert "\n" not in str(refused.value)


def test_a_mesh_without_its_materials_is_a_model_and_they_are_named(tmp_path: Path) -> None:
    file = tmp_path / "wedge.obj"
    file.write_text(
        "mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    assert read_mesh(file).missing == ("wedge.obj: 'gone.mtl': no such file",)

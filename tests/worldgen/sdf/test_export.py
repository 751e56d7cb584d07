from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from mazebot.common.config import ConfigError
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_file, load_world
from mazebot.worldgen.sdf.export import MANIFEST, export_files, export_world
from mazebot.worldgen.sdf.model import MAZEBOT_NAMESPACE
from mazebot.worldgen.sdf.reading.read import read_sdf
from tests.worldgen import folder
from tests.worldgen.sdf import everything

OURS = f"{{{MAZEBOT_NAMESPACE}}}"


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> LoadedWorld:
    return load_file(everything.make(tmp_path_factory.mktemp("worlds")))


@pytest.mark.parametrize("name", ["sim_house", "sim_house_enhanced", "sim_house_slam"])
def test_the_houses_come_back_as_they_went_out(tmp_path: Path, name: str) -> None:
    house = load_world(name)
    back = everything.there_and_back(house, tmp_path)
    assert back.world == house.world
    assert back.assets == house.assets
    assert (back.map_cells == house.map_cells).all()


def test_a_world_of_everything_comes_back(loaded: LoadedWorld, tmp_path: Path) -> None:
    kinds = {shape.geometry.kind for body in loaded.world.bodies for shape in body.shapes}
    assert len(kinds) == 9
    back = everything.there_and_back(loaded, tmp_path)
    assert everything.differences(loaded.world, back.world) == []
    # To the last bit, so that the hash is the same too.
    assert back.world == loaded.world
    assert back.assets == loaded.assets
    assert (back.map_cells == loaded.map_cells).all()


def test_zones_come_back(tmp_path: Path) -> None:
    square = [[0.0, 0.0], [0.5, 0.0], [0.5, 0.5]]
    made = folder.room() | {
        "keepout_zones": [{"name": "carpet", "polygon_m": square}],
        "speed_limits": [{"name": "slow", "polygon_m": square, "percent": 30.0}],
    }
    zoned = load_file(everything.make(tmp_path / "worlds", made))
    assert everything.there_and_back(zoned, tmp_path).world == zoned.world


def test_a_ready_map_goes_with_its_world(tmp_path: Path) -> None:
    from mazebot.common.world.map_files import write_map

    worlds = tmp_path / "worlds"
    made = folder.room()
    plain = load_file(everything.make(worlds, made))
    (worlds / "maps").mkdir()
    cells = np.array(plain.map_cells)
    cells[:3] = 100
    write_map(worlds / "maps", "hall", cells, 0.1, plain.map_origin)
    ready = load_file(everything.make(worlds, {**made, "map": "hall.yaml"}))
    assert ready.world.map_sha256
    back = everything.there_and_back(ready, tmp_path)
    assert everything.differences(ready.world, back.world) == []
    assert (back.map_cells == cells).all()


def test_sdf_holds_every_wall_twice_where_it_is(loaded: LoadedWorld) -> None:
    root = everything.root_of(loaded)
    for wall in loaded.world.walls:
        (model,) = root.xpath(f"world/model[@name='{wall.name}']")
        assert model.findtext("static") == "true"
        pose = [float(value) for value in model.findtext("pose").split()]
        assert pose == [wall.x_m, wall.y_m, wall.height_m / 2, 0, 0, wall.yaw_rad]
        size = [wall.length_m, wall.thickness_m, wall.height_m]
        for part in ("collision", "visual"):
            found = model.find(f"link/{part}")
            assert found.find("pose") is None
            assert [float(v) for v in found.findtext("geometry/box/size").split()] == size
    material = root.find("world/model[@name='south']/link/visual/material")
    assert material.findtext("diffuse") == "0.8 0.4 0.3 1"
    assert material.findtext("pbr/metal/albedo_map") == "materials/textures/brick.png"
    assert material.findtext("pbr/metal/roughness") == "1"
    assert material.findtext("pbr/metal/metalness") == "0"


def test_a_covering_lies_on_its_wall(loaded: LoadedWorld) -> None:
    visual = everything.root_of(loaded).xpath("world/model[@name='post']/link/visual[2]")[0]
    x, y, z, *turns = (float(value) for value in visual.findtext("pose").split())
    length_m, thickness_m, height_m = (
        float(value) for value in visual.findtext("geometry/box/size").split()
    )
    assert (x - length_m / 2, x + length_m / 2) == pytest.approx((-0.05, 0.02))
    assert y + thickness_m / 2 == pytest.approx(-0.15)
    assert (z, height_m, turns) == (0.0, 1 / 3, [0, 0, 0])
    # Behind the panels of markers.
    assert 0.0 < thickness_m < 0.001


def test_sun_lamps_and_scene(loaded: LoadedWorld) -> None:
    world = everything.root_of(loaded).find("world")
    assert world.findtext("scene/ambient") == "0.55 0.55 0.55 1"
    assert world.findtext("scene/background") == "0.5 0.6 0.7 1"
    (sun,) = world.findall("light[@type='directional']")
    assert sun.findtext("direction") == "0.3 -0.2 -2"
    assert sun.findtext("diffuse") == "0.65 0.65 0.65 1"
    assert sun.findtext("cast_shadows") == "false"
    lamp = world.find("light[@name='lamp']")
    assert lamp.get("type") == "point"
    assert lamp.findtext("pose") == "0.5 -0.25 2.5 0 0 0"
    assert [lamp.findtext(f"attenuation/{tag}") for tag in ("range", "constant", "linear")] == [
        "7.5", "0.3", "0.2",
    ]  # fmt: skip


def test_only_what_has_a_mass_may_fall(loaded: LoadedWorld) -> None:
    world = everything.root_of(loaded).find("world")
    moving = [m.get("name") for m in world.findall("model") if m.findtext("static") == "false"]
    assert moving == ["ball", "kegs"]
    for model in world.findall("model"):
        inertial = model.find("link/inertial")
        assert (inertial is not None) == (model.get("name") in moving)
        if inertial is not None:
            moments = [float(inertial.findtext(f"inertia/{tag}")) for tag in ("ixx", "iyy", "izz")]
            assert min(moments) > 0.0
            # No body can have other moments.
            assert max(moments) <= sum(moments) - max(moments) + 1e-12
    assert world.findtext("model[@name='ball']/link/inertial/mass") == "0.25"


def test_the_sdf_is_one_that_gazebo_takes(loaded: LoadedWorld, tmp_path: Path) -> None:
    file = export_world(loaded, tmp_path / "sdf")
    root = etree.parse(file).getroot()
    assert root.tag == "sdf"
    # Cones came with 1.11.
    assert root.get("version") == "1.11"
    for parent in root.iter("world", "model", "link"):
        names = [child.get("name") for child in parent if child.get("name") is not None]
        names += [child.findtext("name") for child in parent.findall("include")]
        assert [name for name, count in Counter(names).items() if count > 1] == []
        for name in names:
            assert name != "world"
            assert "::" not in name
            assert not re.fullmatch("__.*__", name)
    for element in root.iter("model", "link", "collision", "visual", "light"):
        assert element.get("name")
    assert {light.get("type") for light in root.iter("light")} == {"directional", "point"}
    for plane in root.iter("plane"):
        assert plane.findtext("normal") == "0 0 1"
        assert len(plane.findtext("size").split()) == 2
    # Everything it names is in the folder, under a name from there.
    named = [element.text for element in root.iter("uri", "albedo_map")]
    assert len(named) > 10
    for uri in named:
        target = tmp_path / "sdf" / uri.removeprefix("model://")
        assert not uri.startswith(("/", "file:", ".."))
        assert target.exists()
    assert read_sdf(file, (file.parent,)).report.errors == ()


def test_each_marker_that_hangs_is_a_model_beside_the_world(loaded: LoadedWorld) -> None:
    files = export_files(loaded)
    root = everything.root_of(loaded)
    included = [include.findtext("uri") for include in root.iter("include")]
    assert included == ["model://aruco_id_3", "model://aruco_id_9"]
    for marker_id in (3, 9):
        assert f"aruco_id_{marker_id}/model.config" in files
        assert f"aruco_id_{marker_id}/model.sdf" in files
    # What the robot's camera sees of it.
    texture = hashlib.sha256(files["aruco_id_3/materials/textures/3.png"]).hexdigest()
    from mazebot.common.world.marker_entities import marker_entities

    entities, _ = marker_entities(loaded.world)
    assert texture == entities.markers[0].texture_sha256
    notes = json.loads(root.findtext(f"world/{OURS}world/{OURS}markers"))
    assert ["model" in note for note in notes] == [True, True, False, False]


def test_same_world_same_bytes(loaded: LoadedWorld) -> None:
    assert export_files(loaded) == export_files(loaded)


def test_a_former_export_is_replaced_and_nothing_else(loaded: LoadedWorld, tmp_path: Path) -> None:
    target = tmp_path / "sdf"
    export_world(loaded, target)
    house = load_world("sim_house")
    file = export_world(house, target)
    assert sorted(path.name for path in target.iterdir()) == [MANIFEST, "sim_house.sdf"]
    (target / "mine.sdf").write_text("mine")
    before = file.stat().st_mtime_ns
    with pytest.raises(ConfigError, match=r"sdf: contains mine\.sdf, which") as error:
        export_world(loaded, target)
    assert "\n" not in str(error.value)
    assert file.stat().st_mtime_ns == before
    assert (target / "mine.sdf").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["sdf"]


def test_a_folder_that_cannot_be_is_one_line(loaded: LoadedWorld, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for target in (tmp_path / "file", tmp_path / "file/below"):
        with pytest.raises(ConfigError) as error:
            export_world(loaded, target)
        assert str(error.value).startswith(str(target))
    with pytest.raises(ConfigError, match=r"contains file"):
        export_world(loaded, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]

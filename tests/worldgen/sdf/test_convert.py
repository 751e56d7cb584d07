from __future__ import annotations

import io
import math
import time
from pathlib import Path
from typing import Any

import pytest
import yaml
from PIL import Image

from mazebot.common.config import ConfigError
from mazebot.common.world.marker_entities import marker_entities
from mazebot.worldgen.check import problems_of
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_file, load_world
from mazebot.worldgen.recipe_model import Recipe
from mazebot.worldgen.sdf.convert import MAX_LIGHTS, to_recipe
from mazebot.worldgen.sdf.export import export_world
from mazebot.worldgen.sdf.reading.read import read_sdf
from mazebot.worldgen.sdf.recipe_file import ImportedWorld, recipe_yaml, write_recipe
from tests.worldgen import folder
from tests.worldgen.sdf import everything

GROUND = """<model name="ground_plane"><static>true</static><link name="link">
  <collision name="collision"><geometry><plane><normal>0 0 1</normal><size>100 100</size></plane>
  </geometry></collision>
  <visual name="visual"><geometry><plane><normal>0 0 1</normal><size>50 50</size></plane></geometry>
  <material><ambient>0.1 0.2 0.3 1</ambient><diffuse>0.3 0.2 0.1 1</diffuse></material></visual>
</link></model>"""
BLUE = "<material><ambient>0 0 1 1</ambient><diffuse>0 0 0.5 1</diffuse></material>"


def box(size: str) -> str:
    return f"<geometry><box><size>{size}</size></box></geometry>"


def both(geometry: str, look: str = BLUE, pose: str = "0 0 0 0 0 0") -> str:
    """A collision and a visual of it."""
    return (
        f'<collision name="c"><pose>{pose}</pose>{geometry}</collision>'
        f'<visual name="v"><pose>{pose}</pose>{geometry}{look}</visual>'
    )


def model(name: str, inside: str, pose: str = "0 0 0 0 0 0", static: bool = True) -> str:
    return (
        f'<model name="{name}"><static>{str(static).lower()}</static><pose>{pose}</pose>{inside}'
        "</model>"
    )


def link(name: str, inside: str, pose: str = "0 0 0 0 0 0") -> str:
    return f'<link name="{name}"><pose>{pose}</pose>{inside}</link>'


def imported(where: Path, inside: str, name: str = "hall") -> ImportedWorld:
    where.mkdir(exist_ok=True)
    file = where / f"{name}.sdf"
    file.write_text(f'<sdf version="1.9"><world name="w">{inside}</world></sdf>')
    sdf = read_sdf(file, (where,))
    assert sdf.report.errors == ()
    world = to_recipe(sdf, name)
    Recipe.model_validate(yaml.safe_load(recipe_yaml(world.recipe)), strict=False)
    return world


def new(world: ImportedWorld, known: str) -> list[str]:
    """What is ignored and has to do with it."""
    return [one.what for one in world.report.ignored if known in one.what]


def test_a_visible_static_box_on_the_floor_is_a_wall(tmp_path: Path) -> None:
    world = imported(
        tmp_path,
        model(
            "house",
            link("w1", both(box("3 0.2 2")), "1 2 1 0 0 0.5")
            + link("w2", both(box("0.2 4 2.5")), "0 0 1.25 0 0 0"),
            "10 0 0 0 0 1",
        )
        + model("lone", link("link", both(box("1 0.1 1"))), "0 5 0.5005 0 0 0"),
    )
    c, s = math.cos(1.0), math.sin(1.0)
    first, second, third = (
        {"thickness_m": world.recipe["wall_thickness_m"], **wall} for wall in world.recipe["walls"]
    )
    assert first["name"] == "w1"
    assert (first["length_m"], first["thickness_m"]) == (3.0, 0.2)
    assert first["x_m"] == pytest.approx(10 + c - 2 * s)
    assert first["y_m"] == pytest.approx(s + 2 * c)
    assert first["yaw_rad"] == pytest.approx(1.5)
    # A wall runs along the longer side of its box.
    assert (second["length_m"], second["thickness_m"]) == (4.0, 0.2)
    assert second["yaw_rad"] == pytest.approx(1.0 + math.pi / 2)
    assert third["name"] == "lone"
    assert "bodies" not in world.recipe
    assert world.recipe["materials"][first["material"]]["diffuse"] == [0.0, 0.0, 0.5, 1.0]


@pytest.mark.parametrize(
    "thing",
    [
        model("x", link("l", both(box("1 1 1"))), "0 0 0.502 0 0 0"),
        model("x", link("l", both(box("1 1 1"))), "0 0 0.5 0.01 0 0"),
        model("x", link("l", f'<collision name="c">{box("1 1 1")}</collision>'), "0 0 0.5 0 0 0"),
        model(
            "x",
            link("l", both(box("1 1 1")) + f'<visual name="top">{box("2 2 0.1")}</visual>'),
            "0 0 0.5 0 0 0",
        ),
        model("x", link("l", both("<geometry><sphere><radius>1</radius></sphere></geometry>"))),
    ],
    ids=["hovers", "leans", "unseen", "has a top", "round"],
)
def test_anything_else_is_a_body(tmp_path: Path, thing: str) -> None:
    world = imported(tmp_path, thing)
    assert "walls" not in world.recipe
    (body,) = world.recipe["bodies"]
    assert body["name"] == "x"
    assert "mass_kg" not in body


def test_collision_and_visual_of_one_shape_are_one(tmp_path: Path) -> None:
    ball = "<geometry><sphere><radius>0.5</radius></sphere></geometry>"
    inside = (
        both(ball, pose="0 0 1 0 0 0")
        + f'<collision name="lone">{ball}</collision>'
        + f'<visual name="shine"><pose>0 0 1.1 0 0 0</pose>{ball}</visual>'
    )
    (body,) = imported(tmp_path, model("m", link("l", inside))).recipe["bodies"]
    shapes = {shape["name"]: shape for shape in body["shapes"]}
    assert set(shapes) == {"c", "lone", "shine"}
    assert "material" in shapes["c"]
    assert shapes["c"].get("solid", True)
    assert "material" not in shapes["lone"]
    assert shapes["shine"]["solid"] is False


def test_links_that_fixed_joints_make_one_are_one_body(tmp_path: Path) -> None:
    ball = "<geometry><sphere><radius>0.1</radius></sphere></geometry>"
    mass = "<inertial><mass>{}</mass></inertial>"
    world = imported(
        tmp_path,
        model(
            "m",
            link("a", mass.format(1.5) + both(ball), "0 0 1 0 0 0")
            + link("b", mass.format(0.25) + both(ball), "0 0.5 1 0 0 0")
            + '<joint name="j" type="fixed"><parent>a</parent><child>b</child></joint>',
            "3 0 0 0 0 0",
            static=False,
        ),
    )
    (body,) = world.recipe["bodies"]
    assert body["mass_kg"] == 1.75
    assert body["position_m"] == [3.0, 0.0, 1.0]
    assert [shape.get("position_m", [0.0, 0.0, 0.0]) for shape in body["shapes"]] == [
        [0.0, 0.0, 0.0], [0.0, 0.5, 0.0],
    ]  # fmt: skip
    names = [shape["name"] for shape in body["shapes"]]
    assert len(set(names)) == 2


def test_the_ground_plane_is_the_floor_and_no_other_plane_is_solid(tmp_path: Path) -> None:
    plane = "<geometry><plane><normal>{}</normal><size>2 3</size></plane></geometry>"
    world = imported(
        tmp_path,
        GROUND
        + model("slope", link("l", f'<collision name="c">{plane.format("0 1 1")}</collision>'))
        + model("poster", link("l", f'<visual name="v">{plane.format("1 0 0")}</visual>')),
    )
    floor = world.recipe["materials"][world.recipe["floor_material"]]
    assert floor["diffuse"] == [0.3, 0.2, 0.1, 1.0]
    assert new(world, "plane") == ["plane collision that is not the floor"]
    (body,) = world.recipe["bodies"]
    (shape,) = body["shapes"]
    assert body["name"] == "poster"
    assert shape["geometry"] == {"kind": "plane", "size_m": [2.0, 3.0]}
    assert shape["solid"] is False
    # The normal, z in the shape's frame, is x in the world's.
    x, y, z, w = shape["orientation_xyzw"]
    assert (2 * (x * z + y * w), 1 - 2 * (x * x + y * y)) == pytest.approx((1.0, 0.0), abs=1e-9)


def test_lights_and_sky(tmp_path: Path) -> None:
    lamps = "".join(
        f'<light type="point" name="p{n}"><pose>0 0 {n + 1} 0 0 0</pose><attenuation>'
        "<range>5</range><linear>0.5</linear></attenuation></light>"
        for n in range(MAX_LIGHTS + 1)
    )
    world = imported(
        tmp_path,
        "<scene><ambient>0.2 0.4 0.6 1</ambient><background>0.1 0.2 0.3 1</background></scene>"
        '<light type="directional" name="sun"><pose>0 0 9 0 0 1.5707963267948966</pose>'
        "<diffuse>0.5 0.5 0.5 1</diffuse><direction>1 0 -1</direction></light>"
        '<light type="directional" name="moon"/><light type="spot" name="torch"/>' + lamps,
    )
    light = world.recipe["light"]
    assert light["direction"] == pytest.approx([0.0, 1.0, -1.0])
    assert (light["ambient"], light["diffuse"]) == (pytest.approx(0.4), 0.5)
    assert world.recipe["sky"] == [0.1, 0.2, 0.3, 1.0]
    assert [lamp["name"] for lamp in world.recipe["lights"]] == [f"p{n}" for n in range(MAX_LIGHTS)]
    assert world.recipe["lights"][2]["position_m"] == [0.0, 0.0, 3.0]
    assert (world.recipe["lights"][0]["range_m"], world.recipe["lights"][0]["linear"]) == (5.0, 0.5)
    assert new(world, "light") == [
        "spot light torch",
        "directional light moon, the second",
        "point light p8, the ninth or later",
    ]


def pbr(picture: str) -> str:
    return f"<material><pbr><metal><albedo_map>{picture}</albedo_map></metal></pbr></material>"


def test_pictures_become_png(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    (tmp_path / "a/paint.png").write_bytes(folder.png())
    (tmp_path / "b/paint.png").write_bytes(folder.png(32, 32))
    Image.new("RGB", (3000, 30), (10, 200, 30)).save(tmp_path / "b/leaf.jpg")
    (tmp_path / "a/cut.png").write_bytes(folder.png()[:40])
    inside = "".join(
        model(f"m{n}", link("l", both(box("1 1 1"), pbr(name)), f"{2 * n} 0 0.5 0 0 0"))
        for n, name in enumerate(("a/paint.png", "b/paint.png", "b/leaf.jpg", "a/cut.png"))
    )
    world = imported(tmp_path, inside)
    looks = [world.recipe["materials"][wall["material"]] for wall in world.recipe["walls"]]
    assert [look.get("texture") for look in looks] == [
        "paint.png", "paint_2.png", "leaf.png", None,
    ]  # fmt: skip
    assert [look["texture_side_m"] for look in looks[:3]] == [0.0, 0.0, 0.0]
    assert world.files["textures/paint.png"] == folder.png()
    with Image.open(io.BytesIO(world.files["textures/leaf.png"])) as leaf:
        assert (leaf.format, leaf.size) == ("PNG", (2048, 20))
    assert world.report.errors == ()
    (error,) = world.report.missing
    assert error.kind == "MATERIAL_INVALID"
    assert "cut.png" in error.message
    assert "\n" not in error.message


def test_meshes_become_glb(tmp_path: Path) -> None:
    (tmp_path / "two.glb").write_bytes(everything.two_parts())
    (tmp_path / "cut.glb").write_bytes(everything.two_parts()[:100])
    mesh = "<geometry><mesh><uri>{}</uri>{}<scale>1 1 2</scale></mesh></geometry>"
    part = "<submesh><name>pyramid</name><center>{}</center></submesh>"
    world = imported(
        tmp_path,
        model("whole", link("l", both(mesh.format("two.glb", ""), "")), "4 0 0 0 0 0")
        + model(
            "part", link("l", both(mesh.format("two.glb", part.format("false")))), "0 4 0 0 0 0"
        )
        + model(
            "centred", link("l", both(mesh.format("two.glb", part.format("true")))), "4 4 0 0 0 0"
        )
        + model("gone", link("l", both(mesh.format("cut.glb", "")))),
    )
    bodies = {body["name"]: body["shapes"] for body in world.recipe["bodies"]}
    assert set(bodies) == {"whole", "part", "centred"}
    assert len(bodies["whole"]) == 1
    # Its own materials, where the file names no other.
    assert bodies["whole"][0]["material"] == bodies["whole"][0]["geometry"]["file"] == "two.glb"
    assert bodies["part"][0]["geometry"]["submesh"] == "pyramid"
    assert bodies["part"][0]["material"] in world.recipe["materials"]
    assert {error.kind for error in world.report.errors} == {"MESH_INVALID"}
    write_recipe(world, tmp_path / "out/hall.yaml")
    loaded = load_file(tmp_path / "out/hall.yaml")
    shapes = {body.name: body.shapes for body in loaded.world.bodies}
    assert len(shapes["whole"]) == 2
    assert len(shapes["part"]) == len(shapes["centred"]) == 1
    colours = {material.name: material.diffuse for material in loaded.world.materials}
    assert [round(255 * value) for value in colours[shapes["whole"][0].material][:3]] in (
        [200, 30, 40], [20, 130, 40],
    )  # fmt: skip
    centred = loaded.meshes[shapes["centred"][0].geometry.sha256]  # type: ignore[union-attr]
    assert (centred.vertices_m.max(0) + centred.vertices_m.min(0)) == pytest.approx([0, 0, 0])


def test_names_are_those_of_recipes_and_each_is_given_once(tmp_path: Path) -> None:
    wall = both(box("1 0.1 1"))
    world = imported(
        tmp_path,
        model(
            "left room", link("wall #1", wall, "0 0 0.5 0 0 0") + link("b", wall, "1 0 0.5 0 0 0")
        )
        + model("right", link("wall #1", wall, "2 0 0.5 0 0 0") + link("b", wall, "3 0 0.5 0 0 0"))
        + model("n" * 80, link("l", wall, "4 0 0.5 0 0 0")),
    )
    names = [one["name"] for one in world.recipe["walls"]]
    assert names[:2] == ["wall__1", "b"]
    assert names[2:4] == ["right.wall__1", "right.b"]
    assert len(set(names)) == 5
    assert len(names[4]) == 64


def moved(text: str, before: str, after: str) -> str:
    assert text.count(before) == 1
    return text.replace(before, after)


@pytest.fixture(scope="module")
def house() -> LoadedWorld:
    return load_world("sim_house_enhanced")


def edited(house: LoadedWorld, where: Path, *changes: tuple[str, str]) -> ImportedWorld:
    """The import of an export in which somebody has changed something."""
    file = export_world(house, where / "sdf")
    text = file.read_text()
    for before, after in changes:
        text = moved(text, before, after)
    file.write_text(text)
    return everything.imported(file)


def test_a_wall_moved_in_the_file_is_moved(house: LoadedWorld, tmp_path: Path) -> None:
    world = edited(
        house, tmp_path, ("<pose>-1.21419 -2.03381 1.5 0 0 0<", "<pose>-1 -2.5 1.5 0 0 0.25<")
    )
    wall = world.recipe["walls"][0]
    assert (wall["name"], wall["x_m"], wall["y_m"]) == ("Wall_0", -1.0, -2.5)
    assert wall["yaw_rad"] == pytest.approx(0.25)
    back = everything.reloaded(world, tmp_path / "back")
    assert back.world.walls[1:] == house.world.walls[1:]


def test_a_wall_painted_in_the_file_is_painted(house: LoadedWorld, tmp_path: Path) -> None:
    file = export_world(house, tmp_path / "sdf")
    head, rest = file.read_text().split('<model name="Wall_10">')
    file.write_text(head.replace("0.8 0.4 0.3 1", "0 1 0 1") + '<model name="Wall_10">' + rest)
    world = everything.imported(file)
    materials = {wall["name"]: wall["material"] for wall in world.recipe["walls"]}
    looks = world.recipe["materials"]
    # Wall_0 has its new colour; the other brick walls have theirs.
    assert looks[materials["Wall_0"]]["diffuse"] == [0.0, 1.0, 0.0, 1.0]
    assert looks[materials["Wall_11"]]["diffuse"] == [0.8, 0.4, 0.3, 1.0]
    assert looks[materials["Wall_0"]]["texture"] == "bricks.png"


def pose_of_marker(house: LoadedWorld, marker_id: int) -> str:
    root = everything.root_of(house)
    (pose,) = root.xpath(f"world/include[name='aruco_{marker_id}']/pose/text()")
    return str(pose)


@pytest.mark.parametrize("wall_name", ["Wall_6", "Wall_9", "Wall_10"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_marker_moved_to_another_wall_hangs_there(
    house: LoadedWorld, tmp_path: Path, wall_name: str, sign: float
) -> None:
    wall = next(one for one in house.world.walls if one.name == wall_name)
    c, s = math.cos(wall.yaw_rad), math.sin(wall.yaw_rad)
    out_m = sign * (wall.thickness_m / 2 + 0.004)
    x, y = wall.x_m + c * 0.3 - s * out_m, wall.y_m + s * 0.3 + c * out_m
    # Its right, as one looks at it, is against the wall's x axis on the left face.
    yaw = wall.yaw_rad + (math.pi if sign > 0 else 0.0)
    world = edited(
        house, tmp_path, (pose_of_marker(house, 80), f"{x} {y} 0.7 {math.pi / 2} 0 {yaw}")
    )
    first, second = world.recipe["markers"]
    assert (first["id"], first["wall"], first["side"]) == (60, "Wall_25", "right")
    assert (second["id"], second["wall"]) == (80, wall_name)
    assert second["side"] == ("left" if sign > 0 else "right")
    assert (second["offset_m"], second["height_m"]) == pytest.approx((0.3, 0.7))
    assert (second["size_m"], second["dictionary"]) == (0.3, "DICT_4X4_100")


@pytest.mark.parametrize(
    ("pose", "why"),
    [
        ("0 0 0.25 1.5707963267948966 0 0", "is not on a wall"),
        ("-1.798 0.427 9 1.5707963267948966 0 1.5707963267948966", "is not on a wall"),
        ("-1.8 1.6 0.25 1.5707963267948966 0 1.5707963267948966", "is not on a wall"),
        ("-1.798 0.427 0.25 0 0 0", "lies flat"),
        ("-1.798 0.427 0.25 1.1707963267948966 0 1.5707963267948966", "leans by 22.9 degrees"),
        ("-1.798 0.427 0.25 1.5707963267948966 3.14159265 1.570796327", "is turned by 180.0"),
        ("-1.798 0.427 0.25 1.5707963267948966 0.5235987755982988 1.5707963267948966",
         "is turned by 30.0 degrees in its plane"),
    ],
    ids=["in mid-room", "above", "past its end", "lying", "leaning", "upside down", "turned"],
)  # fmt: skip
def test_a_marker_off_its_wall_is_left_out_with_a_warning(
    house: LoadedWorld, tmp_path: Path, pose: str, why: str
) -> None:
    world = edited(house, tmp_path, (pose_of_marker(house, 80), pose))
    assert [marker["id"] for marker in world.recipe["markers"]] == [60]
    (listed,) = new(world, "marker")
    assert listed.startswith(f"marker 80, which {why}")
    (warning,) = world.report.warnings()
    assert warning.startswith(f"marker 80 (aruco_80) is left out, for it {why}")


def test_a_marker_added_or_taken_away_in_the_file(house: LoadedWorld, tmp_path: Path) -> None:
    file = export_world(house, tmp_path / "sdf")
    from mazebot.worldgen.sdf.marker_model import write_marker_model

    write_marker_model(file.parent, 7, size_m=0.1)
    text = file.read_text().replace("model://aruco_id_60", "model://aruco_id_7")
    file.write_text(text)
    markers = everything.imported(file).recipe["markers"]
    assert [(marker["id"], marker["size_m"]) for marker in markers] == [(7, 0.1), (80, 0.3)]
    start = text.index("<include>")
    end = text.index("</include>") + len("</include>")
    file.write_text(text[:start] + text[end:])
    assert [marker["id"] for marker in everything.imported(file).recipe["markers"]] == [80]


def test_every_marker_of_an_import_hangs(house: LoadedWorld, tmp_path: Path) -> None:
    back = everything.there_and_back(house, tmp_path)
    entities, pictures = marker_entities(back.world)
    before, textures = marker_entities(house.world)
    assert (entities, pictures) == (before, textures)
    assert len(entities.entities) == 2


def test_sdf_in_out_and_in_is_the_same(tmp_path: Path) -> None:
    ball = "<geometry><sphere><radius>0.25</radius></sphere></geometry>"
    inside = (
        GROUND
        + model(
            "house",
            link("w1", both(box("3 0.2 2")), "2 2 1 0 0 0.5")
            + link("w2", both(box("0.2 4 2.5")), "-3 0 1.25 0 0 0.1"),
            "0.1 0 0 0 0 1",
        )
        + model("ball", link("l", both(ball), "0.1 0 0 0.2 0.3 0.4"), "1 2 0.5 1 0 0.3", False)
    )
    first = everything.reloaded(imported(tmp_path / "in", inside), tmp_path / "one")
    second = everything.there_and_back(first, tmp_path)
    assert len(first.world.walls) == 2
    assert len(first.world.bodies) == 1
    assert everything.differences(first.world, second.world) == []


@pytest.mark.parametrize(
    "value",
    ["", "[", '"x"', "null", "1e999", "[" * 5000, '[{"model": "aruco_60"}]', '{"x_m": 1}', "-5"],
)
def test_spoilt_notes_are_passed_over(house: LoadedWorld, tmp_path: Path, value: str) -> None:
    file = export_world(house, tmp_path / "sdf")
    sdf = read_sdf(file, (file.parent,))
    sdf.attributes.update(dict.fromkeys(sdf.attributes, value))
    for shape in (shape for link in sdf.links for shape in link.shapes):
        shape.attributes.update(
            texture_side_m=value, shape=value, orientation_xyzw=value, span_m=value
        )
    for attributes in [one.attributes for one in sdf.links] + [
        one.attributes for one in sdf.models
    ]:
        attributes.update(dict.fromkeys(attributes, value), yaw_rad=value, name=value)
    world = to_recipe(sdf, "sim_house_enhanced")
    made = yaml.safe_load(recipe_yaml(world.recipe))
    assert len(made.get("walls", ())) + len(made.get("bodies", ())) >= 30


def test_a_map_from_outside_the_folder_is_refused(house: LoadedWorld, tmp_path: Path) -> None:
    file = export_world(house, tmp_path / "sdf")
    (tmp_path / "secret.yaml").write_text("secret")
    for path in ("../secret.yaml", str(tmp_path / "secret.yaml"), "none.yaml", "."):
        sdf = read_sdf(file, (file.parent,))
        sdf.attributes["map"] = f'"{path}"'
        world = to_recipe(sdf, "house")
        assert "map" not in world.recipe or path == "none.yaml"
        assert b"secret" not in world.files.values()


def test_yaml_brings_the_same_recipe_back() -> None:
    values: dict[str, Any] = {
        "name": "1e5", "a": 0.1 + 0.2, "b": [1e-300, 5e20, -0.0, 1 / 3], "c": {"yes": "~"},
        "d": (1, True, None), "e": "line\nbreak \x01 ü",
    }  # fmt: skip
    text = recipe_yaml(values)
    assert "*" not in text
    back = yaml.safe_load(text)
    assert back == {**values, "d": [1, True, None]}
    assert '"1e5"' in text or "'1e5'" in text


def test_a_recipe_is_written_with_what_it_needs(tmp_path: Path) -> None:
    loaded = load_file(everything.make(tmp_path / "worlds"))
    world = everything.imported(export_world(loaded, tmp_path / "sdf"))
    target = tmp_path / "there"
    (target / "textures").mkdir(parents=True)
    (target / "textures/brick.png").write_bytes(folder.png(4, 4))
    write_recipe(world, target / "mine.yaml")
    # What is there already stays, and the import's gets another name.
    assert (target / "textures/brick.png").read_bytes() == folder.png(4, 4)
    back = load_file(target / "mine.yaml")
    assert back.assets == loaded.assets
    assert back.world.name == "mine"
    before = sorted(path.relative_to(target) for path in target.rglob("*"))
    write_recipe(world, target / "mine.yaml")
    assert sorted(path.relative_to(target) for path in target.rglob("*")) == before
    (target / "own.yaml").write_text("name: own\n")
    with pytest.raises(ConfigError, match=r"own\.yaml: already exists") as error:
        write_recipe(world, target / "own.yaml")
    assert "\n" not in str(error.value)
    assert (target / "own.yaml").read_text() == "name: own\n"
    with pytest.raises(ConfigError, match="cannot be written"):
        write_recipe(world, target / "own.yaml/below.yaml")


def test_a_world_of_nothing_but_a_floor_is_a_world(tmp_path: Path) -> None:
    write_recipe(imported(tmp_path / "sdf", GROUND), tmp_path / "hall.yaml")
    world = load_file(tmp_path / "hall.yaml").world
    assert (world.walls, world.bodies) == ((), ())
    assert problems_of(tmp_path / "hall.yaml") == ()


def test_an_included_model_has_the_name_of_the_outermost(tmp_path: Path) -> None:
    chair = model("chair", link("l", both(box("1 1 1"), pose="0 0 3 0 0 0")))
    world = imported(tmp_path, "".join(model(f"seat_{i}", chair) for i in range(3)))
    assert [body["name"] for body in world.recipe["bodies"]] == ["seat_0", "seat_1", "seat_2"]


def test_a_wood_of_300_cylinders_is_quick(tmp_path: Path) -> None:
    trunk = "<geometry><cylinder><radius>0.1</radius><length>1</length></cylinder></geometry>"
    inside = "".join(
        model(f"t{n}", link("l", both(trunk)), f"{n % 20} {n // 20} 0.5 0 0 0") for n in range(300)
    )
    begin = time.process_time()
    world = imported(tmp_path, inside)
    assert len(world.recipe["bodies"]) == 300
    assert time.process_time() - begin < 5.0


def test_a_mesh_whose_materials_are_not_there_stands_and_it_is_told(tmp_path: Path) -> None:
    (tmp_path / "wedge.obj").write_text(
        "mtllib gone.mtl\nusemtl red\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
        "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    mesh = "<geometry><mesh><uri>wedge.obj</uri></mesh></geometry>"
    world = imported(tmp_path, model("wedge", link("l", both(mesh, look=""))))
    assert world.report.errors == ()
    (body,) = world.recipe["bodies"]
    assert [shape.get("solid", True) for shape in body["shapes"]] == [True]
    (found,) = world.report.missing
    assert (found.kind, found.message) == ("URI_LOOKUP", "wedge.obj: 'gone.mtl': no such file")

"""What a person may get wrong: each mistake is one line that says where and what is right."""

from __future__ import annotations

import hashlib
import math
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mazebot.common.files import bounded_yaml
from mazebot.common.problems import WorldError
from mazebot.worldgen.recipe.loader import load_world
from tests.worldgen import folder

LINE = re.compile(r"(?<=\.yaml):\d+")
Spoil = Callable[[dict[str, Any]], object]


def mistake(worlds_dir: Path, name: str = "room") -> str:
    with pytest.raises(WorldError) as caught:
        load_world(name, worlds_dir=worlds_dir)
    text = str(caught.value)
    assert "\n" not in text
    return text


def without_line(text: str) -> str:
    return LINE.sub("", text, count=1)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda r: r["walls"][3].update(length_m=-1), "walls[3].length_m: -1: must be > 0"),
        (lambda r: r["walls"][0].update(x_m=float("nan")), "walls[0].x_m: nan: must be"),
        (lambda r: r["walls"][0].update(y_m=float("inf")), "walls[0].y_m: inf: must be"),
        (lambda r: r["walls"][1].update(yaw_rad=90), "walls[1].yaw_rad: 90: must be <= 6.2832"),
        (lambda r: r["walls"][1].update(yaw_rad="east"), "walls[1].yaw_rad: 'east': must be a num"),
        (lambda r: r["walls"][1].update(length_m=True), "walls[1].length_m: True: must be a num"),
        (lambda r: r["walls"][1].pop("length_m"), "walls[1].length_m: is missing"),
        (
            lambda r: r["walls"][2].update(colour=1),
            "walls[2].colour: 1: unknown field: must be one of name, length_m, x_m, y_m, yaw_rad, "
            "thickness_m, height_m, material",
        ),
        (
            lambda r: r["materials"]["brick"].update(color=1),
            "materials.brick.color: 1: unknown field: must be one of texture, texture_side_m",
        ),
        (
            lambda r: r["locations"]["corner"].update(z_m=1),
            "locations.corner.z_m: 1: unknown field: must be one of x_m, y_m, yaw_rad",
        ),
        (lambda r: r["light"].update(sun=1), "light.sun: 1: unknown field: must be one of direc"),
        (
            lambda r: r["markers"][0].update(size=1),
            "markers[0].size: 1: unknown field: must be one of id, dictionary, size_m",
        ),
        (lambda r: r.update(walles=[]), "walles: (): unknown field: must be one of name, about"),
        (
            lambda r: r["walls"][1].update(name="south"),
            "walls[1].name: 'south': must be unique: already used by walls[0]",
        ),
        (lambda r: r["walls"][1].update(name="a/b"), "walls[1].name: 'a/b': must be letters"),
        (
            lambda r: r["walls"][1].update(material="gold"),
            "walls[1].material: 'gold': must be one of brick, plain",
        ),
        (
            lambda r: r.update(wall_materials=["plain", "gold"]),
            "wall_materials[1]: 'gold': must be one of brick, plain",
        ),
        (
            lambda r: r["markers"][0].update(wall="roof"),
            "markers[0].wall: 'roof': must be the name of one of the walls",
        ),
        (
            lambda r: r["markers"][0].update(side="top"),
            "markers[0].side: 'top': must be 'left' or 'right'",
        ),
        (lambda r: r["markers"][0].update(id=1.5), "markers[0].id: 1.5: must be an integer"),
        (lambda r: r.update(walls={"south": 1}), "walls: {'south': 1}: must be a list"),
        (lambda r: r.update(start=[0, 0]), "start: (0, 0): must be a mapping"),
        (
            lambda r: r.update(start={"x_m": 0, "y_m": 1}),
            "start: (0.0, 1.0): must not lie in a wall",
        ),
        (lambda r: r.update(start={"x_m": 0, "y_m": 99}), "start: (0.0, 99.0): must lie within"),
        (
            lambda r: r["locations"]["corner"].update(x_m=2.5),
            "locations.corner: (2.5, 0.5): must lie on free floor that is connected to the start",
        ),
        (
            lambda r: r["materials"]["plain"].update(diffuse=[0, 0, 2, 1]),
            "materials.plain.diffuse[2]: 2: must be <= 1",
        ),
        (
            lambda r: r["materials"]["brick"].update(texture="../secret.png"),
            "materials.brick.texture: '../secret.png': must be letters",
        ),
        (lambda r: r.update(map_resolution_m=0), "map_resolution_m: 0: must be >= 0.01"),
        (
            lambda r: r["walls"][1].update(x_m=900, length_m=900),
            "map_resolution_m: 0.1: makes 9043 x 9022 cells: must be coarser",
        ),
        (
            lambda r: r["light"].update(direction=[0, 0, 0]),
            "light.direction: (0.0, 0.0, 0.0): must not",
        ),
        (lambda r: r.update(name="hall"), "name: 'hall': must be 'room', the file's name"),
        (lambda r: r.update({1: 2}), "1: 1: must be a string"),
        (lambda r: r.update(extends="../room.yaml"), "extends: '../room.yaml': must be a file"),
        (
            lambda r: r.update(extends="cellar.yaml"),
            "extends: 'cellar.yaml': no such file: must be one of room.yaml",
        ),
        (
            lambda r: r.update(extends="room.yaml"),
            "extends: 'room.yaml': must not extend itself (room.yaml -> room.yaml)",
        ),
    ],
)
def test_a_mistake_is_named_in_one_line(tmp_path: Path, spoil: Spoil, said: str) -> None:
    recipe = folder.room()
    spoil(recipe)
    text = mistake(folder.make(tmp_path, recipe))
    assert without_line(text).startswith(f"{tmp_path}/room.yaml: {said}"), text


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("walls: [", ":2: not YAML: column 1: a value that is missing, or a bracket"),
        ("a: 1\na: 2", ":2: not YAML: column 1: key 'a' is a duplicate"),
        ("a: &b {}\nc: *b", ":2: not YAML: column 4: an alias"),
        ("a: 2001-99-99", ":1: not YAML: column 4: an invalid value: month must be in 1..12"),
        ("!!python/object:os.system x", ":1: not YAML: column 1: a tag (!name): must be left out"),
        ("a: !!int x", ":1: not YAML: column 4: "),
        ("a: !!seq x", ":1: not YAML: column 4: must be a list"),
        (
            f"name: 0x{'f' * 5000}",
            ":1: name: a number with more digits than Python prints: must be a string",
        ),
        ("[" * 1000, ":1: not YAML: column 41: must be at most 40 levels deep"),
        (f"a: {'x' * 7000}", ":1: not YAML: column 4: must have values of at most 6000 char"),
        ("# " + "x" * 5_000_000, ": must have at most 4194304 bytes"),
        ("", ":1: is empty: must be a mapping"),
        ("- 1", ":1: (1,): must be a mapping"),
        ("\0", ": not YAML: "),
    ],
)
def test_a_file_that_is_no_recipe_is_named(tmp_path: Path, text: str, said: str) -> None:
    found = mistake(folder.make(tmp_path, text))
    assert found.startswith(f"{tmp_path}/room.yaml{said}"), found


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    folder.make(tmp_path)
    (tmp_path / "room.yaml").write_bytes(b"about: x\nname: \xff\xfe")
    assert mistake(tmp_path) == f"{tmp_path}/room.yaml:2: not YAML: must be UTF-8"


def test_a_file_of_too_many_values_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bounded_yaml, "MAX_YAML_VALUES", 1000)
    folder.make(tmp_path, "[" + "1," * 1000 + "1]")
    said = ":1: not YAML: column 2000: must contain at most 1000 values"
    assert mistake(tmp_path) == f"{tmp_path}/room.yaml{said}"


def test_an_unknown_world_is_answered_with_the_known_ones(tmp_path: Path) -> None:
    folder.make(tmp_path)
    assert mistake(tmp_path, "hall") == "world_name: 'hall': must be one of room"
    with pytest.raises(WorldError, match=r"sim_house, .*, original .short for"):
        load_world("../worlds/sim_house")
    empty = tmp_path / "textures"
    (empty / "brick.png").unlink()
    assert mistake(empty) == f"world_name: 'room': {empty} contains no *.yaml"
    assert mistake(tmp_path / "none") == f"worlds_dir: {tmp_path}/none: No such file or directory"


def test_a_circle_of_overlays_is_shown(tmp_path: Path) -> None:
    folder.make(tmp_path, {"extends": "a.yaml"})
    folder.write(tmp_path, "a", {"extends": "b.yaml"})
    folder.write(tmp_path, "b", {"extends": "a.yaml"})
    found = mistake(tmp_path)
    assert found.startswith(f"{tmp_path}/b.yaml:1: extends: 'a.yaml': must not extend itself")
    assert found.endswith("(a.yaml -> b.yaml -> a.yaml)")


def test_a_mistake_is_named_in_the_file_that_holds_it(tmp_path: Path) -> None:
    base = folder.room()
    base["name"] = "base"
    base["walls"][2]["length_m"] = 0
    folder.make(tmp_path, {"name": "room", "extends": "base.yaml", "wall_height_m": 2.0})
    folder.write(tmp_path, "base", base)
    said = mistake(tmp_path)
    at = re.fullmatch(r".*/base.yaml:(\d+): walls\[2\]\.length_m: 0: must be > 0", said)
    assert at, said
    lines = (tmp_path / "base.yaml").read_text().splitlines()
    assert lines[int(at[1]) - 1] == "  length_m: 0"
    base["walls"][2]["length_m"] = 4
    folder.write(tmp_path, "base", base)
    overlay = {"name": "room", "extends": "base.yaml", "wall_height_m": -2.0}
    folder.write(tmp_path, "room", overlay)
    assert mistake(tmp_path) == f"{tmp_path}/room.yaml:3: wall_height_m: -2.0: must be > 0"


def test_an_overlay_merges_mappings_and_replaces_the_rest(tmp_path: Path) -> None:
    base = folder.room()
    base["name"] = "base"
    folder.make(tmp_path)
    folder.write(tmp_path, "base", base)
    overlay = {
        "name": "room", "extends": "base.yaml", "wall_height_m": 2.5, "markers": [],
        "materials": {"plain": {"diffuse": [0, 0, 0, 1]}}, "start": {"x_m": 0.5},
    }  # fmt: skip
    folder.write(tmp_path, "room", overlay)
    world = load_world("room", worlds_dir=tmp_path).world
    assert {wall.height_m for wall in world.walls} == {2.5}
    assert world.markers == ()
    assert (world.start.x_m, world.start.y_m) == (0.5, 0.0)
    plain = world.materials[1]
    assert (plain.ambient, plain.diffuse) == ((1, 1, 1, 1), (0, 0, 0, 1))
    assert world.recipe == "room.yaml"


def test_a_wall_may_have_its_own_height_thickness_and_material(tmp_path: Path) -> None:
    recipe = folder.room()
    recipe["walls"][0] |= {"height_m": 0.5, "thickness_m": 0.3, "material": "plain"}
    world = load_world("room", worlds_dir=folder.make(tmp_path, recipe)).world
    first, second = world.walls[:2]
    assert (first.height_m, first.thickness_m, first.material) == (0.5, 0.3, "plain")
    assert (second.height_m, second.thickness_m, second.material) == (1.0, 0.15, "plain")


def test_numbers_may_be_written_with_an_exponent(tmp_path: Path) -> None:
    folder.make(tmp_path)
    path = tmp_path / "room.yaml"
    path.write_text(path.read_text().replace("map_resolution_m: 0.1", "map_resolution_m: 1e-1"))
    assert load_world("room", worlds_dir=tmp_path).world.map_resolution_m == 0.1


def damaged() -> bytes:
    data = bytearray(folder.png())
    data[len(data) // 2] ^= 1
    return bytes(data)


def claims(width: int, height: int) -> bytes:
    """A PNG whose header, with a right checksum, claims a size."""
    data = folder.png()
    head = b"IHDR" + struct.pack(">II", width, height) + data[24:29]
    return data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "is not an image, must be a PNG"),
        (b"garbage" * 100, "is not an image, must be a PNG"),
        (b"\xff\xd8\xff\xe0JFIF", "is a JPEG, must be a PNG"),
        (folder.png()[:-20], "is corrupt or truncated, must be a complete PNG"),
        (damaged(), "is corrupt or truncated, must be a complete PNG"),
        (folder.png(4096, 4), "is 4096 x 4 pixels, must be at most 2048 a side"),
        (claims(65536, 65536), "is 65536 x 65536 pixels, must be at most 2048 a side"),
        (claims(0, 16), "is 0 x 16 pixels, must be at most 2048 a side"),
        (b"\x89PNG\r\n\x1a\n" + b"\0" * 17_000_000, "must have at most 16777216 bytes"),
    ],
)
def test_a_texture_that_is_no_png_is_named(tmp_path: Path, data: bytes, said: str) -> None:
    folder.make(tmp_path)
    (tmp_path / "textures" / "brick.png").write_bytes(data)
    assert without_line(mistake(tmp_path)) == (
        f"{tmp_path}/room.yaml: materials.brick.texture: 'brick.png': "
        f"{tmp_path}/textures/brick.png {said}"
    )


def test_a_texture_that_is_missing_is_named(tmp_path: Path) -> None:
    folder.make(tmp_path)
    (tmp_path / "textures" / "brick.png").unlink()
    assert "textures/brick.png cannot be read (No such file or directory)" in mistake(tmp_path)
    (tmp_path / "textures" / "brick.png").mkdir()
    assert "textures/brick.png must be a file" in mistake(tmp_path)


@pytest.mark.parametrize("name", ["brick.jpg", "brick", "brick.PNG.bak"])
def test_a_png_by_another_name_is_named(tmp_path: Path, name: str) -> None:
    recipe = folder.room()
    recipe["materials"]["brick"]["texture"] = name
    folder.make(tmp_path, recipe)
    (tmp_path / "textures" / "brick.png").rename(tmp_path / "textures" / name)
    right = Path(name).with_suffix(".png").name
    assert f"textures/{name} is a PNG, must be named {right}" in mistake(tmp_path)


def test_textures_may_lie_in_another_folder(tmp_path: Path) -> None:
    worlds = folder.make(tmp_path / "worlds")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "brick.png").write_bytes(folder.png(32, 32))
    first = load_world("room", worlds_dir=worlds)
    second = load_world("room", worlds_dir=worlds, texture_base=tmp_path / "other")
    assert first.world.hash != second.world.hash
    for loaded in (first, second):
        ((sha256, data),) = loaded.assets.items()
        assert hashlib.sha256(data).hexdigest() == sha256
        assert loaded.world.materials[0].texture_sha256 == sha256


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from places(value[key], (*path, key))


PLACES = list(places(folder.ROOM))
JUNK = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.dates(),
        st.binary(max_size=4), st.sampled_from([-1, 0, 1e-300, 1e308, -1e308, 2**70, "", "south"]),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
    max_leaves=4,
)  # fmt: skip


@settings(
    max_examples=120, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)  # fmt: skip
@given(st.lists(st.tuples(st.sampled_from(PLACES), JUNK), min_size=1, max_size=2))
def test_whatever_a_recipe_holds_there_is_a_world_or_one_line(
    tmp_path: Path, changes: list[tuple[tuple[Any, ...], Any]]
) -> None:
    recipe: Any = folder.room()
    for path, junk in changes:
        here = recipe
        try:
            for part in path[:-1]:
                here = here[part]
            if path:
                here[path[-1]] = junk
            else:
                recipe = junk
        except (LookupError, TypeError):
            continue
    folder.make(tmp_path)
    text = yaml.safe_dump(recipe, allow_unicode=True)
    (tmp_path / "room.yaml").write_text(text, encoding="utf-8", newline="")
    try:
        loaded = load_world("room", worlds_dir=tmp_path)
    except WorldError as error:
        said = str(error)
    else:
        assert loaded.world.hash == loaded.world.content_hash()
        return
    assert said.startswith(f"{tmp_path}/")
    assert len(said.splitlines()) == 1


def test_without_a_start_the_robot_stands_where_it_has_room(tmp_path: Path) -> None:
    recipe = folder.room()
    del recipe["start"]

    def start(**changes: Any) -> tuple[float, float]:
        worlds = folder.make(tmp_path, recipe | changes)
        at = load_world("room", worlds_dir=worlds).world.start
        return at.x_m, at.y_m

    assert start() == (0.0, 0.0)
    pillar = {"name": "pillar", "x_m": 0.0, "y_m": 0.0, "radius_m": 0.3, "height_m": 1.0}
    assert 0.69 < math.hypot(*start(cylinders=[pillar])) < 0.8
    # Beyond the wall there would be room much nearer.
    wide = pillar | {"radius_m": 1.2, "x_m": -0.9}
    x_m, y_m = start(cylinders=[wide], locations={})
    assert x_m > 0.5
    assert abs(y_m) < 1.0


def test_without_a_start_the_robot_looks_where_the_way_is_free(tmp_path: Path) -> None:
    recipe = folder.room()
    del recipe["start"]
    recipe["cylinders"] = [
        {"name": "pillar", "x_m": 0.6, "y_m": 0.0, "radius_m": 0.1, "height_m": 1.0}
    ]
    start = load_world("room", worlds_dir=folder.make(tmp_path, recipe)).world.start
    assert (start.x_m, start.y_m) == (0.0, 0.0)
    assert abs(start.yaw_rad) > math.pi / 2.0
    recipe["cylinders"][0]["x_m"] = 1.6
    start = load_world("room", worlds_dir=folder.make(tmp_path, recipe)).world.start
    assert start.yaw_rad == 0.0

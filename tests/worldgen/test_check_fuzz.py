"""Whatever a file holds, its problems are told soon, and nothing is written."""

from __future__ import annotations

import copy
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from mazebot.worldgen.check import problems_of
from tests.worldgen import folder

RECIPES = 500
BATCHES = 10
MAX_S = 5.0

LARGE: dict[str, Any] = folder.room() | {
    "maze": {"rows": 3, "columns": 2, "cell_m": 0.8, "seed": 1},
    "boxes": [{"name": "box", "size_m": [0.2, 0.2, 0.2], "x_m": -1.5, "y_m": 0.5}],
    "cylinders": [
        {"name": "can", "radius_m": 0.1, "height_m": 0.3, "x_m": 1.5, "y_m": 0.6, "mass_kg": 1.0}
    ],
    "bodies": [
        {
            "name": "thing",
            "position_m": [1.5, -0.6, 0.1],
            "orientation_xyzw": [0.0, 0.0, 0.0, 1.0],
            "shapes": [
                {"name": "a", "geometry": {"kind": "sphere", "radius_m": 0.1}, "material": "plain"},
                {
                    "name": "b",
                    "geometry": {
                        "kind": "polyline",
                        "polygons_m": [[[0.0, 0.0], [0.2, 0.0], [0.0, 0.2]]],
                        "height_m": 0.5,
                    },
                },
            ],
        }
    ],
    "ceiling": {"material": "plain"},
    "rooms": {
        "hall": {
            "polygon_m": [[-2.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-2.0, 1.0]],
            "wall_material": "brick",
        }
    },
    "lights": [{"name": "lamp", "position_m": [0.0, 0.0, 0.9]}],
    "sky": [0.5, 0.5, 0.5, 1.0],
}
JUNK: list[Any] = [
    None, True, -1, 0, 3, 10**30, float("nan"), float("inf"), -1e308, 1e308, 1e-308, 1e-12, 999.0,
    "", "south", "plain", "../x", "\x85\u202e", "x" * 300, [], {}, [[]], [1, 2, 3], {"a": [1]},
    {"kind": "cone", "radius_m": 1, "length_m": 2}, {"kind": "mesh", "file": "no.obj"},
    [[0, 0], [1, 1], [1, 0], [0, 1]],
]  # fmt: skip


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner: list[tuple[Any, ...]] = [path] if path else []
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            inner += places(value[key], (*path, key))
    return inner


PLACES = places(LARGE)


def written(recipe: Any) -> bytes:
    text: str = yaml.dump(recipe, Dumper=yaml.CSafeDumper, allow_unicode=True, sort_keys=False)
    return text.encode()


def at(recipe: Any, path: tuple[Any, ...]) -> Any:
    for part in path:
        recipe = recipe[part]
    return recipe


def mutated(rng: np.random.Generator) -> bytes:
    """A recipe with a few values changed, or with its text spoilt."""
    recipe = copy.deepcopy(LARGE)
    for _ in range(rng.integers(1, 4)):
        path, other = (PLACES[rng.integers(len(PLACES))] for _ in range(2))
        try:
            outer = at(recipe, path[:-1])
            match rng.integers(4):
                case 0:
                    del outer[path[-1]]
                case 1:
                    outer[path[-1]] = copy.deepcopy(at(recipe, other))
                case _:
                    outer[path[-1]] = copy.deepcopy(JUNK[rng.integers(len(JUNK))])
        except (LookupError, TypeError):
            continue
    try:
        data = written(recipe)
    except (RecursionError, yaml.YAMLError):
        data = written(LARGE)
    match rng.integers(12):
        case 0:
            return data[: rng.integers(len(data))]
        case 1:
            cut = sorted(rng.integers(len(data), size=4))
            a, b, c, d = (int(value) for value in cut)
            return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]
        case 2:
            noise = np.frombuffer(data, np.uint8).copy()
            noise[rng.integers(len(noise), size=3)] = rng.integers(256, size=3)
            return noise.tobytes()
        case 3:
            return data.decode().encode(("utf-16", "utf-32", "utf-8-sig")[rng.integers(3)])
        case 4:
            return rng.integers(256, size=200, dtype=np.uint8).tobytes()
        case 5:
            deep = int(rng.integers(5000))
            return data + b"x: " + b"{a: [" * deep
        case _:
            return data


@pytest.fixture(scope="module", autouse=True)
def _imported(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What is imported and compiled on first use takes seconds, and no file's fault."""
    worlds_dir = folder.make(tmp_path_factory.mktemp("worlds"))
    problems_of("room", worlds_dir=worlds_dir, overrides=("maze={rows: 2, columns: 2}",))
    recipe = {**LARGE, "meshes": [{"name": "m", "file": "no.obj", "x_m": 0.0, "y_m": 0.0}]}
    folder.write(worlds_dir, "room", recipe)
    problems_of("room", worlds_dir=worlds_dir)


@pytest.mark.parametrize(
    "batch", [*range(3), *(pytest.param(n, marks=pytest.mark.slow) for n in range(3, BATCHES))]
)
def test_a_spoilt_recipe_is_told_from_a_good_one(tmp_path: Path, batch: int) -> None:
    folder.make(tmp_path)
    path = tmp_path / "room.yaml"
    rng = np.random.default_rng(batch)
    found = 0
    for _ in range(RECIPES // BATCHES):
        data = mutated(rng)
        path.write_bytes(data)
        before = sorted(tmp_path.rglob("*"))
        start = time.process_time()
        problems = problems_of("room", worlds_dir=tmp_path)
        assert time.process_time() - start < MAX_S
        assert sorted(tmp_path.rglob("*")) == before
        assert path.read_bytes() == data
        for problem in problems:
            line = str(problem)
            assert line.isprintable()
            assert line.startswith(f"{path}"), line
            assert problem.must
        found += bool(problems)
    assert found > RECIPES // BATCHES // 2


def test_the_recipe_that_is_spoilt_is_good(tmp_path: Path) -> None:
    folder.make(tmp_path, {**LARGE, "maze": None})
    assert problems_of("room", worlds_dir=tmp_path) == ()


@pytest.mark.parametrize("batch", range(4))
def test_a_spoilt_sdf_world_is_told_from_a_good_one(tmp_path: Path, batch: int) -> None:
    text = """<?xml version="1.0"?>
<sdf version="1.9"><world name="w">
  <light type="directional" name="sun"><direction>0 0 -1</direction></light>
  <model name="wall"><static>1</static><pose>2 0 0.5 0 0 0</pose><link name="link">
    <collision name="c"><geometry><box><size>0.2 4 1</size></box></geometry></collision>
    <visual name="v"><geometry><box><size>0.2 4 1</size></box></geometry></visual>
  </link></model>
  <model name="can"><pose>-2 0 0.5 0 0 0</pose><link name="link">
    <collision name="c"><geometry><cylinder><radius>0.2</radius><length>1</length></cylinder>
    </geometry></collision></link></model>
</world></sdf>
"""
    path = tmp_path / "world.sdf"
    path.write_text(text)
    assert problems_of(path) == ()
    rng = np.random.default_rng(batch)
    words = text.replace("<", " <").replace(">", "> ").split(" ")
    for _ in range(10):
        spoilt = list(words)
        for _ in range(rng.integers(1, 4)):
            index = int(rng.integers(len(spoilt)))
            spoilt[index] = ("nan", "", "1e308", "-1", "<link>", "\x01")[rng.integers(6)]
        path.write_text(" ".join(spoilt))
        before = sorted(tmp_path.rglob("*"))
        start = time.process_time()
        problems = problems_of(path)
        assert time.process_time() - start < MAX_S
        assert all(str(problem).isprintable() for problem in problems)
        assert sorted(tmp_path.rglob("*")) == before

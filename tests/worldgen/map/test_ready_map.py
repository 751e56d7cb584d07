"""A recipe that brings a map of its own: it is the one that is driven by, and judged."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from mazebot.common.maths.frames import SE2
from mazebot.common.world.costmap import Cells
from mazebot.common.world.map_files import ImageFormat, Mode, write_map
from mazebot.worldgen.check import problems_of
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world
from tests.worldgen import folder


@pytest.fixture
def room(tmp_path: Path) -> LoadedWorld:
    """The room by the map that is made of it."""
    return load_world("room", worlds_dir=folder.make(tmp_path))


def bring(
    worlds_dir: Path, cells: Cells, resolution_m: float, origin: SE2,
    mode: Mode = "trinary", image_format: ImageFormat = "pgm",
) -> None:  # fmt: skip
    write_map(worlds_dir / "maps", "ready", cells, resolution_m, origin, mode, image_format)
    folder.write(worlds_dir, "room", folder.room() | {"map": "ready.yaml"})


@pytest.mark.parametrize(
    ("mode", "image_format"),
    [("trinary", "pgm"), ("trinary", "bmp"), ("scale", "png"), ("raw", "pgm")],
)
def test_a_world_is_driven_by_the_map_that_it_brings(
    tmp_path: Path, room: LoadedWorld, mode: Mode, image_format: ImageFormat
) -> None:
    cells = room.map_cells.copy()
    cells[0, 0] = -1
    bring(tmp_path, cells, 0.1, room.map_origin, mode, image_format)
    assert problems_of("room", worlds_dir=tmp_path) == ()
    loaded = load_world("room", worlds_dir=tmp_path)
    assert np.array_equal(loaded.map_cells, cells)
    assert loaded.map_origin == room.map_origin
    assert loaded.world.map_sha256 != room.world.map_sha256
    assert loaded.world.hash != room.world.hash


def test_a_negated_map_is_the_same_map(tmp_path: Path, room: LoadedWorld) -> None:
    bring(tmp_path, room.map_cells, 0.1, room.map_origin)
    picture, meta = tmp_path / "maps" / "ready.pgm", tmp_path / "maps" / "ready.yaml"
    with Image.open(picture) as image:
        negative = Image.fromarray(255 - np.asarray(image))
    negative.save(picture)
    (found,) = problems_of("room", worlds_dir=tmp_path)
    assert found.field == "map"
    meta.write_text(yaml.safe_dump(yaml.safe_load(meta.read_text()) | {"negate": 1}))
    assert problems_of("room", worlds_dir=tmp_path) == ()
    assert np.array_equal(load_world("room", worlds_dir=tmp_path).map_cells, room.map_cells)


def test_a_turned_map_of_another_resolution_is_as_good(tmp_path: Path, room: LoadedWorld) -> None:
    """The same walls on a grid of 5 cm, turned by 0.4 about the start."""
    side, origin = 120, SE2(0.0, 0.0, 0.4) @ SE2(-3.0, -3.0, 0.0)
    x, y = np.meshgrid((np.arange(side) + 0.5) * 0.05, (np.arange(side) + 0.5) * 0.05)
    c, s = math.cos(0.4), math.sin(0.4)
    column = np.floor((origin.x_m + c * x - s * y - room.map_origin.x_m) / 0.1).astype(int)
    row = np.floor((origin.y_m + s * x + c * y - room.map_origin.y_m) / 0.1).astype(int)
    rows, columns = room.map_cells.shape
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    cells = np.full((side, side), -1, np.int8)
    cells[inside] = room.map_cells[row[inside], column[inside]]
    bring(tmp_path, cells, 0.05, origin)
    assert problems_of("room", worlds_dir=tmp_path) == ()
    loaded = load_world("room", worlds_dir=tmp_path)
    assert loaded.map_origin == origin
    assert loaded.world.map_resolution_m == 0.05
    bring(tmp_path, cells, 0.05, SE2(origin.x_m, origin.y_m, 0.0))
    (found,) = problems_of("room", worlds_dir=tmp_path)
    assert "must match the world: walls of map and world are" in found.must


def test_a_map_beside_its_world_is_told_as_far_as_it_is_off(
    tmp_path: Path, room: LoadedWorld
) -> None:
    bring(tmp_path, room.map_cells, 0.1, SE2(0.678, 0.0, 0.0) @ room.map_origin)
    (found,) = problems_of("room", worlds_dir=tmp_path)
    lines = (tmp_path / "room.yaml").read_text().splitlines()
    assert lines[found.line - 1] == "map: ready.yaml"
    assert found.value == "'ready.yaml'"
    assert "; shifted by (-0.67" in found.must
    # It can be driven by all the same, as one that SLAM has made askew.
    assert not found.fatal
    assert load_world("room", worlds_dir=tmp_path).map_origin.x_m > room.map_origin.x_m + 0.6


def test_a_map_without_walls_shows_no_world(tmp_path: Path, room: LoadedWorld) -> None:
    bring(tmp_path, np.zeros((4, 4), np.int8), 0.1, room.map_origin)
    (found,) = problems_of("room", worlds_dir=tmp_path)
    assert found.must == "must match the world: the map has no occupied cell beside free floor"

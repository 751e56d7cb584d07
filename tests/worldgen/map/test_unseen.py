"""What is on a world's map, and not in the plane of the lidar."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import shapely

from mazebot.worldgen.map.unseen import unseen_areas
from mazebot.worldgen.recipe.loader import load_world
from tests.worldgen import folder


def unseen(worlds_dir: Path, **recipe: Any) -> shapely.Geometry:
    """The unseen part of the room's map with some things in it."""
    folder.make(worlds_dir, {**folder.room(), "markers": [], "locations": {}, **recipe})
    room = load_world("room", worlds_dir=worlds_dir)
    areas = unseen_areas(room.world, room.meshes, room.map_cells, room.map_origin)
    boxes = [shapely.box(*area.low_m, *area.high_m) for area in areas]
    assert sum(box.area for box in boxes) == pytest.approx(shapely.unary_union(boxes).area)
    return shapely.unary_union(boxes)


def box(height_m: float, **more: Any) -> dict[str, Any]:
    return {"name": "b", "size_m": [0.5, 0.3, height_m], "x_m": 1.25, "y_m": 0.15, **more}


def covers(area: shapely.Geometry, x_m: float, y_m: float) -> bool:
    return bool(shapely.contains_xy(area, x_m, y_m))


@pytest.mark.parametrize("thing", [box(0.04), box(0.13), box(0.02, z_m=0.2)])
def test_a_step_and_a_shelf_are_unseen_in_all_of_their_cells(
    tmp_path: Path, thing: dict[str, Any]
) -> None:
    area = unseen(tmp_path, boxes=[thing])
    itself = shapely.box(1.0, 0.0, 1.5, 0.3)
    assert area.covers(itself)
    assert itself.buffer(0.1, join_style="mitre").covers(area)


@pytest.mark.parametrize("thing", [box(0.14), box(1.0), box(0.1, z_m=0.12)])
def test_what_crosses_the_plane_is_seen(tmp_path: Path, thing: dict[str, Any]) -> None:
    assert unseen(tmp_path, boxes=[thing]).is_empty


def test_what_passes_over_or_under_the_robot_is_not_on_the_map(tmp_path: Path) -> None:
    assert unseen(tmp_path, boxes=[box(0.02), box(0.1, name="lamp", z_m=0.5)]).is_empty


def test_of_a_ramp_one_line_is_seen(tmp_path: Path) -> None:
    # Its upper face is at the height of the lidar at x = 1.15.
    rise = math.atan(0.2)
    size_m = [1.5 / math.cos(rise), 0.6, 0.001]
    ramp = {"name": "r", "size_m": size_m, "x_m": 1.15, "y_m": 0.0, "z_m": 0.132, "pitch_rad": rise}
    area = unseen(tmp_path, boxes=[ramp])
    assert not covers(area, 1.16, 0.05)
    assert covers(area, 0.95, 0.05)
    assert covers(area, 1.35, 0.05)


def test_of_a_table_the_legs_are_seen(tmp_path: Path) -> None:
    def part(name: str, x_m: float, z_m: float, size_m: list[float]) -> dict[str, Any]:
        geometry = {"kind": "box", "size_m": size_m}
        return {"name": name, "position_m": [x_m, 0.0, z_m], "geometry": geometry}

    top = part("top", 0.0, 0.19, [0.6, 0.4, 0.04])
    size_m = [0.04, 0.04, 0.17]
    legs = [part(f"leg{x_m}", x_m, 0.085, size_m) for x_m in (-0.25, 0.25)]
    table = {"name": "t", "position_m": [1.25, 0.05, 0.0], "shapes": [top, *legs]}
    area = unseen(tmp_path, bodies=[table])
    assert covers(area, 1.25, 0.05)
    assert not covers(area, 1.0, 0.05)
    assert not covers(area, 1.5, 0.05)


def test_low_walls_are_unseen_and_low_things_at_a_seen_wall_do_not_hide_it(tmp_path: Path) -> None:
    walls = folder.room()["walls"]
    walls.append({"name": "kerb", "length_m": 2.0, "height_m": 0.05, "x_m": 1.0, "yaw_rad": 1.5708})
    walls[-1]["y_m"] = 0.0
    area = unseen(tmp_path, walls=walls)
    assert covers(area, 1.0, 0.5)
    assert not covers(area, 1.0, 1.0)
    assert not covers(area, 0.5, 1.0)

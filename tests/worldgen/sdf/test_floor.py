"""Which floor an imported world has, and where the robot starts on it."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from mazebot.worldgen.check import findings_of
from mazebot.worldgen.sdf.recipe_file import ImportedWorld
from tests.worldgen.sdf.test_convert import BLUE, both, box, imported, link, model

RED = "<material><diffuse>1 0 0 1</diffuse></material>"
LAMP = '<light name="lamp" type="point"><pose>0 0 2 0 0 0</pose></light>'
WHEEL = f"""<link name="base"><collision name="c">{box("0.4 0.2 0.1")}</collision></link>
  <link name="wheel"/><joint name="j" type="revolute"><parent>base</parent><child>wheel</child>
  <axis><xyz>0 0 1</xyz></axis></joint>"""
DRIVE = '<plugin filename="libgazebo_ros_diff_drive.so" name="drive"/>'


def ground(z_m: float = 0.0) -> str:
    plane = "<geometry><plane><normal>0 0 1</normal><size>9 9</size></plane></geometry>"
    return model(f"ground_{z_m:g}", link("l", both(plane)), f"0 0 {z_m} 0 0 0")


def thing(name: str, size: str, pose: str, look: str = BLUE) -> str:
    return model(name, link("l", both(box(size), look)), f"{pose} 0 0 0")


def walls(foot_m: float, middle: tuple[float, float] = (0.0, 0.0)) -> str:
    """Of a room of 6 x 6 m, 1 m high."""
    x, y = middle
    sides = ((x, y + 3, "6 0.1 1"), (x, y - 3, "6 0.1 1"), (x + 3, y, "0.1 6 1"))
    return "".join(
        thing(f"w{index}", size, f"{a} {b} {foot_m + 0.5}")
        for index, (a, b, size) in enumerate(sides)
    )


def lowered(world: ImportedWorld) -> str:
    return world.report.floor.rpartition("the world is ")[2]


@pytest.mark.parametrize("under", ["", ground()], ids=["no plane", "plane"])
@pytest.mark.parametrize("thick_m", [0.1, 1.0])
def test_a_slab_on_which_everything_stands_is_the_floor(
    tmp_path: Path, under: str, thick_m: float
) -> None:
    slab = thing("slab", f"6 6 {thick_m}", f"0 0 {0.05 - thick_m / 2.0}", RED)
    world = imported(tmp_path, under + slab + walls(0.0) + LAMP)
    assert world.report.floor == "slab::l::c, at z = 0.05 m: the world is lowered by 0.05 m"
    assert "bodies" not in world.recipe
    # What is under the floor of a wall is no part of its height.
    assert (len(world.recipe["walls"]), world.recipe["wall_height_m"]) == (3, 0.95)
    floor = world.recipe["materials"][world.recipe["floor_material"]]
    assert floor["diffuse"] == [1.0, 0.0, 0.0, 1.0]
    assert world.recipe["lights"][0]["position_m"] == [0.0, 0.0, 1.95]
    assert world.report.warnings() == ()


def test_slabs_of_one_height_are_one_floor_and_the_storey_above_is_none(tmp_path: Path) -> None:
    slabs = thing("a", "3 6 0.1", "-1.5 0 0.05") + thing("b", "3 6 0.1", "1.5 0 0.05")
    above = thing("above", "6 6 0.1", "0 0 3.05")
    beds = "".join(thing(f"bed{n}", "1 0.2 0.5", f"0 {n / 4} 3.35") for n in range(12))
    world = imported(tmp_path, slabs + walls(0.1) + above + beds)
    assert lowered(world) == "lowered by 0.1 m"
    assert len(world.recipe["walls"]) == 3
    assert len(world.recipe["bodies"]) == 13


@pytest.mark.parametrize(
    "slab",
    [
        thing("table", "3 2 0.1", "0 0 0.7") + thing("mug", "0.1 0.1 0.1", "0 0 0.8"),
        thing("podium", "5 5 0.5", "0 0 0.25") + walls(0.5),
        thing("rug", "1.5 1.5 0.03", "1 0 0.015") + walls(0.0),
        thing("shed", "1.5 1.5 1", "1 0 0.5"),
    ],
    ids=["table", "podium", "rug", "shed"],
)
def test_what_is_not_under_everything_is_no_floor(tmp_path: Path, slab: str) -> None:
    world = imported(tmp_path, ground() + slab)
    assert world.report.floor == ""
    assert world.report.warnings() == ()


def test_a_slab_beside_the_start_is_told(tmp_path: Path) -> None:
    slab = thing("slab", "6 6 0.1", "9 0 0")
    world = imported(tmp_path, ground() + slab + walls(0.0, (9.0, 0.0)))
    assert world.report.floor == ""
    assert world.report.warnings() == (
        "slab::l::c covers 36.0 m2 like a floor, and is a step of 0.05 m here: the start at (0, 0) "
        "is beside it",
    )


@pytest.mark.parametrize(
    ("planes", "expected"),
    [
        ((-0.5,), "raised by 0.5 m"),
        ((0.2,), "lowered by 0.2 m"),
        ((-0.5, -0.2), "raised by 0.2 m"),
        ((-0.5, 0.0), ""),
    ],
)
def test_the_ground_plane_is_the_floor_at_any_height(
    tmp_path: Path, planes: tuple[float, ...], expected: str
) -> None:
    height_m = planes[-1]
    world = imported(tmp_path, "".join(ground(z_m) for z_m in planes) + walls(height_m))
    assert lowered(world) == expected
    assert len(world.recipe["walls"]) == 3
    assert world.recipe["wall_height_m"] == 1.0


def test_a_robot_of_the_world_is_where_ours_starts(tmp_path: Path) -> None:
    robot = model("mine", WHEEL + DRIVE, "-1 0.5 0.1 0 0 1.5", static=False)
    world = imported(tmp_path, ground() + walls(0.0) + robot)
    assert "bodies" not in world.recipe
    assert world.recipe["start"] == {"x_m": -1.0, "y_m": 0.5, "yaw_rad": 1.5}
    (warning,) = world.report.warnings()
    assert warning == (
        "model mine is a robot (plugin libgazebo_ros_diff_drive.so): Mazebot's starts in its "
        "place, at (-1, 0.5)"
    )
    found = findings_of(tmp_path / "hall.sdf")
    assert [problem.must for problem in found.problems] == [warning]


def test_several_robots_of_the_world_stand_in_it(tmp_path: Path) -> None:
    inner = model("base", WHEEL + DRIVE, static=False)
    robots = [model(f"r{n}", inner, f"{n} 1 0.05 0 0 0", static=False) for n in (1, 2)]
    world = imported(tmp_path, ground() + walls(0.0) + "".join(robots))
    assert "start" not in world.recipe
    assert len(world.recipe["bodies"]) == 2
    first, second = world.report.warnings()
    assert first.startswith("model r1 stands still as an obstacle")
    assert second.startswith("model r2 stands still as an obstacle")
    assert math.isclose(world.recipe["bodies"][0]["position_m"][0], 1.0)

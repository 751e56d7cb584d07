"""The commands for what stands in a running world, against a spawner in this process."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np
import pytest

from mazebot.common.client.robot import Receive, Robot
from mazebot.common.maths.frames import rotation_from_quaternion
from mazebot.common.messages import documents as doc
from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Envelope
from tests.cli.test_app import assert_one_line, mazebot
from tests.common.house import marker, wall, world
from tests.spawner.stage import FORBIDDEN_X_M, Stage

HOUSE = world([wall(length_m=4.0)], [marker(id=7)])
BOX = "<pose>0 0 0.5 0 0 0</pose><geometry><box><size>1 0.6 0.1</size></box></geometry>"
TABLE = f"""<sdf version="1.9"><model name="table"><link name="top">
<inertial><mass>4</mass></inertial>
<visual name="v">{BOX}</visual><collision name="c">{BOX}</collision>
</link></model></sdf>"""


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> Stage:
    one = Stage(HOUSE)

    def watch(topics: tuple[Topic[Any], ...], receive: Receive) -> Callable[[], None]:
        receive(topics[0], HOUSE, Envelope("worldgen", 0, 0, ""))
        return lambda: None

    robot = mock.MagicMock(spec=Robot)
    robot.__enter__.return_value = robot
    robot.ask.side_effect = lambda query, message, timeout_s: one.ask(query, message)
    robot.watch.side_effect = watch
    monkeypatch.setattr("mazebot.common.client.over_zenoh.ZenohRobot", lambda endpoint: robot)
    return one


def run(line: str) -> str:
    """What a command prints that does what it should."""
    done = mazebot(*line.split())
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def body(stage: Stage) -> doc.BodyEntity:
    return stage.physics.sets[-1].bodies[-1]


def test_a_box_stands_on_the_floor_where_it_is_put(stage: Stage) -> None:
    assert run("spawn crate --box 0.3 0.4 0.5 --at -1.5 2") == (
        "crate: (-1.500, 2.000, 0.250) m, yaw 0.000 rad\n"
    )
    assert run("spawn ball --sphere 0.1 --at 1 2 0.7 --mass 2 --yaw -1.5 --colour 1 0 0") == (
        "ball: (1.000, 2.000, 0.700) m, yaw -1.500 rad\n"
    )
    ball = body(stage)
    assert (ball.mass_kg, ball.materials[0].diffuse) == (2.0, (1.0, 0.0, 0.0, 1.0))
    said = run(f"spawn pipe --cylinder 0.1 1 --at 2 2 --rpy {math.pi / 2} 0 0")
    assert said == "pipe: (2.000, 2.000, 0.100) m, quaternion (0.7071, 0.0000, 0.0000, 0.7071)\n"


def test_what_goes_from_place_to_place(stage: Stage) -> None:
    run("spawn patrol --box 0.3 0.3 0.5 --at 0 2 --path 1 2 1 -3.5 --speed 0.4 --loop --no-yield")
    assert body(stage).path == doc.ScriptedPath(
        waypoints_m=((1.0, 2.0), (1.0, -3.5)), speed_m_s=0.4, loop=True, yields=False
    )
    assert "2 waypoints, 0.4 m/s, loop" in run("entities")


def test_a_texture_is_put_on_all_that_is_seen(stage: Stage, tmp_path: Path) -> None:
    file = tmp_path / "wood.png"
    cv2.imwrite(str(file), np.full((8, 8, 3), 90, np.uint8))
    run(f"spawn crate --box 1 1 1 --at 1 2 --texture {file}")
    (material,) = body(stage).materials
    assert (material.texture_name, material.texture_side_m) == ("wood.png", 0.0)
    assert body(stage).shapes[0].material == material.name


def test_a_mesh_in_a_file_is_scaled_and_stands_on_the_floor(stage: Stage, tmp_path: Path) -> None:
    file = tmp_path / "wedge.obj"
    file.write_text("v 0 0 -1\nv 1 0 -1\nv 0 1 -1\nv 0 0 2\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    said = run(f"spawn wedge --mesh {file} --scale 0.5 --at 1 2")
    assert said == "wedge: (1.000, 2.000, 0.500) m, yaw 0.000 rad\n"
    geometry = body(stage).shapes[0].geometry
    assert isinstance(geometry, doc.Mesh)
    assert geometry.scale == (0.5, 0.5, 0.5)


def test_a_model_is_found_by_file_folder_or_name(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "table"
    folder.mkdir()
    (folder / "model.sdf").write_text(TABLE)
    config = '<model><name>t</name><sdf version="1.9">model.sdf</sdf></model>'
    (folder / "model.config").write_text(config)
    run(f"spawn a --model {folder}/model.sdf --at 0 2")
    run(f"spawn b --model {folder} --at 2 2 --mass 0")
    run(f"spawn c --model table --models {tmp_path} --at 4 2")
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(tmp_path))
    run("spawn d --model table --at 6 2")
    found = stage.physics.sets[-1].bodies
    assert [one.mass_kg for one in found] == [4.0, 0.0, 4.0, 4.0]
    assert {one.position_m[2] for one in found} == {-0.45}


def test_markers_hang_on_walls(stage: Stage) -> None:
    run("spawn here --marker 8 --size 0.2 --wall wall --side right --offset -0.5 --height 0.3")
    run("spawn there --marker 9 --size 0.2 --at 1.5 0.102 0.4 --yaw 1.5707963267948966")
    run("spawn model --model aruco_id_60 --wall wall --offset 1")
    here, there, model = stage.physics.sets[-1].markers[1:]
    assert here.position_m == pytest.approx((-0.5, -0.102, 0.3))
    assert rotation_from_quaternion(*here.orientation_xyzw)[:, 2] == pytest.approx([0, -1, 0])
    assert rotation_from_quaternion(*there.orientation_xyzw)[:, 2] == pytest.approx([0, 1, 0])
    assert (model.marker_id, model.marker_size_m) == (60, 0.3)
    assert model.panel_side_m == pytest.approx(0.4)
    run("move here --wall wall --side left --offset -1 --height 0.35")
    assert stage.physics.sets[-1].markers[1].position_m == pytest.approx((-1.0, 0.102, 0.35))


def test_what_is_not_said_of_a_move_stays(stage: Stage) -> None:
    run("spawn crate --box 1 1 1 --at 1 2 0.7 --yaw 0.5")
    assert run("move crate --at 3 4") == "crate: (3.000, 4.000, 0.700) m, yaw 0.500 rad\n"
    assert run("move crate --yaw -0.5") == "crate: (3.000, 4.000, 0.700) m, yaw -0.500 rad\n"
    assert run("move crate --at 3 5 0.5") == "crate: (3.000, 5.000, 0.500) m, yaw -0.500 rad\n"


def test_things_are_listed_and_removed(stage: Stage) -> None:
    for number, name in enumerate("abc"):
        run(f"spawn {name} --box 0.1 0.1 0.1 --at {number} 2")
    lines = run("entities").splitlines()
    assert re.split(" {2,}", lines[0]) == [
        "name", "kind", "x m", "y m", "z m", "yaw rad", "mass kg", "path"
    ]  # fmt: skip
    assert re.split(" {2,}", lines[1]) == [
        "aruco_7", "marker 7 (DICT_4X4_100)", "0.000", "0.102", "0.400", "1.571"
    ]  # fmt: skip
    assert re.split(" {2,}", lines[2]) == ["a", "body", "0.000", "2.000", "0.050", "0.000", "0"]
    assert [one["name"] for one in json.loads(run("entities --json"))["entities"]] == [
        "aruco_7", "a", "b", "c",
    ]  # fmt: skip
    assert run("remove b a") == "b: removed\na: removed\n"
    assert run("remove --all") == "c: removed\n"
    assert stage.names() == ["aruco_7"]


def test_a_taken_name_is_refused_or_changed(stage: Stage) -> None:
    run("spawn crate --box 1 1 1 --at 1 2")
    run("spawn crate --box 1 1 1 --at 1 2")
    again = "spawn crate --box 1 1 1 --at 3 2"
    done = mazebot(*again.split())
    assert (done.returncode, done.stderr) == (2, "error: name: 'crate' already exists\n")
    assert run(f"{again} --allow-renaming").startswith("crate_1: (3.000")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("spawn crate", "must be given one of --box"),
        (
            "spawn crate --box 1 1 1 --sphere 1 --at 1 2",
            "spawn: --box and --sphere: must be given one of them only",
        ),
        ("spawn crate --box 1 1 1", "must be given --at X Y [Z]"),
        ("spawn crate --box 1 1 --at 1 2", "--box: '1 1': must be 3 numbers"),
        ("spawn crate --box 1 1 nan --at 1 2", "--box: '1 1 nan': must be finite numbers"),
        ("spawn crate --box 1 -1 1 --at 1 2", "--box: size_m.1: must be greater than 0"),
        ("spawn crate --box 1 1 1 --at 1", "--at: '1': must be 2 or 3 numbers"),
        ("spawn crate --box 1 1 1 --at 1 2 --yaw 1 --rpy 0 0 0", "--yaw: must not be given with"),
        ("spawn crate --box 1 1 1 --at 1 2 --yaw inf", "--yaw: inf: must be a finite number"),
        ("spawn crate --box 1 1 1 --at 1 2 --wall wall", "--wall: only for markers"),
        *(
            (f"spawn crate --box 1 1 1 --at 1 2 {option}", f"{option.split()[0]}: must be given")
            for option in (
                *("--scale 3", "--size 2", "--dictionary foo", "--side right", "--offset 0"),
                *("--height .5", "--speed .3", "--loop", "--yield", "--models worlds"),
            )
        ),
        ("spawn m --marker 8 --at 1 2 1 --yaw 0 --height 1", "--height: must be given only with"),
        ("move aruco_7 --at 1 2 --side left", "--side: must be given only with --wall"),
        ("move aruco_7 --at 1 2 --wall wall", "--wall: wall: must not be given with a pose"),
        ("spawn crate --box 1 1 1 --at 1 2 --mass -1", "mass_kg: must be greater than or"),
        ("spawn crate --box 1 1 1 --at 1 2 --colour 1 2 3", "--colour: '1 2 3': must be 0 to 1"),
        (
            "spawn crate --box 1 1 1 --at 1 2 --texture none.png",
            "none.png: cannot be read",
        ),
        ("spawn crate --box 1 1 1 --at 1 2 --path 1 2 3", "--path: 3 numbers: must be pairs"),
        ("spawn crate --box 1 1 1 --at 1 2 --path 1 2 --speed 0", "--path: speed_m_s: must"),
        (
            "spawn crate --box 1 1 1 --at 1 2 --path 1 2 --mass 1",
            "mass_kg: 1: must be 0: it follows a path",
        ),
        ("spawn crate --model a --models nope --at 1 2", "--models: nope: must be a folder"),
        ("spawn crate --model nope --at 1 2", "model: 'nope': must be a file, a folder, or one of"),
        ("spawn crate --model turtlebot3_waffle --at 1 2", "joint turtlebot3_waffle::wheel_left"),
        ("spawn crate --mesh nope.stl --at 1 2", "nope.stl: cannot be read"),
        ("spawn m --marker 8", "--marker: 8: must be given --wall, or --at X Y Z and --yaw"),
        ("spawn m --marker 8 --wall wall --mass 1", "--mass: must not be given for a marker"),
        ("spawn m --marker 8 --wall roof", "--wall: 'roof': must be one of wall"),
        (
            "spawn m --marker 8 --wall wall --at 1 2 3",
            "--wall: wall: must not be given with",
        ),
        ("spawn m --marker 8 --wall wall --side up", "side: must be 'left' or 'right'"),
        ("spawn m --marker 800 --wall wall", "id: 800: must be less than 100 in DICT_4X4_100"),
        ("spawn m --marker 8 --wall wall --dictionary QR", "dictionary: 'QR': must be one of"),
        ("spawn m --marker 8 --wall wall --height 0.9", "extends 0.100 m above the top of wall"),
        (f"spawn crate --box 1 1 1 --at {FORBIDDEN_X_M + 1} 2", "crate: too far"),
        (
            "move crate --at 1 2",
            "name: 'crate': no such entity: must be one of aruco_7",
        ),
        ("move aruco_7", "move: must be given --at, --yaw, --rpy or --wall"),
        ("remove", "remove: must be given names, or --all"),
        ("remove --all crate", "remove: must be given names, or --all"),
        ("remove crate", "name: 'crate': no such entity"),
        ("remove wall", "name: 'wall': is part of the world"),
    ],
)
def test_a_mistake_is_one_line_and_changes_nothing(stage: Stage, line: str, words: str) -> None:
    done = mazebot(*line.split())
    assert_one_line(done, words)
    assert done.returncode == 2
    assert stage.names() == ["aruco_7"]

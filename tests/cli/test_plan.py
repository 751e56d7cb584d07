"""`mazebot plan` on maps of Nav2."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.world.map_files import Mode, write_map
from mazebot.navigation.config import NavigationConfig
from tests.cli.test_app import mazebot


def house(folder: Path, mode: Mode = "trinary", suffix: str = "pgm", yaw_rad: float = 0.0) -> str:
    """Two rooms of 2.5 x 3 m with a door, and an unknown corner; its origin is at (-1, -2)."""
    cells = np.zeros((60, 100), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
    cells[:30, 48:52] = cells[50:, 48:52] = 100
    if mode != "scale" or suffix == "png":
        cells[52:58, 80:96] = -1
    origin = SE2(-1.0, -2.0, yaw_rad)
    return str(
        write_map(folder, "house", cells, 0.05, origin, mode, "png" if suffix == "png" else "pgm")
    )


@pytest.mark.parametrize(
    ("mode", "suffix"), [("trinary", "pgm"), ("trinary", "png"), ("scale", "png"), ("raw", "pgm")]
)
def test_a_path_is_printed(tmp_path: Path, mode: Mode, suffix: str) -> None:
    chart = house(tmp_path, mode, suffix)
    done = mazebot("plan", "--map", chart, "--start", "-0.2,-1", "--goal=3,-1,1.57")
    assert done.returncode == 0, done.stderr
    first, *poses = done.stdout.splitlines()
    assert first.startswith("length 3.")
    assert "ms by any_angle" in first
    assert poses[0].startswith("-0.200 -1.000 ")
    assert poses[-1] == "3.000 -1.000 1.570"


def test_the_answer_for_programs(tmp_path: Path) -> None:
    chart = house(tmp_path)
    arguments = ("--map", chart, "--start", "-0.2,-1", "--goal", "3,-1", "--radius", "0.2")
    said = json.loads(mazebot("plan", *arguments, "--planner", "a_star", "--json").stdout)
    assert said["error_code"] == 0
    assert said["planner"] == "a_star"
    assert said["poses"][-1] == [3.0, -1.0, 0.0]
    steps = np.diff(np.array(said["poses"])[:, :2], axis=0)
    assert np.linalg.norm(steps, axis=1).sum() == pytest.approx(said["length_m"], abs=1e-2)


@pytest.mark.parametrize(
    ("goal", "more", "code", "said"),
    [
        ("9,9", (), 204, "lies outside the map"),
        ("1.5,-1", (), 206, "the nearest free pose is"),
        ("3.5,0.75", ("--radius", "0.1"), 208, "unknown space"),
        ("3,-1", ("--radius", "0.7"), 208, "too narrow at"),
    ],
)
def test_why_there_is_no_path(
    tmp_path: Path, goal: str, more: tuple[str, ...], code: int, said: str
) -> None:
    arguments = ("plan", "--map", house(tmp_path), "--start", "0,-0.9", "--goal", goal, *more)
    done = mazebot(*arguments)
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: {code} ")
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    answer = json.loads(mazebot(*arguments, "--json").stdout)
    assert answer["error_code"] == code
    assert (answer["nearest_free"] is not None) == ("nearest free" in answer["error_msg"])


def mask(folder: Path, name: str, x_m: tuple[float, float], value: int) -> str:
    """A mask over all of the house's y, in cells of another size than the map's."""
    cells = np.zeros((30, 50), np.int8)
    columns = [round((x + 1.0) / 0.1) for x in x_m]
    cells[:, slice(*columns)] = value
    return str(write_map(folder, name, cells, 0.1, SE2(-1.0, -2.0, 0.0), "raw"))


def test_a_keepout_mask_is_kept_out_of(tmp_path: Path) -> None:
    chart = house(tmp_path)
    ways = ("plan", "--map", chart, "--start", "-0.2,-1", "--json")
    free = json.loads(mazebot(*ways, "--goal", "1,-1").stdout)
    assert free["length_m"] == pytest.approx(1.2, abs=0.02)
    # Across all of the room.
    shut = mask(tmp_path, "shut", (0.2, 0.6), 100)
    said = json.loads(mazebot(*ways, "--goal", "1,-1", "--keepout", shut).stdout)
    assert said["error_code"] == 208
    assert "the keepout zone of shut.yaml" in said["error_msg"]
    # The goal's own zone is named, with the nearest pose outside; that of the start is left.
    said = json.loads(mazebot(*ways, "--goal", "0.4,-1", "--keepout", shut).stdout)
    assert said["error_code"] == 206
    assert "is in the keepout zone of shut.yaml" in said["error_msg"]
    assert not 0.2 < said["nearest_free"][0] < 0.6
    inside = mask(tmp_path, "inside", (-0.5, 0.3), 100)
    said = json.loads(mazebot(*ways, "--goal", "1,-1", "--keepout", inside).stdout)
    assert said["length_m"] == pytest.approx(1.2, abs=0.05)


def test_a_speed_mask_says_where_the_robot_is_slow(tmp_path: Path) -> None:
    slow = mask(tmp_path, "slow", (0.2, 0.6), 60)
    ways = ("plan", "--map", house(tmp_path), "--start", "-0.2,-1", "--goal", "1,-1")
    said = json.loads(mazebot(*ways, "--speed", slow, "--json").stdout)
    (limit,) = said["speed_limits"]
    highest_m_s = NavigationConfig().controller_server.max_linear_vel
    assert limit["speed_limit_m_s"] == pytest.approx(0.4 * highest_m_s, abs=1e-4)
    assert limit["length_m"] == pytest.approx(0.4, abs=0.06)
    lines = mazebot(*ways, "--speed", slow).stdout.splitlines()
    assert lines[1].startswith("at most ")
    assert json.loads(mazebot(*ways, "--json").stdout)["speed_limits"] == []


def test_the_picture_shows_the_path_or_what_blocks_it(tmp_path: Path) -> None:
    chart = house(tmp_path)
    for goal, radius in (("3,-1", "0.2"), ("3,-1", "0.6")):
        file = tmp_path / f"{radius}.png"
        mazebot(
            "plan", "--map", chart, "--start=0,-1", "--goal", goal, "--radius", radius,
            "--draw", str(file),
        )  # fmt: skip
        picture = cv2.imread(str(file))
        assert picture is not None
        assert picture.shape[1] >= 900
        red = (picture == (0, 0, 255)).all(-1)
        # A path of 4.5 m, or a dot.
        assert red.sum() > 300


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--start", "1"), "--start"),
        (("--goal", "1,two"), "--goal"),
        (("--planner", "dstar"), "any_angle"),
        (("--radius", "-1"), "--radius"),
        (("--draw", "path.jpg"), ".png"),
        (("--map", "missing.yaml"), "missing.yaml"),
        (("--keepout", "missing.yaml"), "error: --keepout: missing.yaml"),
        (("--speed", "missing.yaml"), "error: --speed: missing.yaml"),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, arguments: tuple[str, str], said: str) -> None:
    given = {"--map": house(tmp_path), "--start": "0,-1", "--goal": "3,-1"}
    given[arguments[0]] = arguments[1]
    done = mazebot("plan", *(word for pair in given.items() for word in pair))
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1

"""The places of `mazebot waypoints`: names, and files of them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from mazebot.cli.drive.waypoints_file import read_mission
from mazebot.common.config import ConfigError
from mazebot.common.messages.action_documents import WaypointTask
from mazebot.common.messages.documents import Location, Planar

LOCATIONS = (
    Location(name="kitchen", x_m=1.0, y_m=2.0, yaw_rad=0.5),
    Location(name="hall", x_m=-1.0, y_m=0.0, yaw_rad=0.0),
)


def file(folder: Path, text: str) -> list[str]:
    path = folder / "tour.yaml"
    path.write_text(text)
    return [str(path)]


def test_names_are_the_locations_of_the_world() -> None:
    goal = read_mission(["hall", "kitchen"]).goal(LOCATIONS)
    assert [(pose.x_m, pose.yaw_rad) for pose in goal.poses] == [(-1.0, 0.0), (1.0, 0.5)]
    assert goal.tasks == ()
    with pytest.raises(ConfigError, match="'cellar': must be one of hall, kitchen"):
        read_mission(["cellar"]).goal(LOCATIONS)


def test_a_file_has_places_and_tasks(tmp_path: Path) -> None:
    text = """
        waypoints:
          - kitchen
          - [0.5, -0.9, 1.5]
          - {x_m: 1, y_m: 2, wait_s: 3, photo: true}
          - {location: hall, input_timeout_s: 60}
        loops: 2
        """
    goal = read_mission(file(tmp_path, text)).goal(LOCATIONS)
    assert goal.poses[1] == Planar(x_m=0.5, y_m=-0.9, yaw_rad=1.5)
    assert goal.poses[2] == Planar(x_m=1.0, y_m=2.0, yaw_rad=0.0)
    assert goal.number_of_loops == 2
    assert goal.tasks == (
        WaypointTask(),
        WaypointTask(),
        WaypointTask(wait_s=3.0, photo=True),
        WaypointTask(input_timeout_s=60.0),
    )


def test_a_file_that_rviz_saved_is_read(tmp_path: Path) -> None:
    text = """
        waypoints:
          waypoint0: {pose: [1, 2, 0], orientation: [0.7071068, 0, 0, 0.7071068]}
          waypoint1: {pose: [3, 4, 0], orientation: [1, 0, 0, 0]}
        """
    goal = read_mission(file(tmp_path, text)).goal(())
    assert [(pose.x_m, pose.y_m) for pose in goal.poses] == [(1.0, 2.0), (3.0, 4.0)]
    assert goal.poses[0].yaw_rad == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("waypoints: []", "waypoints: |1 to 1000"),
        ("waypoints: [3]", "waypoints[0]: 3|name of a location"),
        ("waypoints: [[1]]", "waypoints[0]|[x, y, yaw]"),
        ("waypoints: [[1, .nan]]", "waypoints[0][1]: nan|a number"),
        ("waypoints: [{x_m: 1}]", "waypoints[0].y_m|is missing"),
        ("waypoints: [{locaton: hall}]", "waypoints[0].locaton|location"),
        ("waypoints: [{location: hall, x_m: 1}]", "waypoints[0].x_m|must not be given with"),
        ("waypoints: [{location: hall, wait_s: -1}]", "waypoints[0].wait_s: -1|0 to 86400"),
        ("waypoints: [{location: hall, photo: maybe}]", "waypoints[0].photo: 'maybe'|true or"),
        ("waypoints: {a: {pose: [1, 2]}}", "waypoints.a.pose|[x, y, z]"),
        ("waypoints: {a: {pose: [1, 2, 0], orientation: [0, 0, 0, 0]}}", "orientation|zero"),
        ("waypoints: [hall]\nloops: -1", "tour.yaml:2: loops: -1|integer >= 0"),
        ("points: [hall]", "points|unknown field"),
        ("waypoints: [hall", "tour.yaml:|closed"),
    ],
)
def test_a_file_that_is_wrong_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_mission(file(tmp_path, text))
    line = str(caught.value)
    assert "\n" not in line
    for word in ("tour.yaml", *words.split("|")):
        assert word in line, line

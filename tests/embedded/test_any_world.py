"""Any world in one process: what is asked for, put over, and driven."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from mazebot.bringup.tour import PLACES
from mazebot.cli import app
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.world.map_files import write_map
from mazebot.embedded.demo import DemoOptions, bringup_config, check_world, run
from mazebot.worldgen.recipe.loader import load_world
from tests.worldgen import folder


def options(worlds_dir: Path, tmp_path: Path, **more: object) -> DemoOptions:
    return DemoOptions(
        world_name="room", worlds_dir=worlds_dir, out_dir=tmp_path / "run", camera=False,
        record=False, renderer="none", **more,  # type: ignore[arg-type]
    )  # fmt: skip


def test_the_tour_is_that_of_the_world_and_home(tmp_path: Path) -> None:
    recipe = folder.room()
    recipe["locations"] = {"east": {"x_m": 0.6, "y_m": 0.0, "yaw_rad": 0.0}}
    worlds_dir = folder.make(tmp_path / "worlds", recipe)
    assert run(options(worlds_dir, tmp_path)) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert [goal["name"] for goal in summary["goals"]] == ["east", "home"]
    assert summary["contacts"]["count"] == 0


def test_a_map_of_elsewhere_is_told_before_anything_starts(tmp_path: Path) -> None:
    recipe = folder.room()
    del recipe["locations"]
    worlds_dir = folder.make(tmp_path / "worlds", recipe)
    room = load_world("room", worlds_dir=worlds_dir)
    x_m, y_m, yaw_rad = room.map_origin
    elsewhere = SE2(x_m + 7.0, y_m, yaw_rad)
    map_file = write_map(tmp_path, "saved", room.map_cells, 0.1, elsewhere)
    with pytest.raises(
        ConfigError, match=r"must fit the world room: .* shifted by \(-7\.000"
    ) as told:
        check_world(options(worlds_dir, tmp_path, map_file=map_file))
    assert f"map_file: {map_file}: " in str(told.value)


def test_what_is_put_over_a_recipe_is_driven_in_and_recorded(tmp_path: Path) -> None:
    overrides = ("start={x_m: -1.0, y_m: 0.0}", "locations={here: {x_m: -0.6, y_m: 0.0}}")
    worlds_dir = folder.make(tmp_path / "worlds")
    assert run(options(worlds_dir, tmp_path, overrides=overrides)) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert [goal["name"] for goal in summary["goals"]] == ["here", "home"]
    assert summary["goals"][0]["shortest_path_m"] == pytest.approx(0.4, abs=0.05)
    config = (tmp_path / "run" / "config.yaml").read_text()
    assert overrides[1] in config


def test_a_world_is_recorded_by_its_own_name_whichever_was_given(tmp_path: Path) -> None:
    assert bringup_config(DemoOptions(world_name="enhanced")) == bringup_config(DemoOptions())
    # A world of one's own that is called as a short name is.
    worlds_dir = folder.make(tmp_path / "worlds")
    (worlds_dir / "room.yaml").rename(worlds_dir / "enhanced.yaml")
    mine = bringup_config(DemoOptions(world_name="enhanced", worlds_dir=worlds_dir))
    assert mine.world_name == "enhanced"


def test_a_world_with_nowhere_to_drive_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = folder.room()
    del recipe["locations"]
    recipe["boxes"] = [
        {"name": f"box{i}", "size_m": [1.0, 1.0, 0.5], "x_m": x_m, "y_m": y_m}
        for i, (x_m, y_m) in enumerate([(0.9, 0.0), (-0.9, 0.0), (0.0, 0.9), (0.0, -0.9)])
    ]
    worlds_dir = folder.make(tmp_path / "worlds", recipe)
    assert run(options(worlds_dir, tmp_path)) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "room.yaml" in line
    assert "`locations:`" in line
    assert "--goal" in line
    assert not (tmp_path / "run").exists()


PLANE = "<geometry><plane><normal>0 0 1</normal><size>100 100</size></plane></geometry>"
BOX = "<geometry><box><size>{}</size></box></geometry>"


def model(name: str, pose: str, geometry: str) -> str:
    parts = f"<collision name='c'>{geometry}</collision><visual name='v'>{geometry}</visual>"
    link = f"<pose>{pose}</pose><link name='link'>{parts}</link>"
    return f"<model name='{name}'><static>1</static>{link}</model>"


def gazebo_file(file: Path, *models: str) -> Path:
    ground = model("ground_plane", "0 0 0 0 0 0", PLANE)
    world = f"<world name='w'>{ground}{''.join(models)}</world>"
    file.write_text(f"<sdf version='1.9'>{world}</sdf>")
    return file


@pytest.mark.slow
def test_a_gazebo_file_is_driven_in_one_step(tmp_path: Path) -> None:
    """A pillar where the robot would stand, and a default tour around it."""
    file = gazebo_file(
        tmp_path / "my yard.sdf", model("pillar", "0 0 .5 0 0 0", BOX.format("1 1 1"))
    )
    told = replace(options(tmp_path, tmp_path), world_name=str(file), worlds_dir=None)
    assert run(told) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert len(summary["goals"]) == PLACES + 1
    assert summary["contacts"]["count"] == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["my yard.sdf", "run"]


def test_on_open_floor_the_robot_drives_away_from_all_walls(tmp_path: Path) -> None:
    file = gazebo_file(tmp_path / "hall.world")
    told = replace(
        options(tmp_path, tmp_path), world_name=str(file), worlds_dir=None, goal=(4.0, -2.0, 0.0)
    )
    assert run(told) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["goals"][0]["reached"]


@pytest.mark.slow
def test_out_of_reach_of_all_walls_and_back_the_pose_is_known(tmp_path: Path) -> None:
    file = gazebo_file(
        tmp_path / "yard.sdf", model("wall", "1 2 .5 0 0 .4", BOX.format("3 .2 1")),
        model("block", "-1 -2 .5 0 0 0", BOX.format("1 1 1")),
    )  # fmt: skip
    places = "east: {x_m: 9.5, y_m: 3}, back: {x_m: 0, y_m: -0.5}, west: {x_m: -8, y_m: -6}"
    told = replace(
        options(tmp_path, tmp_path), world_name=str(file), worlds_dir=None,
        overrides=(f"locations={{{places}}}",),
    )  # fmt: skip
    assert run(told) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert [goal["name"] for goal in summary["goals"]] == ["east", "back", "west", "home"]
    assert all(goal["goal_error_m"] < 0.1 for goal in summary["goals"])


def test_the_mistakes_of_a_gazebo_file_are_one_line(tmp_path: Path) -> None:
    file = tmp_path / "broken.sdf"
    file.write_text("<sdf version='1.9'><world name='w'><model/></world></sdf>")
    with pytest.raises(ConfigError, match=r"broken\.sdf") as caught:
        run(replace(options(tmp_path, tmp_path), world_name=str(file), worlds_dir=None))
    assert "\n" not in str(caught.value)
    with pytest.raises(ConfigError, match=r"gone\.world"):
        run(replace(options(tmp_path, tmp_path), world_name=str(tmp_path / "gone.world")))
    assert not (tmp_path / "run").exists()


def test_walls_on_the_boundaries_of_cells_push_the_pose_nowhere(tmp_path: Path) -> None:
    """At the end of a hall whose walls are 0.2 m thick, on whole decimetres, faces and all."""
    recipe = folder.room() | {"map_resolution_m": 0.05, "wall_thickness_m": 0.2, "markers": []}
    south, east, north, _ = recipe["walls"]
    for wall in (south, north):
        wall.update(length_m=8.0, x_m=2.0)
    east.update(x_m=6.0)
    recipe["start"] = {"x_m": 4.0, "y_m": 0.0}
    worlds_dir = folder.make(tmp_path / "worlds", recipe)
    assert run(options(worlds_dir, tmp_path, goal=(5.5, 0.0, 0.0))) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["localisation_error_m"]["p95"] < 0.006


def test_a_wrong_override_is_one_line(tmp_path: Path) -> None:
    worlds_dir = folder.make(tmp_path / "worlds")
    with pytest.raises(ConfigError) as caught:
        run(options(worlds_dir, tmp_path, overrides=("wall_height_m=-1",)))
    assert "wall_height_m" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "run").exists()


def test_the_command_passes_all_of_it_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mazebot.embedded import demo

    taken: list[DemoOptions] = []

    def take(given: DemoOptions) -> int:
        taken.append(given)
        return 0

    monkeypatch.setattr(demo, "run", take)
    words = ["demo", "--world", "maze", "--set", "maze.seed=3", "--set", "maze.rows=4"]
    monkeypatch.setattr("sys.argv", ["mazebot", *words, "--worlds-dir", str(tmp_path)])
    with pytest.raises(SystemExit) as left:
        app.main()
    assert left.value.code == 0
    (given,) = taken
    assert given.world_name == "maze"
    assert given.overrides == ("maze.seed=3", "maze.rows=4")
    assert given.worlds_dir == tmp_path
    words = ["demo", "--world", "a.sdf.xacro", "--arg", "height:=2", "--path", str(tmp_path)]
    monkeypatch.setattr("sys.argv", ["mazebot", *words])
    with pytest.raises(SystemExit):
        app.main()
    assert taken[-1].world_name == "a.sdf.xacro"
    assert taken[-1].arguments == {"height": "2"}
    assert taken[-1].roots[0] == tmp_path
    # Nothing of a recipe's would ever ask for them.
    monkeypatch.setattr("sys.argv", ["mazebot", "demo", "--world", "maze", "--arg", "height:=2"])
    with pytest.raises(SystemExit) as left:
        app.main()
    assert left.value.code == 2
    assert len(taken) == 2

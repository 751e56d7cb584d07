"""Any world in one process: what is asked for, put over, and driven."""

import json
from pathlib import Path

import pytest

from services.cli import app
from services.common.config import ConfigError
from services.embedded.demo import DemoOptions, run
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


def test_what_is_put_over_a_recipe_is_driven_in_and_recorded(tmp_path: Path) -> None:
    overrides = ("start={x_m: -1.0, y_m: 0.0}", "locations={here: {x_m: -0.6, y_m: 0.0}}")
    worlds_dir = folder.make(tmp_path / "worlds")
    assert run(options(worlds_dir, tmp_path, overrides=overrides)) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert [goal["name"] for goal in summary["goals"]] == ["here", "home"]
    assert summary["goals"][0]["shortest_path_m"] == pytest.approx(0.4, abs=0.05)
    config = (tmp_path / "run" / "config.yaml").read_text()
    assert overrides[1] in config


def test_a_world_with_nowhere_to_drive_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = folder.room()
    del recipe["locations"]
    worlds_dir = folder.make(tmp_path / "worlds", recipe)
    assert run(options(worlds_dir, tmp_path)) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "room.yaml" in line
    assert "`locations:`" in line
    assert "--goal" in line
    assert not (tmp_path / "run").exists()
    assert run(options(worlds_dir, tmp_path, goal=(0.4, 0.0, 0.0))) == 0


def test_a_wrong_override_is_one_line(tmp_path: Path) -> None:
    worlds_dir = folder.make(tmp_path / "worlds")
    with pytest.raises(ConfigError) as caught:
        run(options(worlds_dir, tmp_path, overrides=("wall_height_m=-1",)))
    assert "wall_height_m" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "run").exists()


def test_the_command_passes_all_of_it_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from services.embedded import demo

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

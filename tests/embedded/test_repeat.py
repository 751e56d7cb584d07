"""A run's own config.yaml repeats the run, to the last bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from mazebot.cli.app import main
from mazebot.common.messages.documents import SimulationControl
from mazebot.common.messages.topics import SIMULATION_CONTROL
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.common.recordings.comparing.digests import read_digests
from mazebot.common.recordings.comparing.run_comparison import compare
from mazebot.embedded.demo import DemoOptions, build_nodes
from tests.cli.test_app import assert_one_line, mazebot
from tests.worldgen import folder


@pytest.fixture
def worlds_dir(tmp_path: Path) -> Path:
    return folder.make(tmp_path / "worlds")


def summary_of(run: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((run / "summary.json").read_text())
    return summary


def driven(run: Path, *words: str, **environment: str) -> dict[str, Any]:
    done = mazebot("demo", "--out", str(run), *words, **environment)
    assert done.returncode == 0, done.stderr
    return summary_of(run)


@pytest.mark.slow
def test_a_run_s_own_configuration_repeats_it(tmp_path: Path, worlds_dir: Path) -> None:
    settings = {
        "MAZEBOT_PHYSICS_SCAN_NOISE_M": "0.02", "MAZEBOT_NAVIGATION_MAX_LINEAR_VEL": "0.3",
        "MAZEBOT_PHYSICS_CAMERA_PROFILE": "small",
    }  # fmt: skip
    words = ["--world", "room", "--worlds-dir", str(worlds_dir), "--seed", "11"]
    words += ["--set", "start={x_m: -1.0, y_m: 0.0}", "--set", "locations={a: {x_m: -0.5, y_m: 0}}"]
    first = driven(tmp_path / "first", *words, **settings)
    config = str(tmp_path / "first" / "config.yaml")
    again = driven(tmp_path / "again", "--config", config)
    for name in ("world_hash", "seed", "state_hash", "image_hash", "goals"):
        assert again[name] == first[name], name
    assert first["seed"] == 11
    assert first["image_hash"]
    digests = (read_digests(tmp_path / name / "digests.bin") for name in ("first", "again"))
    assert compare(*digests).differences == ()
    # What is said beside it wins.
    other = driven(tmp_path / "other", "--config", config, "--seed", "12", "--no-record")
    assert (other["seed"], other["world_hash"]) == (12, first["world_hash"])
    assert other["state_hash"] != first["state_hash"]
    assert not (tmp_path / "other" / "run.rrd").exists()


def test_a_run_whose_world_has_changed_since_is_not_repeated(
    tmp_path: Path, worlds_dir: Path
) -> None:
    words = ["--no-camera", "--no-record", "--goal", "0.4", "0", "0"]
    driven(tmp_path / "run", "--world", "room", "--worlds-dir", str(worlds_dir), *words)
    config = tmp_path / "run" / "config.yaml"
    folder.write(worlds_dir, "room", {**folder.room(), "wall_height_m": 1.5})
    done = mazebot("demo", "--config", str(config), "--out", str(tmp_path / "again"))
    assert_one_line(done, "config.yaml", "world_hash", yaml.safe_load(config.read_text())["world"])
    assert not (tmp_path / "again").exists()


def test_the_settings_of_another_machine_s_folders_are_left_out(tmp_path: Path) -> None:
    words = ["--world", "original", "--no-camera", "--no-record", "--goal", "0.4", "0", "0"]
    first = driven(tmp_path / "run", *words)
    config = yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())
    config["services"]["worldgen"]["worlds_dir"] = "/opt/elsewhere/worlds"
    config["services"]["recorder"] |= {"recordings_dir": "/elsewhere", "live": True}
    moved = tmp_path / "moved.yaml"
    moved.write_text(yaml.safe_dump(config))
    assert driven(tmp_path / "again", "--config", str(moved))["state_hash"] == first["state_hash"]


def test_environment_and_file_are_heard_by_a_run(tmp_path: Path) -> None:
    file = tmp_path / "mazebot.yaml"
    file.write_text("seed: 9\nphysics: {camera_enabled: false}\nbringup: {goal: [0.4, 0.0, 0.0]}\n")
    by_file = driven(tmp_path / "file", "--config", str(file), "--no-record", "--world", "original")
    assert (by_file["seed"], by_file["renderer"], len(by_file["goals"])) == (9, "none", 1)
    by_variable = driven(
        tmp_path / "variable", "--no-record", "--world", "original",
        MAZEBOT_CONFIG=str(file), MAZEBOT_SEED="10",
    )  # fmt: skip
    assert by_variable["seed"] == 10


def test_a_run_can_be_told_in_json(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["--world", "original", "--no-camera", "--no-record", "--goal", "0.4", "0", "0"]
    monkeypatch.setattr(
        "sys.argv", ["mazebot", "demo", "--json", *words, "--out", str(tmp_path / "r")]
    )
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 0
    told, log = capfd.readouterr()
    assert json.loads(told) == {
        "folder": str(tmp_path / "r"), "exit_code": 0, "unrecorded": None,
        **summary_of(tmp_path / "r"),
    }  # fmt: skip
    assert "tour finished" in log
    assert "recording to" not in log


def test_a_run_after_a_reset_is_repeated_with_its_own_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAZEBOT_RECORDER_RECORDINGS_DIR", str(tmp_path / "recordings"))
    nodes = build_nodes(
        DemoOptions(world_name="original", camera=False, record=False, goal=(0.4, 0.0, 0.0))
    )
    transport = MemoryTransport()
    executive = Executive(nodes, transport)
    assert executive.run(lambda: executive.now_ns >= 1_000_000_000) is None
    asked = SimulationControl(reset="all", seed=11)
    assert transport.ask(SIMULATION_CONTROL, asked, lambda _: None)
    assert executive.run() == 0
    executive.close()
    monkeypatch.delenv("MAZEBOT_RECORDER_RECORDINGS_DIR")
    _, second = sorted((tmp_path / "recordings").iterdir())
    again = driven(tmp_path / "again", "--config", str(second / "config.yaml"), "--no-record")
    assert again["seed"] == 11
    assert again["state_hash"] == summary_of(second)["state_hash"]

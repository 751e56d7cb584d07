"""The main job, whole: both worlds, every node, every goal, judged by the ground truth."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from mazebot.common.messages.documents import SimulationControl
from mazebot.common.messages.topics import SIMULATION_CONTROL
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.embedded.demo import DemoOptions, build_nodes, run

GOALS = ["location1", "location2", "location3", "location4", "home"]


def tour(out_dir: Path, **options: Any) -> dict[str, Any]:
    """The summary of a tour that ended well."""
    assert run(DemoOptions(out_dir=out_dir, **options)) == 0
    summary: dict[str, Any] = json.loads((out_dir / "summary.json").read_text())
    return summary


def assert_driven_well(summary: dict[str, Any]) -> None:
    assert [goal["name"] for goal in summary["goals"]] == GOALS
    for goal in summary["goals"]:
        assert goal["reached"], goal
        assert goal["goal_error_m"] <= 0.25
        assert goal["goal_error_rad"] <= 0.25
        assert goal["path_length_m"] <= 1.15 * goal["shortest_path_m"]
    assert summary["contacts"] == {"count": 0, "list": []}
    assert summary["localisation_error_m"]["p95"] <= 0.10
    assert summary["localisation_error_rad"]["p95"] <= math.radians(4.0)
    for name, counts in summary["messages"].items():
        assert counts["lost"] == 0, name
        assert counts["received"] == counts["sent"], name


@pytest.mark.timeout(240)
def test_the_enhanced_tour_with_camera_and_recording(tmp_path: Path) -> None:
    summary = tour(tmp_path / "run", world_name="enhanced")
    assert_driven_well(summary)
    assert summary["world"] == "sim_house_enhanced"
    assert summary["markers_seen"]["60"] > 0
    assert summary["markers_seen"]["80"] > 0
    assert summary["marker_error_m"]["p95"] < 0.10
    assert (tmp_path / "run" / "run.rrd").stat().st_size > 1_000_000
    assert (tmp_path / "run" / "config.yaml").is_file()
    assert set(summary) >= {
        "world", "world_hash", "seed", "state_hash", "sim_time_s", "wall_time_s",
        "real_time_factor", "renderer", "goals", "contacts", "markers_seen",
        "localisation_error_m", "localisation_error_rad", "marker_error_m", "odometry_drift_m",
        "messages", "versions",
    }  # fmt: skip


@pytest.mark.timeout(240)
def test_the_original_tour_without_a_camera(tmp_path: Path) -> None:
    summary = tour(
        tmp_path / "run", world_name="original", camera=False, record=False, renderer="none"
    )
    assert_driven_well(summary)
    assert summary["world"] == "sim_house"
    assert summary["markers_seen"] == {}
    assert not (tmp_path / "run" / "run.rrd").exists()


def test_without_markers_the_enhanced_world_is_another(tmp_path: Path) -> None:
    code = run(
        DemoOptions(
            out_dir=tmp_path / "run", use_aruco=False, camera=False, record=False, renderer="none",
            goal=(0.5, 0.0, 0.0),
        )
    )  # fmt: skip
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert code == 0
    assert summary["markers_seen"] == {}
    assert [goal["name"] for goal in summary["goals"]] == ["goal"]


def test_a_reset_in_mid_drive_leaves_nothing_of_the_goal_that_it_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAZEBOT_RECORDER_RECORDINGS_DIR", str(tmp_path))
    nodes = build_nodes(
        DemoOptions(camera=False, record=False, renderer="none", goal=(-1.678, -1.178, -2.25))
    )
    transport = MemoryTransport()
    executive = Executive(nodes, transport)
    assert executive.run(lambda: executive.now_ns >= 2_000_000_000) is None
    assert transport.ask(SIMULATION_CONTROL, SimulationControl(reset="all"), lambda _: None)
    # Its goal has the stamp of the one before the reset: all begins anew to the last bit.
    assert executive.run() == 0
    executive.close()
    first, second = (
        json.loads((run / "summary.json").read_text()) for run in sorted(tmp_path.iterdir())
    )
    assert (first["goals_sent"], first["goals"]) == (1, [])
    assert (second["goals_sent"], second["goals_reached"], len(second["goals"])) == (1, 1, 1)


@pytest.mark.parametrize(
    ("goal", "code", "words"),
    [
        ((1.4, 2.0, 0.0), 206, "inside an obstacle"),
        ((50.0, 0.0, 0.0), 204, "outside"),
        ((4.5, -2.0, 0.0), 208, ""),
    ],
)
def test_a_goal_that_cannot_be_is_refused_before_the_robot_moves(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    goal: tuple[float, float, float],
    code: int,
    words: str,
) -> None:
    options = DemoOptions(
        out_dir=tmp_path / "run", camera=False, record=False, renderer="none", goal=goal
    )
    assert run(options) == 1
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    (report,) = summary["goals"]
    assert report["error_code"] == code
    assert words in report["error_msg"].lower()
    assert report["path_length_m"] < 0.01
    assert str(code) in capsys.readouterr().out

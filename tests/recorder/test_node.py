"""The recorder from the outside: what stands in a run's folder, and what it says."""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
import yaml

from mazebot.common.config import ConfigError
from mazebot.common.files.root import ROOT
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages import wire
from mazebot.common.node.node import Envelope
from mazebot.common.recordings.comparing.digests import DigestWriter, read_digests
from mazebot.common.recordings.report.report import write_report
from mazebot.common.recordings.run_folder import is_recording
from mazebot.recorder import node as node_module
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.drawing import archetypes, picture_drawing
from mazebot.recorder.drawing.canvas import Canvas
from mazebot.recorder.keeping.run import drawing as drawing_module
from mazebot.recorder.keeping.run import run as run_module
from mazebot.recorder.node import RecorderNode
from mazebot.recorder.stream.rerun_program import rerun_binary
from mazebot.recorder.stream.rrd_reader import read_rrd
from tests.recorder.synthetic import (
    BRICKS,
    ERROR_M,
    MARKER,
    Bench,
    WallClock,
    driving,
    opening,
    room,
    true_pose,
)


@pytest.fixture(autouse=True)
def strict(request: pytest.FixtureRequest, caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """A drawing that Rerun would only warn of, or that the recorder goes on without, fails."""
    rr.set_strict_mode(True)
    yield
    records = caplog.get_records("call")
    failed = [one.message for one in records if "cannot be drawn" in one.message]
    assert bool(failed) == ("cannot_be_drawn" in request.node.name), failed


def recorder(folder: Path, **fields: Any) -> RecorderNode:
    """A recorder whose clocks are ours."""
    fields = {"video": False, **fields}
    config = RecorderConfig(recordings_dir=folder, compact_timeout_s=0.0, **fields)
    noon = datetime(2026, 11, 21, 12, 0, 0)  # noqa: DTZ001 - local, as folders are named
    return RecorderNode(config, WallClock(), lambda: noon)


def summary_of(run: Path) -> dict[str, Any]:
    summary = json.loads((run / "summary.json").read_text())
    assert isinstance(summary, dict)
    return summary


def verify(recording: Path) -> None:
    """Rerun's own check: whole, with its end."""
    done = subprocess.run(
        [str(rerun_binary()), "rrd", "verify", str(recording)], capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr


def entities_of(recording: Path) -> str:
    """What `rerun rrd stats` prints: every entity and how many chunks it has."""
    command = [str(rerun_binary()), "rrd", "stats", str(recording)]
    return subprocess.run(command, capture_output=True, check=True, text=True).stdout


def times_of(parts: Iterable[Path], entity: str) -> list[int]:
    """When something was drawn at an entity, ns, in order and each time once."""
    found: set[int] = set()
    for part in parts:
        for chunk in read_rrd(part).stream():
            if chunk.entity_path == entity and "sim_time" in chunk.timeline_names:
                column = chunk.to_record_batch().column("sim_time")
                found |= set(column.to_numpy(False).astype(np.int64).tolist())
    return sorted(found)


def test_a_run_leaves_a_whole_recording_a_summary_and_its_configuration(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path, seed=11))
    bench.say([(0, table.PARAMETERS, doc.Parameters(service="spawner", values={"seed": 11}))])
    bench.say(opening(world))
    bench.say([(0, table.PARAMETERS, bench.node.parameters())])
    bench.say(driving(world, 3.0))
    bench.node.close()
    (run,) = tmp_path.iterdir()
    assert run.name == "2026-11-21_12-00-00_room"
    assert {path.name for path in run.iterdir()} == {
        "run.rrd", "run.mcap", "summary.json", "series.json", "config.yaml", "digests.bin",
        "report.html", "thumbnail.png",
    }  # fmt: skip
    verify(run / "run.rrd")
    drawn = entities_of(run / "run.rrd")
    for entity in ("world/walls/bricks", "world/walls_above/plain", "entities/marker_60",
                   "camera/color/image_raw", "aruco/detections/outline", "scan", "plan",
                   "particle_cloud", "global_costmap/costmap", "ground_truth/odom/path",
                   "error/localisation_m", "evaluation", "parameters/spawner", "rosout/physics",
                   "diagnostics/navigation"):  # fmt: skip
        assert f"/{entity}: " in drawn, entity
    config = yaml.safe_load((run / "config.yaml").read_text())
    # The simulation's own, and not the recorder's.
    assert config["seed"] == 7
    assert config["world_request"]["world_name"] == "room"
    assert config["services"]["recorder"]["jpeg_quality"] == 75
    assert config["services"]["spawner"] == {"seed": 11}


def test_what_cannot_be_drawn_is_recorded_and_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(canvas: Canvas, message: msg.Path) -> None:
        raise ValueError("a bug of ours")

    monkeypatch.setitem(archetypes.DRAW, table.PLAN, fail)
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    bench.say(driving(world, 3.0))
    bench.node.close()
    told = [one for one in caplog.messages if "cannot be drawn" in one]
    assert told == ["/plan cannot be drawn"]
    (run,) = tmp_path.iterdir()
    verify(run / "run.rrd")
    assert "/scan: " in entities_of(run / "run.rrd")
    assert summary_of(run)["messages"]["/plan"]["recorded"] > 0


def test_what_cannot_be_drawn_beside_the_run_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(image: msg.Image) -> None:
        raise ValueError("a bug of ours")

    monkeypatch.setattr(picture_drawing, "_depth_png", fail)
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    image = msg.Image(msg.header(0, "camera"), 1, 2, "32FC1", 0, 8, np.ones(8, np.uint8))
    bench.say(driving(world, 3.0))
    bench.say((second * 10**9, table.DEPTH_IMAGE, image) for second in (4, 5, 6))
    bench.node.close()
    told = [one for one in caplog.messages if "cannot be drawn" in one]
    assert told == ["camera/depth/image_rect_raw cannot be drawn"]
    (run,) = tmp_path.iterdir()
    verify(run / "run.rrd")
    assert summary_of(run)["messages"][table.DEPTH_IMAGE.name]["recorded"] == 3


def test_the_summary_holds_what_scripts_read(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    contact = doc.Contact(
        time_s=0.5, robot_link="base_link", body="Wall_0", position_m=(1.0, 0.0, 0.1),
        impulse_n_s=0.2,
    )  # fmt: skip
    bench.say([(0, table.CONTACTS, contact)])
    bench.say(driving(world, 3.0))
    bench.node.close()
    summary = summary_of(next(tmp_path.iterdir()))
    assert (summary["world"], summary["world_hash"]) == ("room", world.hash)
    assert summary["seed"] == 7
    assert summary["state_hash"] == f"{90:08x}"
    assert summary["renderer"] == "moderngl (hand-made)"
    assert summary["sim_time_s"] == pytest.approx(3.0, abs=1e-3)
    assert summary["wall_time_s"] > 0.0
    assert summary["real_time_factor"] == pytest.approx(
        (summary["sim_time_s"] - 1 / 30) / summary["wall_time_s"], rel=0.05
    )
    (goal,) = summary["goals"]
    assert (goal["reached"], goal["error_code"]) == (False, 105)
    assert summary["contacts"]["count"] == 1
    assert summary["contacts"]["list"][0]["body"] == "Wall_0"
    assert summary["markers_seen"] == {"60": 30}
    assert summary["localisation_error_m"]["max"] == pytest.approx(ERROR_M)
    assert set(summary["marker_error_m"]) == {"mean", "p95", "max"}
    assert summary["odometry_drift_m"] == pytest.approx(0.0, abs=1e-9)
    assert summary["messages"]["/odom"]["received"] == 90
    scan = summary["messages"]["/scan"]
    assert (scan["sent"], scan["received"], scan["lost"]) == (30, 30, 0)
    assert scan["rejected_by"] == {"navigation: not finite": 2}
    assert set(summary["versions"]) == {
        "mazebot", "python", "numpy", "pybullet", "eclipse-zenoh", "rerun-sdk", "opencv",
    }  # fmt: skip


def test_the_verdict_comes_each_second_and_at_once_when_a_goal_ends(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(opening(world))
    bench.say(driving(world, 2.5))
    verdicts = [message for topic, message in bench.put if topic is table.EVALUATION]
    assert len(verdicts) == 4  # at 0, 1 and 2 s, and at the goal's end
    bench.node.close()
    last = verdicts[-1]
    assert isinstance(last, doc.Evaluation)
    assert [goal.error_code for goal in last.goals] == [105]
    assert last.recording == str(next(tmp_path.iterdir()))


def test_parameters_that_are_told_before_a_run_count_in_each(tmp_path: Path) -> None:
    bench = Bench(recorder(tmp_path, record=False))
    values: dict[str, Any] = {"general_goal_checker": {"position_only": True}}
    told = doc.Parameters(service="navigation", values={"controller_server": values})
    bench.say([(0, table.PARAMETERS, told)])
    for start_s, world in ((0, room()), (10, room("other", 2.0))):
        begin_ns = start_s * 1_000_000_000
        bench.say([(begin_ns, topic, message) for _, topic, message in opening(world)])
        bench.say(driving(world, 2.0, begin_ns))
        there = true_pose(begin_ns + 1_000_000_000)
        turned = doc.Planar(x_m=there.x_m, y_m=there.y_m, yaw_rad=there.yaw_rad + 2.0)
        reached = doc.NavigationResult(
            goal=turned, goal_stamp_ns=5, error_code=0,
            start_time_s=start_s + 0.5, end_time_s=start_s + 1.0,
        )  # fmt: skip
        bench.say([(begin_ns + 2_000_000_000, table.NAVIGATION_RESULT, reached)])
    bench.node.close()
    for run in tmp_path.iterdir():
        assert [goal["reached"] for goal in summary_of(run)["goals"]] == [False, True]


def test_without_a_recording_rerun_is_not_even_loaded(tmp_path: Path) -> None:
    script = (
        "import sys\n"
        "from pathlib import Path\n"
        "from mazebot.recorder.config import RecorderConfig\n"
        "from mazebot.recorder.node import RecorderNode\n"
        "from tests.recorder.synthetic import Bench, driving, opening, room\n"
        f"config = RecorderConfig(record=False, recordings_dir=Path({str(tmp_path)!r}))\n"
        "node = RecorderNode(config)\n"
        "bench, world = Bench(node), room()\n"
        "bench.say(opening(world)); bench.say(driving(world, 0.5)); node.close()\n"
        "assert 'rerun' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, cwd=ROOT)
    (run,) = tmp_path.iterdir()
    assert {path.name for path in run.iterdir()} == {"summary.json", "series.json", "config.yaml"}
    assert summary_of(run)["messages"]["/clock"]["received"] == 15


def test_a_simulation_that_begins_anew_gets_a_folder_of_its_own(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    bench.say(driving(world, 3.0))
    bench.say(driving(world, 1.0))  # nobody says world, map or markers again
    bench.node.close()
    first, second = sorted(tmp_path.iterdir())
    assert second.name == f"{first.name}_2"
    assert summary_of(first)["sim_time_s"] == pytest.approx(3.0, abs=1e-3)
    assert summary_of(second)["sim_time_s"] == pytest.approx(1.0, abs=1e-3)
    assert summary_of(second)["markers_seen"] == {"60": 10}
    verify(first / "run.rrd")
    drawn = entities_of(second / "run.rrd")
    for entity in ("world/walls/bricks", "map", "entities/marker_60", "tf_static/base_scan"):
        assert f"/{entity}: " in drawn, entity


def test_the_next_run_is_recorded_while_the_last_one_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    may_end = threading.Event()

    def leave_report(folder: Path) -> None:
        assert may_end.wait(60.0)
        write_report(folder)

    monkeypatch.setattr(run_module, "leave_report", leave_report)
    world = room()
    bench = Bench(recorder(tmp_path))
    for _ in range(3):
        bench.say(opening(world))
        bench.say(driving(world, 2.0))
    first, second, third = sorted(tmp_path.iterdir())
    assert summary_of(first)["sim_time_s"] == pytest.approx(2.0, abs=1e-3)
    assert not (first / "report.html").exists()
    assert is_recording(second)
    assert is_recording(third)
    may_end.set()
    bench.node.close()
    for run in (first, second, third):
        assert not is_recording(run)
        assert (run / "report.html").is_file()
        verify(run / "run.rrd")


def test_a_new_world_gets_a_folder_and_the_same_one_again_does_not(tmp_path: Path) -> None:
    first, second = room(), room("second", height_m=1.0)
    bench = Bench(recorder(tmp_path))
    bench.say(opening(first))
    bench.say([(0, table.WORLD, first)])
    assert bench.node.world_hash == first.hash
    bench.say(opening(second))
    assert bench.node.world_hash == second.hash
    bench.node.close()
    names = [run.name for run in sorted(tmp_path.iterdir())]
    assert names == ["2026-11-21_12-00-00_room", "2026-11-21_12-00-00_second"]
    assert "world/walls_above" not in entities_of(tmp_path / names[1] / "run.rrd")


def test_a_message_from_an_earlier_world_is_counted_and_not_judged(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(opening(world))
    bench.world_hash = "another"
    bench.say(driving(world, 1.0))
    bench.node.close()
    summary = summary_of(next(tmp_path.iterdir()))
    assert summary["goals"] == []
    assert summary["messages"]["/odom"]["rejected_by"] == {"recorder: other world": 30}


def test_what_is_said_before_there_is_a_world_is_kept(tmp_path: Path) -> None:
    bench = Bench(recorder(tmp_path))
    line = msg.Log(msg.time_from_ns(0), 20, "worldgen", "loading", "a.py", "f", 3)
    bench.say([(0, table.ROSOUT, line)])
    assert bench.node.waiting_for() == "a world"
    assert list(tmp_path.iterdir()) == []
    bench.say(opening(room()))
    assert bench.node.waiting_for() is None
    bench.node.close()
    (run,) = tmp_path.iterdir()
    assert "/rosout/worldgen: " in entities_of(run / "run.rrd")


def test_two_recorders_never_write_into_one_folder(tmp_path: Path) -> None:
    world = room()
    benches = [Bench(recorder(tmp_path, record=False)) for _ in range(3)]
    for bench in benches:
        bench.say(opening(world))
    for seconds, bench in enumerate(benches, start=1):
        bench.say(driving(world, float(seconds)))
        bench.node.close()
    times_s = [summary_of(run)["sim_time_s"] for run in sorted(tmp_path.iterdir())]
    assert times_s == pytest.approx([1.0, 2.0, 3.0], abs=1e-3)


def test_a_folder_that_cannot_be_written_is_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(
        ConfigError, match=r"^recordings folder not writable: .*file/runs: "
    ) as told:
        recorder(tmp_path / "file" / "runs")
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("name", ["summary.json", "run.rrd"])
def test_an_out_dir_that_holds_a_run_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("")
    with pytest.raises(ConfigError, match=f"out_dir: .* already contains a run \\({name}\\)"):
        recorder(tmp_path, out_dir=tmp_path)


def test_an_out_dir_is_the_run_s_folder(tmp_path: Path) -> None:
    bench = Bench(recorder(tmp_path / "unused", out_dir=tmp_path / "a" / "b", record=False))
    bench.say(opening(room()))
    bench.node.close()
    assert summary_of(tmp_path / "a" / "b")["world"] == "room"


def test_the_recording_ends_whole_before_the_disk_is_full_and_goes_on_with_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = [10_000]
    monkeypatch.setattr(run_module.Run, "_free_mib", lambda _: free[0])
    monkeypatch.setattr(run_module, "FLUSH_PERIOD_S", 0.0)
    monkeypatch.setattr(run_module, "SPACE_PERIOD_S", 0.0)
    world = room()
    node = recorder(tmp_path)
    bench = Bench(node)
    bench.say(opening(world))
    bench.say(driving(world, 1.0))
    (run,) = tmp_path.iterdir()
    free[0] = 3
    bench.say(driving(world, 1.0, start_ns=1_000_000_000))
    verify(run / "run.rrd")
    waiting = bench.node.waiting_for()
    assert waiting is not None
    assert waiting.endswith("less than 64 MiB are free")
    assert node.unrecorded == "stopped at 1.0 s: less than 64 MiB are free"
    free[0] = 10_000
    bench.say(driving(world, 1.0, start_ns=2_000_000_000))
    assert bench.node.waiting_for() is None
    assert "/world/walls/bricks: " in entities_of(run / "run_2.rrd")
    bench.node.close()
    assert node.unrecorded is None
    assert [path.name for path in run.glob("*.rrd")] == ["run.rrd"]
    verify(run / "run.rrd")
    assert summary_of(run)["sim_time_s"] == pytest.approx(3.0, abs=1e-3)


@pytest.mark.parametrize("is_large", [True, False])
def test_a_long_recording_goes_on_in_the_next_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_large: bool
) -> None:
    monkeypatch.setattr(run_module, "FLUSH_PERIOD_S", 0.0)
    monkeypatch.setattr(drawing_module, "MOST_CHUNKS", 100)
    monkeypatch.setattr(drawing_module, "MOST_JOINED_BYTES", 0 if is_large else 10**9)
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    bench.say(driving(world, 3.0))
    (run,) = tmp_path.iterdir()
    assert len(list(run.glob("*.rrd"))) > 1
    bench.node.close()
    parts = sorted(run.glob("*.rrd"))
    assert (len(parts) > 1) == is_large
    for part in parts:
        verify(part)
        assert "/world/walls/bricks: " in entities_of(part)
    # It is whole, and nothing is left for a repair.
    assert not (run / ".recording").exists()
    assert summary_of(run)["sim_time_s"] == pytest.approx(3.0, abs=1e-3)
    monkeypatch.undo()
    bench = Bench(recorder(tmp_path / "one"))
    bench.say(opening(world))
    bench.say(driving(world, 3.0))
    bench.node.close()
    (one,) = (tmp_path / "one").glob("*/*.rrd")
    for entity in ("/ground_truth/odom", "/scan"):
        expected = times_of([one], entity)
        assert expected
        assert set(expected) <= set(times_of(parts, entity)), entity
    assert len(times_of([one], "/ground_truth/odom")) > 20


def test_a_disk_that_is_full_loses_nothing_but_what_it_had_no_room_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(run_module, "FLUSH_PERIOD_S", 0.0)
    monkeypatch.setattr(run_module, "SPACE_PERIOD_S", 0.0)
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    bench.say(driving(world, 0.5))
    (run,) = tmp_path.iterdir()
    room_bytes = (run / "run.rrd").stat().st_size + 1000
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    # As a full disk is to whoever writes: the first byte beyond is refused.
    resource.setrlimit(resource.RLIMIT_FSIZE, (room_bytes, before[1]))
    try:
        bench.say(driving(world, 1.0, start_ns=500_000_000))
        assert "run.rrd: File too large" in caplog.text
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    bench.say(driving(world, 1.0, start_ns=1_500_000_000))
    assert bench.node.waiting_for() is None
    bench.node.close()
    assert {path.name for path in run.iterdir()} == {
        "run.rrd", "run.mcap", "summary.json", "series.json", "config.yaml", "digests.bin",
        "report.html", "thumbnail.png",
    }  # fmt: skip
    verify(run / "run.rrd")
    assert "/scan: " in entities_of(run / "run.rrd")


def test_digests_that_the_disk_does_not_take_are_written_when_it_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "digests.bin"
    writer = DigestWriter(path)
    writer.flush()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 30, before[1]))
    try:
        for number in range(10):
            clock = msg.Clock(msg.time_from_ns(number))
            data = wire.encode(table.CLOCK, clock)
            writer.add(table.CLOCK, (data,), Envelope("physics", number, number, ""))
        with pytest.raises(OSError, match="File too large"):
            writer.flush()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert writer.waits
    writer.close()
    assert read_digests(path).rows["sequence"].tolist() == list(range(10))


def test_a_folder_that_is_removed_is_told_of_and_the_run_goes_on_in_a_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(run_module, "SPACE_PERIOD_S", 0.0)
    monkeypatch.setattr(run_module, "FLUSH_PERIOD_S", 0.0)
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    bench.say(driving(world, 1.0))
    (run,) = tmp_path.iterdir()
    shutil.rmtree(run)
    bench.say(driving(world, 1.0, start_ns=1_000_000_000))
    assert bench.node.waiting_for() is None
    bench.node.close()
    assert f"{run} was removed" in caplog.text
    assert "MiB are free" not in caplog.text
    (run,) = tmp_path.iterdir()
    assert {path.name for path in run.iterdir()} == {
        "run.rrd", "run.mcap", "summary.json", "series.json", "config.yaml", "digests.bin",
        "report.html", "thumbnail.png",
    }  # fmt: skip
    verify(run / "run.rrd")
    assert "/world/walls/bricks: " in entities_of(run / "run.rrd")
    assert len(summary_of(run)["goals"]) == 2


def test_the_summary_is_there_while_the_run_lasts(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(opening(world))
    (run,) = tmp_path.iterdir()
    # Also where it is killed in its first seconds.
    assert summary_of(run)["messages"]["/scan"]["received"] == 0
    clock = bench.node._setting.wall_clock_s  # type: ignore[attr-defined]
    clock.now_s += 6.0
    bench.say(driving(world, 1.0))
    assert summary_of(run)["messages"]["/clock"]["received"] > 0
    bench.node.close()


def stats(world: doc.World, time_s: float, **fields: Any) -> doc.SimulationStats:
    values = {"iterations": 1, "step_size_s": 1 / 240, "renderer": "none", "state_hash": ""}
    return doc.SimulationStats(
        **{"world_hash": world.hash, "sim_time_s": time_s, "epoch": 1, **values, **fields}
    )


def test_a_reset_in_the_first_second_begins_a_run_and_each_gets_its_own(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(opening(world))
    bench.say([(0, table.SIMULATION_STATS, stats(world, 0.0)), *driving(world, 0.8)])
    last_ns = 800_000_000
    bench.say([(last_ns, table.SIMULATION_STATS, stats(world, 0.8))])
    # One step brings the last of the old run and the first of the new one.
    late = [said for said in driving(world, 0.1, last_ns) if said[1] is table.ODOM]
    anew = [(0, table.SIMULATION_STATS, stats(world, 0.0, epoch=2, seed=11))]
    for now_ns, topic, message in [*late, *anew, *driving(world, 0.2)]:
        bench.inbox.deliver(topic, message, Envelope("test", 0, now_ns, world.hash))
    bench.step(200_000_000)
    bench.node.close()
    runs = sorted(tmp_path.iterdir())
    told = [yaml.safe_load((run / "config.yaml").read_text())["seed"] for run in runs]
    assert told == [0, 11]
    first, second = map(summary_of, runs)
    assert (first["epoch"], first["seed"]) == (1, 0)
    assert (second["epoch"], second["seed"]) == (2, 11)
    assert first["rebuilds"] == second["rebuilds"] == 0
    assert first["sim_time_s"] == pytest.approx(0.8, abs=0.02)
    assert second["sim_time_s"] == pytest.approx(0.2)
    assert second["odometry_drift_m"] == pytest.approx(0.0, abs=1e-9)


def test_a_world_built_anew_while_time_goes_on_is_the_same_run(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(opening(world))
    for time_s, epoch in ((0.0, 1), (1.0, 1), (2.0, 2), (3.0, 2), (4.0, 3)):
        now_ns = round(time_s * 1e9)
        bench.say([(now_ns, table.SIMULATION_STATS, stats(world, time_s, epoch=epoch))])
    bench.node.close()
    (run,) = tmp_path.iterdir()
    assert (summary_of(run)["epoch"], summary_of(run)["rebuilds"]) == (3, 2)


def test_a_pause_is_no_slowness(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(opening(world))
    bench.say(driving(world, 2.0))
    clock = bench.node._setting.wall_clock_s  # type: ignore[attr-defined]
    now_ns = 2_000_000_000
    bench.say([(now_ns, table.SIMULATION_STATS, stats(world, 2.0, paused=True))])
    clock.now_s += 1000.0
    bench.say([(now_ns, table.SIMULATION_STATS, stats(world, 2.0, paused=False))])
    bench.say(driving(world, 2.0, now_ns))
    bench.say([(2 * now_ns, table.SIMULATION_STATS, stats(world, 4.0, paused=True))])
    clock.now_s += 500.0
    bench.node.close()
    (run,) = tmp_path.iterdir()
    summary = summary_of(run)
    assert summary["pauses"]["count"] == 2
    assert summary["pauses"]["wall_time_s"] == pytest.approx(1000.0, abs=1.0)
    assert summary["wall_time_s"] < 10.0
    assert summary["real_time_factor"] > 0.5


def test_a_recorder_that_joins_late_counts_from_what_the_clock_itself_tells(
    tmp_path: Path,
) -> None:
    world, minute_ns = room(), 60_000_000_000
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(opening(world))
    # The loop that steps the recorder has not heard the clock yet, the recorder's inbox has.
    tick = msg.Clock(msg.time_from_ns(minute_ns))
    bench.inbox.deliver(table.CLOCK, tick, Envelope("test", 0, minute_ns, world.hash))
    bench.step(0)
    clock = bench.node._setting.wall_clock_s  # type: ignore[attr-defined]
    clock.tick_s = 0.0
    clock.now_s += 0.1
    bench.say(said for said in driving(world, 0.1, minute_ns) if said[0] > minute_ns + 50_000_000)
    bench.node.close()
    (run,) = tmp_path.iterdir()
    summary = summary_of(run)
    assert summary["sim_time_s"] == pytest.approx(60.1)
    assert summary["wall_time_s"] == pytest.approx(0.1, abs=0.01)
    assert summary["real_time_factor"] == pytest.approx(1.0, abs=0.1)


def test_a_pause_is_noticed_while_no_time_passes(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say([*opening(world), *driving(world, 1.0)])
    paused = stats(world, 1.0, paused=True)
    envelope = Envelope("physics", 0, 1_000_000_000, world.hash)
    bench.inbox.deliver(table.SIMULATION_STATS, paused, envelope)
    assert bench.inbox.wakes()
    bench.node.close()


def test_what_was_not_measured_is_null_in_the_summary(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(opening(world))
    elsewhere = msg.KeyValue("rejected /elsewhere: not finite", "2")
    status = msg.DiagnosticStatus(0, "navigation", "active", "", [elsewhere])
    array = msg.DiagnosticArray(msg.header(0, ""), [status])
    bench.say([(0, table.DIAGNOSTICS, array)])
    bench.node.close()
    summary = summary_of(next(tmp_path.iterdir()))
    nothing = {"mean": None, "p95": None, "max": None}
    for name in (
        "epoch", "state_hash", "image_hash", "renderer", "sim_time_s", "wall_time_s",
        "real_time_factor", "odometry_drift_m", "distance_m", "spl",
    ):  # fmt: skip
        assert summary[name] is None, name
    for name in ("localisation_error_m", "localisation_error_rad", "marker_error_m"):
        assert summary[name] == nothing, name
    unread = summary["messages"]["/elsewhere"]
    assert (unread["sent"], unread["received"], unread["lost"]) == (None, None, None)
    assert unread["rejected"] == 2


def test_textures_of_nothing_are_let_go_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_module, "_MOST_ASSETS", 300)
    world = room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(opening(world))
    for number in range(1000):
        picture = np.full(8, number % 256, np.uint8)
        asset = msg.CompressedImage(msg.header(0, f"{number:064x}"), "png", picture)
        bench.say([(0, table.ASSETS, asset)])
    held = bench.node._setting.assets  # type: ignore[attr-defined]
    bench.node.close()
    assert len(held) <= 300
    assert {BRICKS, MARKER} <= held.keys()
    assert f"{999:064x}" in held


def test_rings_and_floods_of_frames_are_refused_and_the_recording_is_whole(tmp_path: Path) -> None:
    def frames(*edges: tuple[str, str]) -> msg.TFMessage:
        return msg.TFMessage([msg.transform_stamped(0, *edge, np.eye(4)) for edge in edges])

    bench = Bench(recorder(tmp_path))
    bench.say(opening(room()))
    bench.say([(0, table.TF_STATIC, frames(("base_scan", "base_footprint")))])
    bench.say([(0, table.TF, frames(("base_scan", "map")))])
    for first in range(0, 5000, 500):
        flood = frames(*(("map", f"frame {number}") for number in range(first, first + 500)))
        bench.say([(0, table.TF, flood)])
    bench.say(driving(room(), 1.0))
    assert bench.inbox.counts[table.TF_STATIC.name].rejected == {"loop in the frame tree": 1}
    assert bench.inbox.counts[table.TF.name].rejected["too many frames"] >= 6
    bench.node.close()
    (run,) = tmp_path.iterdir()
    verify(run / "run.rrd")
    summary = summary_of(run)
    assert summary["localisation_error_m"]["mean"] == pytest.approx(ERROR_M, abs=1e-6)

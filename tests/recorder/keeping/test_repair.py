"""A recorder that is killed leaves what it had, and the next one makes it whole."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader

from mazebot.common.files.root import ROOT
from mazebot.common.messages import documents as doc
from mazebot.common.messages import topics as table
from mazebot.common.messages.topics import Delivery
from mazebot.common.recordings.catalog import list_recordings
from mazebot.common.recordings.comparing.digests import read_digests
from mazebot.common.recordings.mcap.mcap_counts import count_messages
from mazebot.common.recordings.mcap.mcap_messages import read_messages
from mazebot.common.recordings.run_folder import LOCK, MESSAGES, TO_COMPRESS, RunFolder, parts_of
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.keeping import repair as repair_module
from mazebot.recorder.keeping.progress import read_progress
from mazebot.recorder.keeping.repair import Repair, leftovers
from mazebot.recorder.node import RecorderNode
from mazebot.recorder.transcoding import background
from tests.recorder.synthetic import Bench, Said, driving, opening, room
from tests.recorder.test_node import entities_of, recorder, stats, summary_of, verify

KILLED = """
import os, signal, sys, time
from pathlib import Path
from mazebot.common.messages import documents as doc
from mazebot.common.messages import topics as table
from mazebot.recorder.config import RecorderConfig
from mazebot.common.recordings.comparing.digests import read_digests
from mazebot.recorder.node import RecorderNode
from tests.recorder.synthetic import Bench, driving, opening, room
node = RecorderNode(RecorderConfig(recordings_dir=Path(sys.argv[1])))
bench, world = Bench(node), room()
bench.say(opening(world))
bench.say(driving(world, 2.0))
time.sleep(0.1)
bench.node._run._flush()
bench.node._run._drawing._canvas.recording.finish()
print("driving", flush=True)
signal.pause()
"""


def until(condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def test_a_killed_recording_is_made_whole_by_the_next_recorder(tmp_path: Path) -> None:
    # Killed on the way to a goal: the summary of that moment is the last one.
    script = KILLED.replace("driving(world, 2.0))", "list(driving(world, 2.0))[:-1])").replace(
        "time.sleep(0.1)", "bench.node._run._summarised_s -= 1.0; bench.step(2_000_000_000)"
    )
    command = [sys.executable, "-c", script, str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"driving\n"
        assert leftovers(tmp_path) == []  # its recorder lives
        process.send_signal(signal.SIGKILL)
    (run,) = tmp_path.iterdir()
    with pytest.raises(AssertionError, match="footer"):
        verify(run / "run.rrd")
    assert leftovers(tmp_path) == [run]
    node = recorder(tmp_path, record=False)
    Bench(node).say(opening(room("another")))
    node.close()
    Repair(tmp_path).repair_all()
    assert leftovers(tmp_path) == []
    (listed,) = (one for one in list_recordings(tmp_path) if one.path == run)
    assert (listed.state, listed.failed) == ("interrupted", True)
    assert (listed.goals_reached, listed.goals_total) == (0, 1)
    assert listed.sim_time_s == pytest.approx(2.0, abs=0.05)
    verify(run / "run.rrd")
    drawn = entities_of(run / "run.rrd")
    assert "/camera/color/image_raw: " in drawn
    assert "/ground_truth/odom: " in drawn
    assert {path.name for path in run.iterdir()} == {
        "run.rrd", "run.mcap", "config.yaml", "summary.json", "digests.bin",
        "report.html", "series.json", "thumbnail.png",
    }  # fmt: skip


@pytest.mark.slow
def test_the_summary_of_a_killed_run_says_what_its_files_hold(tmp_path: Path) -> None:
    run = killed_run(tmp_path, "pass")
    counted = {"sent": 9, "received": 7, "lost": 2, "recorded": 7, "rejected": 0}
    nowhere = {"sent": None, "received": None, "lost": None, "recorded": None, "rejected": 0}
    stale = {"world": "room", "messages": {"/clock": counted, "/cmd_vel_teleop": nowhere}}
    (run / "summary.json").write_text(json.dumps(stale))
    Repair(tmp_path).repair_all()
    text = (run / "summary.json").read_text()
    clocks = len(list(read_messages(parts_of(run, MESSAGES), {"/clock"})))
    assert clocks > 9
    assert json.loads(text) == stale | {
        "sim_time_s": pytest.approx(2.0, abs=0.05),
        "messages": {
            "/clock": counted | {"recorded": clocks, "received": clocks, "sent": clocks + 2},
            "/cmd_vel_teleop": nowhere,
        },
    }
    with (run / "run.mcap").open("rb") as file:
        attached = {one.name: one.data for one in make_reader(file).iter_attachments()}
    assert attached["summary.json"] == text.encode()


def sent_again(world: doc.World, *drives: tuple[float, int]) -> list[Said]:
    """Of those drives, what a recorder that starts later is sent again."""
    said = [one for seconds, start_ns in drives for one in driving(world, seconds, start_ns)]
    return [one for one in said if one[1].delivery is Delivery.EVERY]


def killed_run(folder: Path, goes_on: str) -> Path:
    """The folder of a run of 2 s whose recorder was killed after it had done what is told."""
    script = KILLED.replace('print("driving"', f'{goes_on}\nprint("driving"')
    command = [sys.executable, "-c", script, str(folder)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"driving\n"
        process.send_signal(signal.SIGKILL)
    (run,) = folder.iterdir()
    return run


@pytest.mark.parametrize(
    ("end", "kept_goals"),
    [("pass", 2), ("run.keep_progress(); run.keep_progress = lambda: None", 1)],
    ids=["kept", "died with"],
)
def test_a_recorder_that_comes_back_goes_on_with_the_run(
    tmp_path: Path, end: str, kept_goals: int
) -> None:
    # Progress is kept as soon as a goal has ended, if the recorder lives so long.
    goes_on = (
        "said = list(driving(world, 1.0, 2_000_000_000)); bench.say(said[:-1]);"
        f"run = bench.node._run; run._flush(); {end}; bench.say(said[-1:])"
    )
    run = killed_run(tmp_path, goes_on)
    progress = read_progress(run)
    assert progress is not None
    assert len(progress.verdict["goals"]) == kept_goals
    digests = read_digests(run / "digests.bin").rows
    world = room()
    node = recorder(tmp_path)
    assert node.hears_from_s == pytest.approx(time.time() - 10.0, abs=5.0)
    bench = Bench(node)
    bench.say(sent_again(world, (2.0, 0), (1.0, 2_000_000_000)))
    bench.say([(3_000_000_000, topic, message) for _, topic, message in opening(world)])
    assert bench.node.waiting_for() == "a world"  # the simulation has not told how it is
    bench.say(driving(world, 2.0, 3_000_000_000))
    verdicts = [message for topic, message in bench.put if topic is table.EVALUATION]
    bench.node.close()
    assert [path for path in tmp_path.iterdir() if path.is_dir()] == [run]
    assert {path.name for path in run.iterdir()} == {
        "run.rrd", "run.mcap", "config.yaml", "summary.json", "series.json", "digests.bin",
        "report.html", "thumbnail.png",
    }  # fmt: skip
    verify(run / "run.rrd")
    assert isinstance(verdicts[-1], doc.Evaluation)
    assert [goal.goal_stamp_ns for goal in verdicts[-1].goals] == [0, 2 * 10**9, 3 * 10**9]
    assert [goal.path_length_m for goal in verdicts[-1].goals] == pytest.approx(
        [0.4, 0.2, 0.4], abs=0.02
    )
    summary = summary_of(run)
    assert summary["goals_sent"] == 3
    assert summary["ended"]
    assert summary["sim_time_s"] == pytest.approx(5.0, abs=0.01)
    # The simulation tells how it is once a second: what came before is of no known run.
    assert summary["markers_seen"]["60"] >= 39
    # Those of the second in which it was not known whether the run goes on, the folder lacks, and
    # what was not written yet when the recorder died: it tells of both.
    written = count_messages([run / "run.mcap"])
    scans, results = (summary["messages"][name] for name in ("/scan", "/navigation/result"))
    assert (scans["received"], scans["recorded"]) == (50, written["/scan"])
    assert written["/scan"] <= 40
    # One that was written and is sent again may stand in it twice.
    assert results["recorded"] == written["/navigation/result"]
    assert results["received"] == max(3, written["/navigation/result"])
    whole = read_digests(run / "digests.bin").rows
    assert (whole[: len(digests)] == digests).all()
    assert len(whole) > len(digests) + 200


@pytest.mark.parametrize("fields", [{"sim_time_s": 0.5}, {"epoch": 2}])
def test_another_simulation_of_the_same_world_is_another_run(
    tmp_path: Path, fields: dict[str, float]
) -> None:
    world = room()
    first = Bench(recorder(tmp_path, record=False))
    first.say(opening(world))
    first.say(driving(world, 2.0))
    assert isinstance(first.node, RecorderNode)
    assert first.node._run is not None
    first.node._run.folder.let_go()  # as if it had been killed
    second = Bench(recorder(tmp_path, record=False))
    second.say(opening(world))
    told = stats(world, **{"time_s": 2.5, **{k.replace("sim_", ""): v for k, v in fields.items()}})
    second.say([(0, table.SIMULATION_STATS, told)])
    assert second.node.waiting_for() is None
    second.node.close()
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.slow
def test_what_is_sent_again_of_a_simulation_that_has_ended_is_not_judged(tmp_path: Path) -> None:
    killed_run(tmp_path, "")
    world = room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(sent_again(world, (2.0, 0)))
    bench.say(opening(world))
    bench.say([(0, table.SIMULATION_STATS, stats(world, time_s=0.5))])
    assert bench.node.waiting_for() is None
    assert bench.node.hears_from_s is None
    bench.say(driving(world, 1.0, 500_000_000))
    verdicts = [message for topic, message in bench.put if topic is table.EVALUATION]
    bench.node.close()
    assert isinstance(verdicts[-1], doc.Evaluation)
    assert [goal.goal_stamp_ns for goal in verdicts[-1].goals] == [500_000_000]


@pytest.mark.slow
def test_a_run_that_nobody_resumes_is_repaired_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The stack may be ended before the next look.
    monkeypatch.setattr(repair_module, "LOOK_PERIOD_S", 1000.0)
    run = killed_run(tmp_path, "")
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    assert (run / LOCK).exists()
    bench.say([(0, table.SIMULATION_STATS, stats(world, time_s=0.5))])
    end_s = time.monotonic() + 60.0
    while (run / LOCK).exists():
        assert time.monotonic() < end_s, "it is not repaired"
        time.sleep(0.02)
    bench.node.close()
    verify(run / "run.rrd")
    with (run / "run.mcap").open("rb") as file:
        assert list(make_reader(file).iter_messages())


def test_sigterm_ends_a_recording_whole(tmp_path: Path) -> None:
    script = KILLED.replace(
        "signal.pause()",
        # A signal that comes before it is waited for must count as well.
        "import threading; told = threading.Event()\n"
        "signal.signal(signal.SIGTERM, lambda *_: told.set()); print('ready', flush=True)\n"
        "while not told.wait(0.05): pass\n"
        "node.close()",
    )
    command = [sys.executable, "-c", script, str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"driving\n"
        assert process.stdout.readline() == b"ready\n"
        process.terminate()
        start_s = time.monotonic()
        assert process.wait(10.0) == 0
    assert time.monotonic() - start_s < 5.0
    (run,) = tmp_path.iterdir()
    verify(run / "run.rrd")
    assert not (run / LOCK).exists()


def test_what_cannot_be_read_is_left_as_it_is(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "broken"
    folder.mkdir()
    (folder / LOCK).touch()
    (folder / "run.rrd").write_bytes(b"nothing of Rerun's" * 100)
    Repair(tmp_path).repair_all()
    assert (folder / "run.rrd").read_bytes().startswith(b"nothing of Rerun's")
    assert "failed to repair" in caplog.text
    assert leftovers(tmp_path) == []  # nobody tries again


def test_a_folder_is_locked_until_its_run_is_whole(tmp_path: Path) -> None:
    folder = RunFolder.exactly(tmp_path / "run")
    assert leftovers(tmp_path) == []
    other = RunFolder.exactly(tmp_path / "run")
    assert other.path.name == "run_2"
    folder.release()
    other.release()
    assert list(tmp_path.glob(f"*/{LOCK}")) == []


def test_repair_can_be_told_to_leave_the_folder_alone(tmp_path: Path) -> None:
    folder = tmp_path / "left"
    folder.mkdir()
    (folder / LOCK).touch()
    node = RecorderNode(RecorderConfig(recordings_dir=tmp_path, repair=False))
    node.close()
    assert leftovers(tmp_path) == [folder]


def test_while_there_is_no_run_those_that_wait_get_their_video(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(repair_module, "LOOK_PERIOD_S", 0.05)
    monkeypatch.setattr(repair_module, "_COMPRESS_LOOK_S", 0.05)
    run = tmp_path / "run"
    run.mkdir()
    (run / TO_COMPRESS).touch()
    started: list[Path] = []
    ended = threading.Event()
    looks: list[bool] = []

    def start(folder: Path) -> subprocess.Popen[bytes]:
        started.append(folder)
        return subprocess.Popen(["sleep", "60"], start_new_session=True)

    def end(process: subprocess.Popen[bytes]) -> None:
        background.end(process)
        ended.set()

    def may_compress() -> bool:
        looks.append(bool(started))
        # A run begins while a video is made.
        return not started

    monkeypatch.setattr(repair_module, "start", start)
    monkeypatch.setattr(repair_module, "end", end)
    repair = Repair(tmp_path, may_compress=may_compress)
    repair.start()
    assert ended.wait(20.0)
    repair.stop()
    assert started == [run]
    # Not at the first look: everything may be about to start.
    assert looks[:2] == [False, False]

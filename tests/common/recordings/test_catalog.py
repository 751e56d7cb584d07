"""The list of runs."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import pytest

from mazebot.common.config import ConfigError
from mazebot.common.recordings import catalog
from mazebot.common.recordings.catalog import Catalog, find_run, list_recordings
from mazebot.common.recordings.figures import figures_of
from mazebot.common.recordings.retention import Kept, to_delete
from mazebot.common.recordings.run_folder import LOCK, SUMMARY, RunFolder, write_atomically


def test_a_file_that_finds_no_room_leaves_the_old_one_and_nothing_else(tmp_path: Path) -> None:
    def pieces() -> Iterator[bytes]:
        yield b"new"
        raise OSError(errno.ENOSPC, "No space left on device")

    file = tmp_path / SUMMARY
    file.write_bytes(b"old")
    with pytest.raises(OSError, match="No space left"):
        write_atomically(file, pieces())
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [(SUMMARY, b"old")]


def make(folder: Path, name: str, summary: object = None, recording: bytes = b"") -> Path:
    path = folder / name
    path.mkdir()
    if summary is not None:
        text = summary if isinstance(summary, str) else json.dumps(summary)
        (path / "summary.json").write_text(text)
    if recording:
        (path / "run.rrd").write_bytes(recording)
    return path


def test_runs_are_listed_newest_first_with_what_they_reached(tmp_path: Path) -> None:
    goals = [{"reached": True}, {"reached": False}, {"reached": True}]
    make(tmp_path, "2026-11-20_10-00-00_house", {"world": "house", "goals": []}, b"1234")
    summary = {"world": "sim_house", "goals": goals, "sim_time_s": 80.5}
    newest = make(tmp_path, "2026-11-21_14-03-07_sim_house_2", summary)
    runs = list_recordings(tmp_path)
    assert [run.world for run in runs] == ["sim_house", "house"]
    first, second = runs
    assert (first.goals_reached, first.goals_total, first.sim_time_s) == (2, 3, 80.5)
    assert first.started == datetime(2026, 11, 21, 14, 3, 7)  # noqa: DTZ001 - local
    assert first.path == newest
    assert first.recording is None
    assert second.recording == tmp_path / "2026-11-20_10-00-00_house" / "run.rrd"
    assert second.size_bytes == 4 + (second.path / "summary.json").stat().st_size
    assert second.closed


def test_a_goal_that_the_explorer_gave_up_does_not_count(tmp_path: Path) -> None:
    goals = [{"reached": True, "time_s": 2.0}, {"reached": False, "given_up": True, "time_s": 1.0}]
    make(tmp_path, "run", {"goals": goals, "mapping": {"exploration": "complete"}})
    (run,) = list_recordings(tmp_path)
    assert (run.goals_reached, run.goals_total, run.failed) == (1, 1, False)
    figures = figures_of({"goals": goals})
    assert (figures["goals_missed"], figures["goal_time_s"]) == (0.0, 2.0)


def test_a_damaged_or_unfinished_run_is_listed_as_far_as_it_goes(tmp_path: Path) -> None:
    make(tmp_path, "2026-11-21_14-03-07_enhanced", "{ no json", b"x")
    (make(tmp_path, "mine", ["a list"]) / LOCK).touch()
    make(tmp_path, "without", recording=b"x")
    make(tmp_path, "no run at all")
    (tmp_path / "a file").touch()
    runs = {run.name: run for run in list_recordings(tmp_path)}
    assert set(runs) == {"2026-11-21_14-03-07_enhanced", "mine", "without"}
    assert (runs["without"].failed, runs["without"].problem) == (True, "summary.json: missing")
    assert runs["2026-11-21_14-03-07_enhanced"].world == "enhanced"
    assert not runs["mine"].closed
    assert runs["mine"].started is not None


def test_no_folder_holds_no_runs(tmp_path: Path) -> None:
    assert list_recordings(tmp_path / "none") == []


def test_what_a_summary_says_of_a_run_is_listed(tmp_path: Path) -> None:
    summary = {
        "world": "house", "seed": 3, "goals": [{"reached": True}], "contacts": {"count": 2},
        "localisation_error_m": {"mean": 0.5, "p95": 1}, "real_time_factor": 9.5,
        "changed_settings": {
            "navigation.controller_server.controller": {"value": "mppi", "default": "rpp"},
        },
    }  # fmt: skip
    run = make(tmp_path, "house", summary)
    (run / "labels.json").write_text('{"tags": ["keep"], "note": "good"}')
    (run / "thumbnail.png").touch()
    (listed,) = list_recordings(tmp_path)
    assert (listed.seed, listed.contacts, listed.real_time_factor) == (3, 2, 9.5)
    assert (listed.error_mean_m, listed.error_p95_m) == (0.5, 1.0)
    assert listed.changed_settings == {"navigation.controller_server.controller": "mppi"}
    assert (listed.tags, listed.note) == (("keep",), "good")
    assert listed.has_thumbnail
    assert (listed.state, listed.failed, listed.problem) == ("ended", False, None)


def test_whether_a_run_goes_on_is_known(tmp_path: Path) -> None:
    folder = RunFolder.exactly(tmp_path / "run")
    assert [run.state for run in list_recordings(tmp_path)] == ["running"]
    folder.let_go()
    assert [run.state for run in list_recordings(tmp_path)] == ["interrupted"]
    RunFolder.take_over(tmp_path / "run").release()
    (tmp_path / "run" / SUMMARY).write_text("{}")
    assert [run.state for run in list_recordings(tmp_path)] == ["ended"]


def test_a_run_that_was_cut_off_stays_interrupted_and_has_failed(tmp_path: Path) -> None:
    goals = [{"reached": True, "time_s": 1.0}]
    summary = {"goals": goals, "goals_sent": 2, "distance_m": 3.0, "ended": False}
    make(tmp_path, "repaired", summary)
    explored = {"goals": goals, "ended": False, "mapping": {"exploration": "complete"}}
    make(tmp_path, "explored", explored)
    running = RunFolder.exactly(make(tmp_path, "running"))
    (running.path / SUMMARY).write_text(json.dumps(summary))
    runs = {run.name: run for run in list_recordings(tmp_path)}
    found = {name: (run.state, run.closed, run.failed) for name, run in runs.items()}
    cut_off = ("interrupted", True, True)
    assert found == {
        "repaired": cut_off, "explored": cut_off, "running": ("running", False, False)
    }  # fmt: skip
    # The goal under way counts, unless it may still be reached.
    counted = {name: (run.goals_reached, run.goals_total) for name, run in runs.items()}
    assert counted == {"repaired": (1, 2), "explored": (1, 1), "running": (1, 1)}
    assert figures_of(summary)["goals_missed"] == 1.0
    kept = Kept(last=0)
    doomed = to_delete(list(runs.values()), kept, datetime.now())  # noqa: DTZ005 - local
    assert {run.name for run in doomed} == {"repaired", "explored"}
    running.let_go()


@pytest.mark.parametrize(
    ("goals", "exploration", "failed"),
    [
        ([True, True], "", False),
        ([True, False], "", True),
        # The explorer gives up goals for better ones.
        ([True, False], "complete", False),
        ([True, True], "failed", True),
    ],
)
def test_what_failed_is_known(
    tmp_path: Path, goals: list[bool], exploration: str, failed: bool
) -> None:
    reports = [{"reached": reached} for reached in goals]
    make(tmp_path, "run", {"goals": reports, "mapping": {"exploration": exploration}})
    assert list_recordings(tmp_path)[0].failed is failed


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("summary.json", "{bad"),
        ("summary.json", "[]"),
        ("summary.json", "[" * 100_000),
        ("labels.json", '{"tags": ["not a tag"]}'),
        ("labels.json", "\xff"),
    ],
)
def test_what_cannot_be_read_is_told_of(tmp_path: Path, file: str, text: str) -> None:
    run = make(tmp_path, "run", {"world": "house"})
    (run / file).write_text(text, encoding="latin-1")
    (listed,) = list_recordings(tmp_path)
    assert listed.problem is not None
    assert listed.problem.startswith(f"{file}: ")
    assert "\n" not in listed.problem
    assert listed.failed


@pytest.mark.parametrize("value", [True, "x", [1], {"a": 1}, 1e400, None, -1])
def test_values_of_any_kind_are_no_trouble(tmp_path: Path, value: object) -> None:
    names = ("seed", "sim_time_s", "goals", "contacts", "localisation_error_m", "mapping")
    make(tmp_path, "run", json.dumps(dict.fromkeys((*names, "changed_settings"), value)))
    assert len(list_recordings(tmp_path)) == 1


def settle(folder: Path) -> None:
    """As if the files had been written a while ago."""
    for path in folder.rglob("*.json"):
        os.utime(path, ns=(1_000_000_000, 1_000_000_000))


def test_a_catalog_reads_only_what_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []
    real = catalog._read

    def counted(path: Path, versions: object) -> object:
        read.append(path.name)
        return real(path, versions)  # type: ignore[arg-type]

    monkeypatch.setattr(catalog, "_read", counted)
    for number in range(30):
        make(tmp_path, f"run_{number:02}", {"world": "house"})
    settle(tmp_path)
    runs = Catalog(tmp_path)
    assert len(runs.runs()) == 30
    read.clear()
    runs.runs()
    assert read == []
    # The index serves another process, and a changed file is read again: also one of the same
    # size and time.
    summary = tmp_path / "run_07" / SUMMARY
    write_atomically(summary, [b'{"world": "HOUSE"}'])
    settle(tmp_path)
    worlds = {run.name: run.world for run in Catalog(tmp_path).runs()}
    assert read == ["run_07"]
    assert worlds["run_07"] == "HOUSE"
    assert Catalog(tmp_path).runs() == list_recordings(tmp_path)


@pytest.mark.parametrize("text", ["", "{bad", "[]", '{"fields": [], "runs": {}}', '{"runs": 3}'])
def test_an_index_of_no_use_is_passed_over(tmp_path: Path, text: str) -> None:
    for number in range(30):
        make(tmp_path, f"run_{number:02}", {"world": "house"})
    settle(tmp_path)
    expected = list_recordings(tmp_path)
    index = tmp_path / catalog.INDEX
    whole = json.loads(index.read_text())
    assert len(whole["runs"]) == 30
    index.write_text(text)
    assert list_recordings(tmp_path) == expected
    whole["runs"]["run_03"][2] = [1]
    index.write_text(json.dumps(whole))
    assert list_recordings(tmp_path) == expected


def test_a_folder_that_cannot_be_written_is_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(catalog, "write_atomically", fails)
    for number in range(30):
        make(tmp_path, f"run_{number:02}", {"world": "house"})
    assert len(list_recordings(tmp_path)) == 30


def test_a_run_is_found_by_folder_name_or_as_the_latest(tmp_path: Path) -> None:
    make(tmp_path, "2026-11-20_10-00-00_house", {})
    newest = make(tmp_path, "2026-11-21_10-00-00_house", {})
    for name in ("latest", newest.name, str(newest)):
        assert find_run("info", tmp_path, name).path == newest
    for name in ("nope", "x" * 5000, "a\0b"):
        with pytest.raises(ConfigError, match=r"^info: .*2026-11-21_10-00-00_house"):
            find_run("info", tmp_path, name)

"""The list of runs."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

from services.common.recordings.catalog import list_recordings
from services.common.recordings.run_folder import LOCK


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


def test_a_damaged_or_unfinished_run_is_listed_as_far_as_it_goes(tmp_path: Path) -> None:
    make(tmp_path, "2026-11-21_14-03-07_enhanced", "{ no json", b"x")
    (make(tmp_path, "mine", ["a list"]) / LOCK).touch()
    make(tmp_path, "no run at all")
    (tmp_path / "a file").touch()
    runs = {run.name: run for run in list_recordings(tmp_path)}
    assert set(runs) == {"2026-11-21_14-03-07_enhanced", "mine"}
    assert runs["2026-11-21_14-03-07_enhanced"].world == "enhanced"
    assert not runs["mine"].closed
    assert runs["mine"].started is not None


def test_no_folder_holds_no_runs(tmp_path: Path) -> None:
    assert list_recordings(tmp_path / "none") == []

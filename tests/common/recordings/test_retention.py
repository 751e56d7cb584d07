"""Which runs are deleted, and how."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import pytest

from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import RecordingInfo, list_recordings
from mazebot.common.recordings.retention import (
    GIB,
    Kept,
    delete_rest,
    delete_run,
    to_delete,
)
from mazebot.common.recordings.run_folder import RunFolder
from tests.common.recordings.made_run import listed_run, made_run

NOW = datetime(2026, 11, 21, 12, 0, 0)  # noqa: DTZ001 - local


def run(day: int, **fields: object) -> RecordingInfo:
    """A run of one GiB that began so many days ago."""
    return RecordingInfo(
        **{  # type: ignore[arg-type]
            "name": f"day_{day}", "path": Path(f"day_{day}"), "world": "house",
            "started": NOW - timedelta(days=day), "goals_reached": 0, "goals_total": 0,
            "sim_time_s": None, "size_bytes": GIB, "recording": None, "closed": True, **fields,
        }
    )  # fmt: skip


RUNS = [run(day) for day in (3, 1, 10, 7, 0)]


@pytest.mark.parametrize(
    ("kept", "days"),
    [
        (Kept(), []),
        (Kept(days=7), [10]),
        (Kept(days=2), [10, 7, 3]),
        (Kept(gib=5), []),
        (Kept(gib=2.5), [10, 7, 3]),
        (Kept(gib=0), [10, 7, 3, 1, 0]),
        (Kept(last=2), [10, 7, 3]),
        (Kept(last=0), [10, 7, 3, 1, 0]),
        (Kept(last=9), []),
        (Kept(days=2, last=4), [10]),
        (Kept(days=8, gib=2), [10, 7, 3]),
        (Kept(gib=0, last=1), [10, 7, 3, 1]),
    ],
)
def test_the_oldest_go_first(kept: Kept, days: list[int]) -> None:
    assert [one.name for one in to_delete(RUNS, kept, NOW)] == [f"day_{day}" for day in days]


@pytest.mark.parametrize(
    "fields",
    [
        {"state": "running", "closed": False},
        {"state": "interrupted", "closed": False},
        {"tags": ("a", "keep")},
        {"labels_unreadable": True},
    ],
)
def test_some_always_stay(fields: dict[str, object]) -> None:
    runs = [run(5, **fields), run(4)]
    for kept in (Kept(days=1), Kept(gib=0), Kept(last=0)):
        assert [one.name for one in to_delete(runs, kept, NOW)] == ["day_4"]


def test_a_killed_run_that_was_repaired_goes_as_any_other() -> None:
    killed = run(5, state="interrupted")
    assert to_delete([killed], Kept(days=1), NOW) == [killed]


def test_a_run_is_deleted_in_full(tmp_path: Path) -> None:
    folder = listed_run(tmp_path, "run", {})
    (folder / "map").mkdir()
    (folder / "map" / "map.yaml").touch()
    delete_run(folder)
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_is_recorded_is_not_deleted(tmp_path: Path) -> None:
    folder = RunFolder.exactly(tmp_path / "run")
    with pytest.raises(ConfigError, match="is being recorded"):
        delete_run(folder.path)
    assert folder.path.is_dir()
    folder.let_go()


def test_what_cannot_be_deleted_is_told_of(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        delete_run(tmp_path / "nowhere")


def test_a_link_to_a_run_goes_and_the_run_stays(tmp_path: Path) -> None:
    folder = listed_run(tmp_path / "elsewhere", "run", {})
    link = tmp_path / "recordings"
    link.symlink_to(folder)
    delete_run(link)
    assert folder.is_dir()
    assert not link.is_symlink()


def test_the_rest_of_a_deletion_is_no_run_and_goes(tmp_path: Path) -> None:
    listed_run(tmp_path, ".deleted-run", {})
    assert list_recordings(tmp_path) == []
    delete_rest(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_recorder_deletes_old_runs_at_start_and_at_a_runs_end(tmp_path: Path) -> None:
    listed_run(tmp_path, "2026-11-01_12-00-00_old", {})
    listed_run(tmp_path, "2026-11-02_12-00-00_kept", {}, labels_json='{"tags": ["keep"]}')
    listed_run(tmp_path, "2026-11-20_12-00-00_new", {})
    live = RunFolder.exactly(tmp_path / "2026-11-03_12-00-00_live")
    made_run(tmp_path, out_dir=None, recordings_dir=tmp_path, keep_days=7.0)
    names = {path.name.partition("_12-00-00_")[2] for path in tmp_path.iterdir()}
    assert names == {"kept", "new", "live", "room"}
    made_run(tmp_path, out_dir=None, recordings_dir=tmp_path, keep_gib=1e-6)
    names = {path.name.partition("_12-00-00_")[2] for path in tmp_path.iterdir()}
    # Too much still: but the newest run is never deleted.
    assert names == {"kept", "live", "room_2"}
    live.let_go()

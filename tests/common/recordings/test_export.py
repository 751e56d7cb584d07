"""One table of all runs."""

from __future__ import annotations

import csv
import json
import platform
from pathlib import Path

import pyarrow.parquet
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import list_recordings
from mazebot.common.recordings.export import Row, rows_of, write_table
from tests.common.recordings.made_run import listed_run, made_run


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A real run, one with other settings, and two of which little is known."""
    folder = tmp_path_factory.mktemp("runs")
    made_run(folder / "a")
    goal = {"name": "x", "reached": False, "time_s": 1, "goal": None}
    changed = {
        "navigation.controller_server.controller": {"value": 3, "default": 1},
        "mapping.area_m": {"value": [1, 2], "default": None},
    }
    summary = {"seed": 2**70, "goals": [goal], "changed_settings": changed, "sim_time_s": 1}
    listed_run(folder, "b", summary, labels_json='{"tags": ["keep", "slow"], "note": "a,\\"b\\""}')
    listed_run(folder, "c", summary_json="{bad")
    listed_run(folder, "d", {"seed": 1, "sim_time_s": 1.5})
    return folder


def test_each_run_is_a_row(runs: Path) -> None:
    rows = {row["name"]: row for row in rows_of(list_recordings(runs), "runs")}
    assert list(rows) == ["a", "b", "c", "d"]
    first = rows["a"]
    assert first["localisation_error_m.mean"] == pytest.approx(0.05, abs=1e-3)
    assert first["goals_missed"] == 1.0
    assert first["settings.navigation.controller_server.controller"] == "mppi"
    assert first["versions.python"] == platform.python_version()
    assert (rows["b"]["tags"], rows["b"]["settings.mapping.area_m"]) == ("keep,slow", "[1, 2]")
    assert rows["c"]["problem"].startswith("summary.json: ")
    assert not any(
        isinstance(value, dict | list) for row in rows.values() for value in row.values()
    )


def test_each_goal_is_a_row(runs: Path) -> None:
    rows = rows_of(list_recordings(runs), "goals")
    assert [(row["run"], row["number"], row["name"]) for row in rows] == [
        ("a", 0, "corner"),
        ("b", 0, "x"),
    ]
    assert rows[0]["goal.x_m"] == 1.0


@pytest.mark.parametrize("kind", ["runs", "goals"])
def test_all_formats_hold_the_same(runs: Path, tmp_path: Path, kind: str) -> None:
    rows = rows_of(list_recordings(runs), kind)  # type: ignore[arg-type]
    files = [tmp_path / f"table{suffix}" for suffix in (".parquet", ".csv", ".json")]
    for file in files:
        write_table(file, rows)
    table = pyarrow.parquet.read_table(files[0])
    names = list(dict.fromkeys(name for row in rows for name in row))
    assert table.column_names == names
    read: list[Row] = json.loads(files[2].read_text())
    assert read == [{name: row.get(name) for name in names} for row in rows]
    with files[1].open(newline="") as text:
        said = list(csv.DictReader(text))
    assert [one.get("note") for one in said] == [
        None if "note" not in names else one["note"] or "" for one in read
    ]
    for name in ("name", "time_s", "sim_time_s", "reached", "distance_m"):
        if name in names:
            assert table[name].to_pylist() == [one[name] for one in read]
    if kind == "runs":
        controllers = table["settings.navigation.controller_server.controller"]
        assert controllers.to_pylist() == ["mppi", "3", None, None]
        assert table["seed"].to_pylist() == ["7", str(2**70), None, "1"]


def test_no_runs_make_an_empty_table(tmp_path: Path) -> None:
    for suffix in (".parquet", ".csv", ".json"):
        write_table(tmp_path / f"table{suffix}", [])
        assert (tmp_path / f"table{suffix}").is_file()


def test_what_cannot_be_written_is_told_of_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"--out: .*table\.txt: must end in \.parquet"):
        write_table(tmp_path / "table.txt", [{"a": 1}])
    with pytest.raises(ConfigError, match="No such file"):
        write_table(tmp_path / "nowhere" / "table.csv", [{"a": 1}])
    assert list(tmp_path.iterdir()) == []

"""Runs side by side."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from mazebot.common.config import ConfigError
from mazebot.common.recordings.comparing.compare_runs import FigureRow, RunsComparison, compare_runs
from tests.cli.test_diff import make_run
from tests.common.recordings.made_run import listed_run


def figures(comparison: RunsComparison) -> dict[str, FigureRow]:
    return {row.name: row for row in comparison.figures}


def test_equal_runs_differ_in_nothing(tmp_path: Path) -> None:
    comparison = compare_runs([make_run(tmp_path / "a"), make_run(tmp_path / "b")])
    assert comparison.runs == ("a", "b")
    assert comparison.settings == ()
    assert {row.judgements for row in comparison.figures} <= {("same", "same")}
    (verdict,) = comparison.messages
    assert verdict.same
    assert verdict.lines[0].startswith("the same: ")


def test_runs_are_compared_with_the_first_one(tmp_path: Path) -> None:
    folders = [
        make_run(tmp_path / "a"),
        make_run(tmp_path / "b", seed=8, differs=True),
        make_run(tmp_path / "c", speed_m_s=0.3),
    ]
    comparison = compare_runs(folders)
    assert [(row.name, row.values) for row in comparison.settings] == [
        ("seed", (7, 8, 7)),
        ("navigation.max_speed_m_s", (0.26, 0.26, 0.3)),
    ]
    assert [verdict.same for verdict in comparison.messages] == [False, True]
    assert comparison.messages[0].lines[0].startswith("first difference: 1.033 s")
    assert RunsComparison.model_validate_json(comparison.model_dump_json()) == comparison


def test_it_is_known_which_figure_is_better(tmp_path: Path) -> None:
    summaries = [
        {"goals": [{"reached": True, "time_s": 10.0}, {"reached": False, "time_s": 5.0}],
         "localisation_error_m": {"mean": 0.02}, "real_time_factor": 10.0, "distance_m": 3.0,
         "contacts": {"count": 1}, "messages": {"/scan": {"lost": 2, "rejected": 0}}},
        {"goals": [{"reached": True, "time_s": 12.0}],
         "localisation_error_m": {"mean": 0.03}, "real_time_factor": 12.0, "distance_m": 4.0,
         "contacts": {"count": 1.0}, "messages": {"/scan": {"lost": 0, "rejected": 0}}},
        {"localisation_error_m": {"mean": 0.02000001}},
    ]  # fmt: skip
    folders = [listed_run(tmp_path, name, one) for name, one in zip("abc", summaries, strict=True)]
    rows = figures(compare_runs(folders))
    judged = {name: row.judgements[1] for name, row in rows.items()}
    assert judged == {
        "goals_missed": "better", "goal_time_s": "better", "distance_m": "other",
        "contacts.count": "same", "recoveries": "same", "localisation_error_m.mean": "worse",
        "real_time_factor": "better", "messages_lost": "better", "messages_rejected": "same",
    } | {name: None for name in judged if rows[name].values[0] is None}  # fmt: skip
    assert rows["localisation_error_m.mean"].deltas[1] == pytest.approx(0.01)
    assert rows["localisation_error_m.mean"].judgements[2] == "same"
    assert rows["distance_m"].deltas == (0.0, 1.0, None)
    assert rows["distance_m"].judgements[2] is None


def test_a_service_that_one_run_does_not_have_is_one_row(tmp_path: Path) -> None:
    one, other = make_run(tmp_path / "a"), make_run(tmp_path / "b")
    config = {"seed": 8, "services": {"mapping": {"resolution_m": 0.05, "seed": 8}}}
    (other / "config.yaml").write_text(yaml.safe_dump(config))
    rows = [(row.name, row.values) for row in compare_runs([one, other]).settings]
    assert rows == [("mapping", (None, "running")), ("navigation", ("running", None))]


def test_a_common_seed_is_told_once(tmp_path: Path) -> None:
    folders = []
    for seed in (1, 2):
        run = listed_run(tmp_path, f"run_{seed}", {"seed": seed})
        services = {"physics": {"seed": seed}, "mapping": {"seed": 1}}
        (run / "config.yaml").write_text(yaml.safe_dump({"services": services}))
        folders.append(run)
    assert [row.name for row in compare_runs(folders).settings] == ["seed"]


def test_without_digests_the_rest_is_compared(tmp_path: Path) -> None:
    folders = [make_run(tmp_path / "a"), listed_run(tmp_path, "b", {}), make_run(tmp_path / "c")]
    verdicts = compare_runs(folders).messages
    assert [verdict.same for verdict in verdicts] == [None, True]
    assert "has no digests.bin" in verdicts[0].lines[0]
    assert compare_runs(folders, messages=False).messages == ()


@pytest.mark.parametrize("file", ["summary.json", "config.yaml"])
def test_a_file_that_cannot_be_read_is_told_of(tmp_path: Path, file: str) -> None:
    folders = [make_run(tmp_path / "a"), make_run(tmp_path / "b")]
    (folders[1] / file).write_text("{bad: [")
    with pytest.raises(ConfigError, match=file.replace(".", r"\.")):
        compare_runs(folders)


def test_settings_of_any_kind_are_json(tmp_path: Path) -> None:
    folders = []
    for day in (1, 2):
        run = listed_run(tmp_path, f"run_{day}", {})
        (run / "config.yaml").write_text(f"services: {{a: {{b: 2026-01-0{day}, c: [1, x]}}}}\n")
        folders.append(run)
    (row,) = compare_runs(folders).settings
    assert row.values == ("2026-01-01", "2026-01-02")
    json.dumps(row.model_dump(mode="json"))

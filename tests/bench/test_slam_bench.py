"""What the benchmark of explorations says of a run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from mazebot.bench.slam import slam_bench
from mazebot.bench.slam.open_worlds import GENERATED, written
from mazebot.bench.slam.slam_bench import SlamRun, savings, table_of
from mazebot.common.messages import documents as doc
from mazebot.worldgen.files import load_any

WELL = SlamRun(
    world="original", seed=1, policy="tour", exploration="complete", reason="", coverage=0.999,
    walls_found=0.98, walls_true=1.0, free_wrong=0.0, path_error_p95_m=0.01, path_error_max_m=0.02,
    contacts=0, driven_m=26.0, tour_m=20.0, keyframes=40, loops=1, loops_rejected=0, false_loops=0,
    markers_found=0, markers_missing=0, markers_false=0, marker_error_p95_m=None,
    scan_median_ms=1.0, scan_p99_ms=2.0, scan_max_ms=20.0, sim_time_s=80.0, wall_time_s=20.0,
    state_hash="ab", most_path_error_m=0.05,
)  # fmt: skip


def test_a_run_that_is_as_it_must_be_has_no_failures() -> None:
    assert WELL.failures() == []
    assert WELL.ratio == pytest.approx(1.3)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"exploration": "failed"}, "failed"),
        ({"exploration": ""}, "not explored"),
        ({"coverage": 0.989}, "coverage 0.989"),
        ({"coverage": None}, "coverage -"),
        ({"walls_found": 0.96}, "walls found 0.960"),
        ({"path_error_p95_m": 0.06}, "path error p95 0.060 m"),
        ({"path_error_p95_m": None}, "path error p95 - m"),
        ({"contacts": 2}, "2 contacts"),
        ({"false_loops": 1}, "1 false loops"),
    ],
)
def test_what_is_not_as_it_must_be_is_said(changes: dict[str, Any], said: str) -> None:
    assert replace(WELL, **changes).failures() == [said]


def test_errors_of_odometry_allow_twice_the_error() -> None:
    worse = replace(WELL, path_error_p95_m=0.08, most_path_error_m=0.10)
    assert worse.failures() == []


def test_the_table_counts_the_runs_of_each_policy_and_shows_the_worst() -> None:
    bad = replace(WELL, seed=2, coverage=0.5, walls_found=0.9)
    far = replace(WELL, policy="nearest", driven_m=40.0)
    console = Console(width=200, color_system=None)
    with console.capture() as capture:
        console.print(table_of([WELL, bad, far]))
    tour, nearest = (
        line.split() for line in capture.get().splitlines() if line.lstrip().startswith("original")
    )
    assert tour[1:7] == ["tour", "1", "of", "2", "0.5000", "0.9000"]
    assert nearest[1:7] == ["nearest", "1", "of", "1", "0.9990", "0.9800"]


def test_the_saving_is_by_the_same_seeds() -> None:
    runs = [
        WELL,
        replace(WELL, policy="nearest", driven_m=40.0),
        replace(WELL, seed=2, driven_m=30.0),
        replace(WELL, seed=2, policy="nearest", driven_m=40.0),
        replace(WELL, seed=3, driven_m=1.0),
    ]
    (line,) = savings(runs)
    assert line == (
        "original: the tour is 30% shorter than by nearest frontier (2 seeds, 25% to 35%)"
    )


def test_a_summary_becomes_a_row() -> None:
    mapping = doc.MapEvaluation(
        coverage_share=0.5, walls_found_share=0.6, exploration="exploring", driven_m=10.0,
        trajectory_error_m=doc.TrajectoryError(rmse=0.01, p95=0.02, max=0.03),
    )  # fmt: skip
    summary = {
        "mapping": mapping.model_dump(mode="json"), "contacts": {"count": 3}, "sim_time_s": 5.0,
        "state_hash": None,
    }  # fmt: skip
    run = slam_bench._run_of("maze", 4, "tour", summary, 20.0, [3.0, 1.0, 2.0], 9.0, True)
    assert (run.coverage, run.path_error_p95_m, run.contacts) == (0.5, 0.02, 3)
    assert (run.scan_median_ms, run.scan_max_ms, run.ratio) == (2.0, 3.0, 0.5)
    assert run.most_path_error_m == 0.10


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_house_is_explored_as_it_must_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["slam_bench", "--keep", str(tmp_path)])
    run = slam_bench.explore("original", 1, "tour", slam_bench._options())
    assert run.failures() == []
    assert run.ratio is not None
    assert run.ratio < 1.3
    assert (tmp_path / "original_1_tour" / "map" / "map.yaml").is_file()


@pytest.mark.parametrize("world", list(GENERATED))
def test_generated_worlds_are_valid_and_made_of_their_seed(world: str, tmp_path: Path) -> None:
    file = written(world, 3, tmp_path)
    loaded = load_any(str(file))
    assert loaded.world.bodies or loaded.world.walls
    first = file.read_text()
    assert written(world, 3, tmp_path).read_text() == first
    assert written(world, 4, tmp_path).read_text() != first


def test_a_floor_without_an_edge_needs_no_coverage() -> None:
    assert replace(WELL, coverage=None, tour_m=None, world="yard").failures() == []
    assert replace(WELL, coverage=None, world="furnished").failures() == ["coverage -"]

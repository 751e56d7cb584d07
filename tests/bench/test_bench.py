"""The bench and its figures, on few repeats."""

import json
from pathlib import Path

import pytest

from mazebot.bench.bench_figures import as_json, figure, missing, tables
from mazebot.bench.whole import bench, bench_loop, bench_peers
from mazebot.worldgen.recipe.loader import load_world


def test_a_figure_has_its_spread() -> None:
    one = figure("group", "name", "ms", [5.0, 1.0, 3.0, 2.0, 4.0])
    assert (one.median, one.least, one.most, one.count) == (3.0, 1.0, 5.0, 5)
    assert one.p10 == pytest.approx(1.4)
    assert one.p90 == pytest.approx(4.6)


def test_what_cannot_be_measured_says_why_in_table_and_json() -> None:
    one = missing("group", "name", "ms", "no such machine")
    assert figure("group", "name", "ms", []).count == 0
    (table,) = tables([one])
    assert "no such machine" in list(table.columns[-1].cells)
    (row,) = as_json([one], {})["figures"]
    assert (row["count"], row["note"]) == (0, "no such machine")


def test_without_ir_sim_its_rows_say_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(bench_peers, "IRSIM_PYTHON", tmp_path / "python")
    figures = bench_peers.ir_sim(load_world("enhanced").world, 0.1, 1)
    assert [one.count for one in figures] == [0, 0]
    assert {one.note for one in figures} == {"not installed: make bench"}


def test_plain_pybullet_sees_the_same_maze(capfd: pytest.CaptureFixture[str]) -> None:
    figures = bench_peers.plain_pybullet(load_world("enhanced").world, 0.2, 1, 1)
    assert [one.unit for one in figures] == ["x real time", "ms", "ms"]
    assert all(one.median > 0.0 for one in figures)
    assert capfd.readouterr().out == ""


def test_an_episode_is_measured_in_all_its_parts() -> None:
    measured = bench_loop.episode_in_own_process(bench_loop.WITHOUT_CAMERA, 0.5)
    assert measured["real_time_factor"] > 0.0
    assert 100.0 < measured["peak_mb"] < 2000.0
    assert len(measured["services_ms"]["physics"]) == 120
    assert len(measured["services_ms"]["navigation"]) == 10
    assert len(measured["state_hash"]) == 16


@pytest.mark.slow
def test_the_whole_bench_leaves_its_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.main(["--quick", "--json", str(tmp_path / "bench.json")])
    report = json.loads((tmp_path / "bench.json").read_text())
    assert report["machine"]["cores"] >= 1
    assert report["machine"]["processor"]
    groups = {one["group"] for one in report["figures"]}
    assert groups >= {
        "physics alone", "lidar, one scan", "camera, one picture", "wire",
        "whole loop, one process", "memory of the whole process", "against others, same maze",
    }  # fmt: skip
    for one in report["figures"]:
        if one["count"]:
            assert one["least"] <= one["p10"] <= one["median"] <= one["p90"] <= one["most"], one
        else:
            assert one["note"], one
    assert "whole loop" in capsys.readouterr().out

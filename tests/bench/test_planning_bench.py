"""The planner's bench: the files of the MovingAI benchmarks, and the maps made by seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mazebot.bench.parts.planning_bench import on_benchmark, on_made_maps
from mazebot.bench.parts.planning_maps import KINDS, read_movingai_map, read_movingai_scen
from mazebot.common.config import ConfigError

MAP = "type octile\nheight 4\nwidth 6\nmap\n......\n.@@T..\n..S.W.\n......\n"
SCEN = "version 1\n0\ta.map\t6\t4\t0\t0\t5\t3\t7.41421356\n1\ta.map\t6\t4\t3\t2\t3\t2\t0.0\n"


def files(folder: Path, chart: str = MAP, scen: str = SCEN) -> tuple[Path, Path]:
    (folder / "a.map").write_text(chart)
    (folder / "a.scen").write_text(scen)
    return folder / "a.map", folder / "a.scen"


def test_trees_water_and_the_edge_are_obstacles_and_swamp_is_not(tmp_path: Path) -> None:
    solid = read_movingai_map(files(tmp_path)[0])
    assert solid.shape == (4, 6)
    assert [tuple(cell) for cell in np.argwhere(solid)] == [(1, 1), (1, 2), (1, 3), (2, 4)]


def test_a_problem_has_columns_before_rows(tmp_path: Path) -> None:
    first, second = read_movingai_scen(files(tmp_path)[1])
    assert first == ((0, 0), (3, 5), 7.41421356)
    assert second.start == (2, 3)


@pytest.mark.parametrize(
    ("chart", "said"),
    [
        ("type octile\nheight x\nwidth 6\nmap\n", "height"),
        ("type octile\nheight 9\nwidth 6\nmap\n......\n", "9 lines of 6"),
        ("type octile\nheight 1\nwidth 6\nmap\n.....\n", "1 lines of 6"),
    ],
)
def test_a_bad_map_is_told_in_one_line(tmp_path: Path, chart: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        read_movingai_map(files(tmp_path, chart)[0])


def test_a_bad_problem_is_told_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="scen:2: must be bucket"):
        read_movingai_scen(files(tmp_path, scen="version 1\n0 a.map 6 4 0 0 x 3 1.0\n")[1])
    with pytest.raises(ConfigError, match="must be in"):
        on_benchmark(*files(tmp_path, scen="0 a.map 6 4 0 0 7 3 1.0\n"), 9)


def test_the_search_meets_the_optimum_of_a_benchmark(tmp_path: Path) -> None:
    figures = {one.name: one for one in on_benchmark(*files(tmp_path), 9)}
    ratio = figures["a_star unsmoothed, cost weight 0: cost / optimum of 8 directions"]
    assert ratio.most == pytest.approx(1.0, abs=1e-6)
    assert ratio.count == 1
    assert figures["any_angle, cost weight 0: cost / optimum of 8 directions"].most < 1.0


def test_each_kind_of_map_is_measured() -> None:
    figures = on_made_maps((48,), 3)
    assert {one.group for one in figures} == {f"{kind} 48 x 48" for kind in KINDS}
    assert all(one.most <= 1.01 for one in figures if "optimum" in one.name)

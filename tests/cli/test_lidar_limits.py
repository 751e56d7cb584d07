"""What a log says of how far its lidar sees."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mazebot.cli.app import app
from mazebot.cli.logs.log import ScanForm
from mazebot.cli.logs.read import read_log
from mazebot.common.config import ConfigError
from tests.cli.test_lidar_places import RANGES_M, STEP_NS, read, scans_of, write

STAMPS_NS = range(STEP_NS, 21 * STEP_NS, STEP_NS)
NONE_BEYOND_M = np.where(RANGES_M > 1.5, math.inf, RANGES_M)


def refused(log: Path, *options: str) -> str:
    result = CliRunner().invoke(
        app, ["map", "build", "--log", str(log), "--out", str(log.parent / "out"), *options]
    )
    assert isinstance(result.exception, ConfigError)
    assert str(result.exception).startswith(f"--log: {log}: ")
    return str(result.exception)


@pytest.mark.parametrize(
    ("limits_m", "said"),
    [
        ((0.1, 0.0), "range_min 0.1 and range_max 0:"),
        ((0.1, math.nan), "range_min 0.1 and range_max nan:"),
        ((math.nan, 9.0), "range_min nan and range_max 9:"),
        ((-math.inf, 9.0), "range_min -inf and range_max 9:"),
    ],
)
def test_limits_that_hold_no_range_are_refused_and_can_be_given(
    tmp_path: Path, limits_m: tuple[float, float], said: str
) -> None:
    bag = write(tmp_path / "bag", stamps_ns=STAMPS_NS, limits_m=[limits_m])
    message = refused(bag)
    assert said in message
    assert "--range-max" in message
    log = read_log(bag, ScanForm(range_min_m=0.2, range_max_m=8.0))
    assert {(one.range_min_m, one.range_max_m) for one in scans_of(log)} == {(0.2, 8.0)}
    assert not log.remarks()


def test_scans_whose_limits_hold_no_range_are_counted_and_left_out(tmp_path: Path) -> None:
    log = read(write(tmp_path / "bag", stamps_ns=STAMPS_NS, limits_m=[(0.1, 9.0), (0.1, 0.0)]))
    assert log.scans == 10
    (remark,) = log.remarks()
    assert remark.startswith("10 scans have a range_min or range_max")


@pytest.mark.parametrize("stated_m", [30.0, 100.0, math.inf])
def test_a_lidar_that_states_far_more_than_it_sees_sees_as_far_as_its_longest_return(
    tmp_path: Path, stated_m: float
) -> None:
    bag = write(
        tmp_path / "bag", stamps_ns=STAMPS_NS, limits_m=[(0.1, stated_m)], ranges_m=NONE_BEYOND_M
    )
    log = read(bag)
    for scan in scans_of(log):
        assert 1.5 < scan.range_max_m < 1.501
        assert np.isfinite(scan.ranges_m[scan.ranges_m < scan.range_max_m]).sum() == 11
    (remark,) = log.remarks()
    assert f"no return is longer than 1.50 m, and range_max is {stated_m:g} m" in remark


@pytest.mark.parametrize(("stated_m", "ranges_m"), [(2.75, NONE_BEYOND_M), (30.0, RANGES_M)])
def test_else_it_sees_as_far_as_it_states(
    tmp_path: Path, stated_m: float, ranges_m: np.ndarray
) -> None:
    log = read(
        write(tmp_path / "bag", stamps_ns=STAMPS_NS, limits_m=[(0.1, stated_m)], ranges_m=ranges_m)
    )
    assert {scan.range_max_m for scan in scans_of(log)} == {stated_m}
    assert not log.remarks()


@pytest.mark.parametrize("range_m", [math.nan, math.inf, 0.0, 0.05])
def test_no_map_is_made_without_returns(tmp_path: Path, range_m: float) -> None:
    message = refused(write(tmp_path / "bag", stamps_ns=STAMPS_NS, ranges_m=np.full(21, range_m)))
    assert "none of 20 scans has a return: no range is >= range_min, 0.1 m" in message
    assert "< range_max, 9 m" in message


def test_no_map_is_made_where_no_return_is_near_enough(tmp_path: Path) -> None:
    bag = write(
        tmp_path / "bag", stamps_ns=STAMPS_NS, limits_m=[(0.1, 50.0)], ranges_m=np.full(21, 30.0)
    )
    assert "no cell of its map is occupied" in refused(bag)


def test_why_no_scan_can_be_used_is_told(tmp_path: Path) -> None:
    scans = [f"RAWLASER1 0 -1.5 3.0 1.5 8 0.01 0 3 1 2 3 0 {i} h {i}" for i in range(5, 9)]
    log = tmp_path / "raw.log"
    log.write_text("\n".join(["ODOM 0 0 0 0 0 0 1 h 1", "ODOM 1 0 0 0 0 0 2 h 2", *scans]) + "\n")
    assert "none of its 4 scans can be used: 4 without odometry" in refused(log)

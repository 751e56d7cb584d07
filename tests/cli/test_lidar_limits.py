"""What a log says of how far its lidar sees."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mazebot.cli.app import app
from mazebot.cli.logs.log import Entry, Log, LoggedScan, ScanForm, Topics
from mazebot.cli.logs.reach import dropouts, without_dropouts
from mazebot.cli.logs.read import read_log
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
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


@pytest.mark.parametrize("increment_rad", [0.1, math.nan, 0.0])
def test_directions_that_are_given_are_in_the_place_of_the_bags(
    tmp_path: Path, increment_rad: float
) -> None:
    bag = write(tmp_path / "bag", stamps_ns=STAMPS_NS, increment_rad=increment_rad)
    log = read_log(bag, ScanForm(angle_min_rad=0.5, angle_increment_rad=-0.02))
    told = {(one.angle_min_rad, one.angle_increment_rad) for one in scans_of(log)}
    assert told == {(0.5, -0.02)}


def test_directions_are_given_of_one_lidar_alone(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", stamps_ns=STAMPS_NS, frames=("left", "right"))
    with pytest.raises(ConfigError, match="2 lidars, 'left', 'right': must be given for one"):
        read_log(bag, ScanForm(angle_min_rad=0.5))


def test_topics_are_of_a_bag_alone(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0\n0,0,0,0,1\n")
    with pytest.raises(ConfigError, match=f"{log} has no topics: must be given with a bag"):
        read_log(log, ScanForm(), Topics(scan="/front/scan"))


def test_scans_whose_limits_hold_no_range_are_counted_and_left_out(tmp_path: Path) -> None:
    log = read(write(tmp_path / "bag", stamps_ns=STAMPS_NS, limits_m=[(0.1, 9.0), (0.1, 0.0)]))
    assert log.scans == 10
    (remark,) = log.remarks()
    assert remark.startswith("10 scans have a range_min or range_max")


def test_beams_over_more_than_a_turn_are_no_scan(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", stamps_ns=STAMPS_NS, increment_rad=1.0)
    assert "angle_increment 1 x 21 beams is 3.18 turns: must be radians" in refused(bag)
    table = tmp_path / "log.csv"
    header = "time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0,range_1,range_2,range_3,range_4"
    table.write_text(f"{header},range_5,range_6,range_7,range_8\n0,0,0,0" + ",2" * 9 + "\n")
    assert "angle_increment 1 x 9 beams is 1.27 turns" in refused(table, "--angle-increment", "1")
    assert read_log(table, ScanForm(angle_increment_rad=math.tau / 8)).scans == 1


def test_where_some_are_the_others_are_used(tmp_path: Path) -> None:
    lines = [
        f"ROBOTLASER1 0 0 0 {step} 9 0.01 0 3 1 2 3 0 {i} 0 0 {i} 0 0 0 0 0 0 0 {i} h {i}"
        for i, step in enumerate((0.1, 3.0, 0.1, 3.14, 3.14), start=1)
    ]
    raw = tmp_path / "robot.log"
    raw.write_text("\n".join(lines).replace("0 3 1 2 3 0", "0 5 1 2 3 2 1 0") + "\n")
    log = read_log(raw, ScanForm())
    assert (log.scans, len(log.entries)) == (2, 5)
    (remark,) = log.remarks()
    assert remark.startswith("3 scans have beams over more than a turn")


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


def scan_of(ranges_m: list[float], increment_rad: float = 0.01) -> LoggedScan:
    return LoggedScan(np.array(ranges_m, np.float32), 0.0, increment_rad, 0.1, 30.0)


@pytest.mark.parametrize(
    ("ranges_m", "increment_rad", "expected"),
    [
        ([math.inf, 2.0, math.inf, 2.0, math.inf], 0.01, [2]),
        # Of 0.15 m as the nearer return has it, and of 0.6 m.
        ([3.0, math.inf, 30.0, math.inf, math.inf, 9.0], 0.01, [1, 2, 3, 4]),
        ([12.0, math.inf, 30.0, math.inf, math.inf, 13.0], -0.01, []),
        # One beam between two is what a coarse lidar has of a wall far away.
        ([12.0, math.inf, 12.0, math.nan, 12.0, 0.0, 12.0], 0.02, [1]),
        ([math.inf] * 4, 0.01, []),
        ([math.inf, 1.0, math.inf], 0.01, []),
        ([], 0.01, []),
    ],
)
def test_a_beam_drops_out_where_no_opening_is(
    ranges_m: list[float], increment_rad: float, expected: list[int]
) -> None:
    assert np.flatnonzero(dropouts(scan_of(ranges_m, increment_rad))).tolist() == expected


@pytest.mark.parametrize(("every", "share"), [(12, None), (8, "11 %"), (3, "29 %")])
def test_where_many_beams_drop_out_they_show_no_free_space(every: int, share: str | None) -> None:
    ranges_m = np.full(361, 5.0, np.float32)
    ranges_m[1::every] = math.inf
    ranges_m[300:340] = math.inf
    here = SE2(0.0, 0.0, 0.0)
    log = without_dropouts(Log([Entry(0, here, scan_of(ranges_m.tolist())), Entry(1, here, None)]))
    scan = log.entries[0].scan
    assert scan is not None
    assert np.isposinf(scan.ranges_m[300:340]).all()
    assert np.isnan(scan.ranges_m[1]) == (share is not None)
    assert [remark[:4] for remark in log.remarks()] == ([] if share is None else [share])


@pytest.mark.parametrize("range_m", [math.nan, math.inf, 0.0, 0.05])
def test_no_map_is_made_without_returns(tmp_path: Path, range_m: float) -> None:
    message = refused(write(tmp_path / "bag", stamps_ns=STAMPS_NS, ranges_m=np.full(21, range_m)))
    assert "none of 20 scans has a return: no range is >= range_min, 0.1 m" in message
    assert "< range_max, 9 m" in message


def test_no_map_is_made_where_no_return_is_near_enough(tmp_path: Path) -> None:
    bag = write(
        tmp_path / "bag", stamps_ns=STAMPS_NS, limits_m=[(0.1, 50.0)], ranges_m=np.full(21, 45.0)
    )
    assert "no cell of its map is occupied" in refused(bag)


def test_why_no_scan_can_be_used_is_told(tmp_path: Path) -> None:
    scans = [f"RAWLASER1 0 -1.5 3.0 1.5 8 0.01 0 3 1 2 3 0 {i} h {i}" for i in range(5, 9)]
    log = tmp_path / "raw.log"
    log.write_text("\n".join(["ODOM 0 0 0 0 0 0 1 h 1", "ODOM 1 0 0 0 0 0 2 h 2", *scans]) + "\n")
    assert "none of its 4 scans can be used: 4 without odometry" in refused(log)

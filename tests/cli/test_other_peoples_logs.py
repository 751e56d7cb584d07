"""Logs of others that hold more than is used, or what is of no use."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.test_logs import RANGES, START, flaser, read, robotlaser, scans, written


@pytest.mark.parametrize("few", ["ROBOTLASER1", "RAWLASER1"])
def test_the_kind_of_most_scans_is_used_and_the_rest_is_told(tmp_path: Path, few: str) -> None:
    line = robotlaser(7.5, START, START, RANGES, 80.0)
    if few == "RAWLASER1":
        line = "RAWLASER1 0 -1.5 3.0 1.5 8 0.01 0 3 1 2 3 0 7.5 h 0.5"
    behind = "RLASER 2 1 1 0 0 0 0 0 0 5.5 nohost 0.6"
    lines = [flaser(time_s) for time_s in (5.0, 6.0, 7.0)]
    log = read(written(tmp_path, *lines, line, behind))
    assert [entry.stamp_ns for entry in scans(log)] == [5 * 10**9, 6 * 10**9, 7 * 10**9]
    assert log.remarks() == [f"lines not used: 1 {few}, 1 RLASER: the scans are those of FLASER"]

"""Bags whose clock was set back while they were recorded: all goes on from there, in order."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from mazebot.cli.logs.log import Log
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from tests.cli.test_bag_shapes import BEGUN_NS, HUMBLE, LASER, MOVED, Logged, logged, write_mcap

SECOND_NS = 1_000_000_000
ODOM_NS, ON_THE_WAY_NS = 50_000_000, 3_000_000
LENGTH_NS = 40 * SECOND_NS
NEAR_NS = 2 * ODOM_NS
"""What it may be off by: nobody knows how long it was until the first message after that."""
Clock = Callable[[int], int]
"""What it shows after so many ns."""


def right(passed_ns: int) -> int:
    return BEGUN_NS + passed_ns


def set_back(*steps: tuple[float, float]) -> Clock:
    """After so many s, by so many s; each."""
    return lambda passed_ns: (
        right(passed_ns)
        - sum(round(by_s * SECOND_NS) for after_s, by_s in steps if passed_ns > after_s * SECOND_NS)
    )


def drive(
    stamps: Clock, logs: Clock = right, scan_ns: int = SECOND_NS, scan_stamps: Clock | None = None
) -> list[Logged]:
    """Odometry and scans in the order of recording; x and all ranges tell their true time in s."""
    messages: list[tuple[int, Logged]] = []
    still = msg.Twist(msg.Vector3(0.0, 0.0, 0.0), msg.Vector3(0.0, 0.0, 0.0))
    for at_ns in range(0, LENGTH_NS, ODOM_NS):
        pose = msg.pose_from_se2(SE2(at_ns / SECOND_NS, 0.0, 0.0))
        moved = msg.Odometry(
            msg.header(stamps(at_ns), "odom"), "base_footprint",
            msg.PoseWithCovariance(pose, np.zeros(36)),
            msg.TwistWithCovariance(still, np.zeros(36)),
        )  # fmt: skip
        known_ns = at_ns + ON_THE_WAY_NS
        data = bytes(HUMBLE.serialize_cdr(moved, MOVED))
        messages.append((known_ns, ("/odom", MOVED, logs(known_ns), data)))
    for at_ns in range(0, LENGTH_NS, scan_ns):
        sweep = msg.LaserScan(
            msg.header((scan_stamps or stamps)(at_ns), "base_scan"), 0.0, 6.0, 0.1, 0.0, 0.1, 0.0,
            99.0, np.full(60, at_ns / SECOND_NS, np.float32), np.zeros(0, np.float32),
        )  # fmt: skip
        known_ns = at_ns + 2 * ON_THE_WAY_NS
        data = bytes(HUMBLE.serialize_cdr(sweep, LASER))
        messages.append((known_ns, ("/scan", LASER, logs(known_ns), data)))
    return [one for _, one in sorted(messages, key=lambda message: message[0])]


def assert_goes_on(log: Log, scan_ns: int = SECOND_NS) -> None:
    """All is there, at its true time from the first on."""
    assert log.scans == LENGTH_NS // scan_ns
    assert len(log.entries) - log.scans == LENGTH_NS // ODOM_NS
    for one in log.entries:
        true_s = one.odom_from_base.x_m if one.odom_from_base else float(one.scan.ranges_m[0])
        passed_ns = one.stamp_ns - log.entries[0].stamp_ns
        assert abs(passed_ns - true_s * SECOND_NS) < NEAR_NS


def of_stamps(tmp_path: Path, *steps: tuple[float, float], scan_ns: int = SECOND_NS) -> Log:
    messages = drive(set_back(*steps), scan_ns=scan_ns)
    return logged(write_mcap(tmp_path / "a.mcap", messages))


def test_stamps_that_go_back_by_little_are_those_of_all_topics(tmp_path: Path) -> None:
    for by_s, scan_ns in ((1.3, SECOND_NS), (1.1, SECOND_NS // 5), (2.5, 4 * SECOND_NS)):
        log = of_stamps(tmp_path, (20.02, by_s), scan_ns=scan_ns)
        assert log.clock_set_back == 1
        assert_goes_on(log, scan_ns)


def test_stamps_that_go_back_several_times(tmp_path: Path) -> None:
    log = of_stamps(tmp_path, (12.02, 1.3), (25.02, 600.0))
    assert log.clock_set_back == 2
    assert_goes_on(log)


def test_stamps_of_another_clock_are_not_moved(tmp_path: Path) -> None:
    """Those of a lidar that has a computer of its own."""
    messages = drive(right, scan_stamps=set_back((20.02, 5.0)))
    log = logged(write_mcap(tmp_path / "a.mcap", messages))
    assert log.clock_set_back == 1
    assert_goes_on(log)

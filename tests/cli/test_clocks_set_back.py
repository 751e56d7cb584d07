"""Bags whose clock was set back while they were recorded: all goes on from there, in order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from mazebot.cli.logs.log import Log
from mazebot.cli.replay.reading.find import open_recording
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import SCAN
from tests.cli import ros1
from tests.cli.test_bag_shapes import (
    BEGUN_NS,
    HUMBLE,
    LASER,
    MOVED,
    Logged,
    logged,
    write_mcap,
    write_rosbag2,
)

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
        true_s = one.odom_from_base.x_m if one.odom_from_base else 0.0
        if one.scan:
            true_s = float(one.scan.ranges_m[0])
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


def as_mcap(path: Path, messages: Sequence[Logged]) -> Path:
    return write_mcap(path.with_suffix(".mcap"), messages, chunk_size=10_000)


def as_db3(path: Path, messages: Sequence[Logged]) -> Path:
    return write_rosbag2(path, messages, StoragePlugin.SQLITE3)


def as_several_files(path: Path, messages: Sequence[Logged]) -> Path:
    """As a recorder splits them, the first with the time at which the clock was set back."""
    cut = 2 * len(messages) // 3
    bag = write_rosbag2(path, messages[:cut], StoragePlugin.MCAP)
    (first,) = bag.glob("*.mcap")
    write_mcap(bag / "a_second.mcap", messages[cut:])
    about = bag / "metadata.yaml"
    files = f"- {first.name}\n  - a_second.mcap"
    about.write_text(about.read_text().replace(f"- {first.name}", files, 1))
    return bag


def as_ros_1(path: Path, messages: Sequence[Logged]) -> Path:
    drive = []
    for topic, kind, log_ns, data in messages:
        told: Any = HUMBLE.deserialize_cdr(data, kind)
        stamp_ns = msg.ns_from_time(told.header.stamp)
        if topic == "/scan":
            message = ros1.scan(stamp_ns, told.ranges)[2]
            message.range_max = 99.0
        else:
            message = ros1.odometry(stamp_ns, told.pose.pose.position.x)[2]
        drive.append((topic, log_ns, message))
    return ros1.write(path.with_suffix(".bag"), drive, chunk=10_000)


KINDS = [as_mcap, as_db3, as_several_files, as_ros_1]


@pytest.mark.parametrize("write", KINDS)
@pytest.mark.parametrize("by_s", [1.5, 12.0, 3600.0])
def test_a_robot_that_records_itself_and_whose_clock_is_set_back(
    tmp_path: Path, write: Callable[[Path, Sequence[Logged]], Path], by_s: float
) -> None:
    clock = set_back((20.02, by_s))
    log = logged(write(tmp_path / "a", drive(clock, clock)))
    assert log.clock_set_back == 1
    assert_goes_on(log)


@pytest.mark.parametrize("write", KINDS)
def test_a_replay_goes_on_with_its_time_and_its_stamps(
    tmp_path: Path, write: Callable[[Path, Sequence[Logged]], Path]
) -> None:
    clock = set_back((20.02, 12.0))
    recording = open_recording(tmp_path, write(tmp_path / "a", drive(clock, clock)).name)
    scans = 0
    for one in recording.read():
        if one.topic is SCAN:
            scans += 1
            scan = wire.decode(SCAN, one.data)
            true_ns = float(scan.ranges[0]) * SECOND_NS
            assert abs(one.time_ns - true_ns) < NEAR_NS
            assert abs(msg.ns_from_time(scan.header.stamp) - true_ns) < NEAR_NS
    assert scans == LENGTH_NS // SECOND_NS
    assert recording.clock_set_back == 1
    assert recording.end_ns == pytest.approx(LENGTH_NS, abs=SECOND_NS)


@pytest.mark.parametrize("write", KINDS)
def test_messages_in_any_order_of_writing_are_of_no_clock_that_was_set_back(
    tmp_path: Path, write: Callable[[Path, Sequence[Logged]], Path]
) -> None:
    messages = drive(right)
    fifth = len(messages) // 5
    parts = [messages[i * fifth : (i + 1) * fifth] for i in (4, 0, 2, 1, 3)]
    by_topic = sorted(messages, key=lambda one: one[0])
    for number, order in enumerate(([one for part in parts for one in part], by_topic)):
        log = logged(write(tmp_path / str(number), order))
        assert log.clock_set_back == 0
        assert_goes_on(log)

"""Bags of ROS 1, which most public logs of robots are."""

from __future__ import annotations

import bz2
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mazebot.cli.bags.bag import opened, problem_of
from mazebot.cli.logs.log import ScanForm, Topics
from mazebot.cli.logs.read import read_log
from mazebot.cli.replay.reading.find import open_recording
from mazebot.cli.replay.reading.replayed import in_time
from mazebot.common.files.limits import MAX_CHUNK_BYTES
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import SCAN
from tests.cli import ros1
from tests.cli.test_app import mazebot
from tests.cli.test_logs import refused, steps_of


@pytest.mark.parametrize("packed", ["", "bz2", "lz4"])
def test_scans_and_odometry_are_those_that_were_recorded(tmp_path: Path, packed: str) -> None:
    bag = ros1.write(tmp_path / "drive.bag", ros1.drive(range(8)), packed, chunk=2000)
    log = read_log(bag, ScanForm())
    assert steps_of(log) == [*range(8)]
    ways = [one.odom_from_base.x_m for one in log.entries if one.odom_from_base]
    assert ways == pytest.approx([0.5 * step for step in range(8)])
    first = next(one for one in log.entries if one.scan)
    assert first.stamp_ns == 10**9 + 10
    assert first.scan is not None
    assert (first.scan.frame_id, len(first.scan.ranges_m)) == ("laser", ros1.BEAMS)
    assert (first.scan.range_min_m, first.scan.range_max_m) == pytest.approx((0.1, 9.0))


def test_odometry_and_where_the_lidar_is_come_from_tf(tmp_path: Path) -> None:
    messages = []
    for step in range(5):
        time_ns = 10**9 * (step + 1)
        messages += [
            ros1.transform(time_ns, "/map", "/odom", 3.0),
            ros1.transform(time_ns, "/odom", "/base_link", 0.5 * step),
            # Where nothing is latched, it comes again and again.
            ros1.transform(time_ns, "/base_link", "/laser", 0.2),
            ros1.scan(time_ns + 10, [1.0] * 5),
        ]
    log = read_log(ros1.write(tmp_path / "drive.bag", messages), ScanForm())
    ways = [one.odom_from_base.x_m for one in log.entries if one.odom_from_base]
    assert ways == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])
    lidars = {one.scan.base_from_scan for one in log.entries if one.scan}
    assert [lidar and lidar.x_m for lidar in lidars] == pytest.approx([0.2])


def test_a_map_is_made_of_a_bag(tmp_path: Path) -> None:
    bag = ros1.write(tmp_path / "drive.bag", ros1.drive(range(6)))
    done = mazebot("map", "build", "--log", str(bag), "--out", str(tmp_path / "map"), "--json")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "map" / "map.yaml").is_file()
    assert json.loads(done.stdout)["scans"] == 6


@pytest.mark.parametrize("has_definitions", [True, False])
def test_an_mcap_file_of_ros_1_is_read_as_its_bag(tmp_path: Path, has_definitions: bool) -> None:
    messages = [
        *ros1.drive(range(8)),
        *(ros1.transform(10**9 * (i + 1), "/odom", "/base_footprint", 0.5 * i) for i in range(8)),
    ]
    bag = ros1.write(tmp_path / "drive.bag", messages)
    packed = ros1.write_mcap(tmp_path / "drive.mcap", messages, has_definitions)
    log, right = (read_log(path, ScanForm()) for path in (packed, bag))
    assert steps_of(log) == [*range(8)]
    assert [one.odom_from_base for one in log.entries] == [
        one.odom_from_base for one in right.entries
    ]
    told = [
        [(one.topic.name, one.time_ns, one.data) for one in open_recording(tmp_path, name).read()]
        for name in ("drive.mcap", "drive.bag")
    ]
    assert told[0] == told[1]
    assert sum(name == "/scan" for name, _, _ in told[0]) == 8


@pytest.mark.parametrize("write", [ros1.write, ros1.write_mcap])
def test_what_fits_is_replayed_and_the_rest_is_named(
    tmp_path: Path, write: Callable[[Path, list[ros1.Message]], Path]
) -> None:
    log = ros1.STORE.types["rosgraph_msgs/msg/Log"](
        ros1.header(10**9, ""), 2, "/move_base", "Got new plan", "", "", 0, ["/rosout"]
    )
    write(tmp_path / "drive.x", [*ros1.drive(range(4)), ("/rosout", 5 * 10**9, log)])
    recording = open_recording(tmp_path, "drive.x")
    replayed = [one for one in in_time(recording.read()) if one.topic is SCAN]
    assert [wire.decode(SCAN, one.data).ranges[0] for one in replayed] == [0.0, 1.0, 2.0, 3.0]
    assert recording.left_out == {
        "/rosout": "is rosgraph_msgs/msg/Log as it was in ROS 1: must have the fields that it has "
        "today"
    }


def test_names_in_another_case_are_the_same_message(tmp_path: Path) -> None:
    types = ros1.STORE.types
    info = types["sensor_msgs/msg/CameraInfo"](
        ros1.header(10**9, "camera"), 480, 640, "plumb_bob", np.zeros(5), np.arange(9.0),
        np.eye(3).ravel(), np.zeros(12), 0, 0,
        types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
    )  # fmt: skip
    bag = ros1.write(tmp_path / "camera.bag", [("/camera/color/camera_info", 10**9, info)])
    with opened(bag, "test") as found:
        (connection,) = found.connections
        assert not problem_of(connection)
        ((_, _, data),) = found.messages()
    decoded = msg.TYPESTORE.deserialize_cdr(data, connection.msgtype)
    assert (decoded.width, list(decoded.k)) == (640, [*range(9)])  # type: ignore[attr-defined]


@pytest.mark.parametrize("packed", ["", "bz2", "lz4"])
def test_a_cut_bag_is_read_as_far_as_it_goes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], packed: str
) -> None:
    whole = ros1.write(tmp_path / "whole.bag", ros1.drive(range(40)), packed, chunk=4000)
    data = whole.read_bytes()
    cut = tmp_path / "cut.bag"
    counts = []
    for share in (0.5, 0.7, 0.9):
        cut.write_bytes(data[: int(share * len(data))])
        steps = steps_of(read_log(cut, ScanForm()))
        assert steps == [*range(len(steps))]
        counts.append(len(steps))
        assert f"{cut}: is cut: read as far as it goes" in capsys.readouterr().err
    assert 0 < counts[0] <= counts[1] <= counts[2] <= 40


def test_a_bag_that_was_never_closed_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = ros1.write(tmp_path / "drive.bag", ros1.drive(range(8)), chunk=2000)
    data = bag.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    (index,) = struct.unpack_from("<Q", data, at)
    # As `rosbag record` leaves it when it is killed, and a machine that crashed.
    active = tmp_path / "drive.bag.active"
    active.write_bytes(data[:at] + bytes(8) + data[at + 8 : index] + bytes(100))
    assert steps_of(read_log(active, ScanForm())) == [*range(8)]
    assert "is cut: read as far as it goes" in capsys.readouterr().err


def test_a_damaged_index_costs_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = ros1.write(tmp_path / "drive.bag", ros1.drive(range(8)), chunk=2000)
    data = bag.read_bytes()
    for name, other in ((b"end_time=", b"end_date="), (b"chunk_count=", b"chunk_tally=")):
        data = data.replace(name, other)
    bag.write_bytes(data)
    assert steps_of(read_log(bag, ScanForm())) == [*range(8)]
    assert "read as far as it goes" in capsys.readouterr().err


def test_a_chunk_larger_than_may_be_is_not_even_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = ros1.write(tmp_path / "drive.bag", ros1.drive(range(3)), chunk=2000)
    head = b"".join(
        struct.pack("<I", len(field)) + field
        for field in (b"op=\x05", b"compression=none", b"size=\0\0\0\0")
    )
    size = MAX_CHUNK_BYTES + 1
    with bag.open("r+b") as file:
        file.seek(0, 2)
        file.write(struct.pack("<I", len(head)) + head + struct.pack("<I", size))
        # A sparse file: it takes no room.
        file.truncate(file.tell() + size)
    assert steps_of(read_log(bag, ScanForm())) == [*range(3)]
    told = capsys.readouterr().err
    assert f"has {size} bytes, must have at most {MAX_CHUNK_BYTES}" in told


def test_a_damaged_chunk_is_left_out_and_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = ros1.write(tmp_path / "drive.bag", ros1.drive(range(12)), "bz2", chunk=2000)
    data = bytearray(bag.read_bytes())
    at = data.index(b"BZh", data.index(b"BZh") + 3)
    data[at + 20 : at + 40] = bytes(20)
    bag.write_bytes(data)
    steps = steps_of(read_log(bag, ScanForm()))
    assert 0 < len(steps) < 12
    assert "left out: drive.bag: 1 corrupt chunk" in capsys.readouterr().err


def packed_bomb(tmp_path: Path, declared: int | None) -> Path:
    """A bag whose first chunk, of one message of odometry, is exchanged for a bomb."""
    bag = ros1.write(tmp_path / "drive.bag", ros1.drive(range(4)), "bz2", chunk=100)
    data = bag.read_bytes()
    bomb = bz2.compress(bytes(4_000_000))
    at = data.index(b"BZh")
    (size,) = struct.unpack_from("<I", data, at - 4)
    head = data[: at - 4]
    if declared is not None:
        place = head.rindex(b"size=") + len(b"size=")
        head = head[:place] + struct.pack("<I", declared) + head[place + 4 :]
    bag.write_bytes(head + struct.pack("<I", len(bomb)) + bomb + data[at + size :])
    return bag


def test_a_chunk_that_grows_beyond_what_it_says_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = read_log(packed_bomb(tmp_path, None), ScanForm())
    assert len([one for one in log.entries if one.odom_from_base]) == 3
    assert len(steps_of(log)) == 4
    assert "1 corrupt chunk, one of which has more than" in capsys.readouterr().err


def test_a_bag_that_grows_without_end_is_refused(tmp_path: Path) -> None:
    said = refused(packed_bomb(tmp_path, 0xFFFFFFFF))
    assert "is not a readable bag: must unpack to at most" in said


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"#ROSBAG V1.2\n", "is not a readable bag: must be of format 2.0"),
        (b"#ROSBAG V2.0\n", "/scan, nor on another topic: it has none"),
        (b"#ROSBAG V2.0\n" + b"\xff" * 100, "/scan, nor on another topic: it has none"),
        (b"", "is empty: must be a bag"),
    ],
)
def test_what_is_no_such_bag_is_one_line(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "some.bag"
    path.write_bytes(content)
    assert said in refused(path)


def test_a_topic_of_another_name_is_named(tmp_path: Path) -> None:
    messages = [("/base_scan", *one[1:]) if one[0] == "/scan" else one for one in ros1.drive([0])]
    bag = ros1.write(tmp_path / "drive.bag", messages)
    assert "--scan-topic must be one of its /base_scan" in refused(bag)
    assert steps_of(read_log(bag, ScanForm(), Topics(scan="/base_scan"))) == [0.0]


def test_a_damaged_message_is_told(tmp_path: Path) -> None:
    bag = ros1.write(tmp_path / "drive.bag", ros1.drive(range(3)))
    data = bytearray(bag.read_bytes())
    # The length of the last scan's ranges.
    at = data.rindex(struct.pack("<If", ros1.BEAMS, 2.0))
    data[at : at + 4] = b"\xff" * 4
    bag.write_bytes(data)
    assert "a message on /scan is corrupt" in refused(bag)

"""Bags that other robots' nodes have recorded."""

from __future__ import annotations

import json
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from mazebot.cli.replay.reading.bag_messages import open_bag
from mazebot.cli.replay.reading.find import open_recording
from mazebot.cli.replay.reading.replayed import Replayed, in_time
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import (
    CLOCK,
    ENTITIES,
    LOCALIZATION_STATUS,
    ODOM,
    SCAN,
    TF,
    WORLD,
    Topic,
)
from mazebot.common.recordings.mcap.mcap_channels import definition_of
from tests.cli.replay import runs
from tests.cli.test_app import mazebot
from tests.common.samples import SAMPLES

_FORMATS = (StoragePlugin.MCAP, StoragePlugin.SQLITE3)


@pytest.fixture(scope="module")
def messages(run_folder: Path) -> list[Replayed]:
    return runs.messages_of(run_folder)


@pytest.mark.parametrize("storage", _FORMATS, ids=lambda one: one.name)
@pytest.mark.parametrize("clock", [False, True])
def test_what_fits_is_replayed_with_stamps_from_zero_and_the_rest_is_named(
    messages: list[Replayed], tmp_path: Path, storage: StoragePlugin, clock: bool
) -> None:
    bag = runs.write_bag(tmp_path / "bag", messages, storage, clock)
    recording = open_recording(tmp_path, "bag")
    replayed = list(in_time(recording.read()))
    counts = Counter(one.topic.name for one in replayed)
    written = Counter(one.topic.name for one in messages)
    for name in ("/scan", "/odom", "/tf", "/tf_static", "/map"):
        assert counts[name] == written[name], name
    assert counts["/world"] == 1
    assert recording.left_out == {
        "/dock/battery_state": "not a topic of Mazebot",
        "/cmd_vel": "is geometry_msgs/msg/Twist: must be geometry_msgs/msg/TwistStamped",
    }
    assert not recording.unfit
    # No measurement is of later than now, and none is old.
    for one in replayed:
        if one.topic in (SCAN, ODOM):
            message = wire.decode(one.topic, one.data)
            age_ns = one.time_ns - msg.ns_from_time(message.header.stamp)
            assert 0 <= age_ns <= (100_000_000 if clock else 5_000_000)
    ticks = [one.time_ns for one in replayed if one.topic is CLOCK]
    assert ticks == sorted(ticks)
    assert len(ticks) >= counts["/odom"]
    assert recording.end_ns >= replayed[-1].time_ns
    (world,) = [one for one in replayed if one.topic.name == "/world"]
    assert wire.decode(WORLD, world.data).walls == ()
    corrections = [one for one in replayed if one.topic is TF and one.service == "localization"]
    assert 0 < len(corrections) < counts["/tf"]
    done = mazebot("replay", str(bag), "--service", "localization", "--json")
    told = {row["topic"]: row["replayed"] for row in json.loads(done.stdout)["topics"]}
    assert done.returncode == 1
    assert told["/amcl_pose"] >= 18


def test_a_single_file_of_a_bag_makes_a_map(messages: list[Replayed], tmp_path: Path) -> None:
    bag = runs.write_bag(tmp_path / "bag", messages, StoragePlugin.SQLITE3)
    done = mazebot("replay", str(bag / "bag.db3"), "--service", "mapping", "--json")
    told = {row["topic"]: row["replayed"] for row in json.loads(done.stdout)["topics"]}
    assert told["/map"] >= 1
    assert told["/amcl_pose"] >= 18


def test_definitions_of_another_distribution_fit_or_are_named(
    messages: list[Replayed], tmp_path: Path
) -> None:
    header = "std_msgs/Header header\n"
    stamps = (
        "\n" + "=" * 80 + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        + "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )  # fmt: skip
    numbers = "".join(
        f"float32 {name}\n"
        for name in ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time",
                     "range_min", "range_max")
    )  # fmt: skip
    lists = "float32[] ranges\nfloat32[] intensities\n"
    texts = {
        "same": header + numbers + lists + stamps,
        "more": header + numbers + lists + "uint8 quality\n" + stamps,
        "less": header + numbers + "float32[] ranges\n" + stamps,
        "other": header + numbers + lists.replace("32[] r", "64[] r") + stamps,
    }
    told = {}
    for name, text in texts.items():
        definitions = {"sensor_msgs/msg/LaserScan": text}
        runs.write_bag(tmp_path / name, messages[:400], StoragePlugin.MCAP, definitions=definitions)
        recording = open_recording(tmp_path, name)
        scans = sum(one.topic is SCAN for one in recording.read())
        told[name] = (scans, recording.left_out.get("/scan", ""), dict(recording.unfit))
    written = sum(one.topic is SCAN for one in messages[:400])
    assert told["same"] == (written, "", {})
    # Written here without the field that its definition has.
    assert told["more"][1] == ""
    assert sum(told["more"][2].values()) + told["more"][0] == written
    assert "no field 'intensities'" in told["less"][1]
    assert "another type of 'ranges'" in told["other"][1]


def test_damaged_messages_are_counted_and_skipped(messages: list[Replayed], tmp_path: Path) -> None:
    def spoilt(message: Replayed) -> Replayed:
        if message.topic is not ODOM or message.envelope.sequence % 10:
            return message
        odom = wire.decode(ODOM, message.data)
        odom.pose.pose.orientation.w = 7.0
        return message._replace(data=wire.encode(ODOM, odom))

    runs.write_bag(tmp_path / "bag", map(spoilt, messages), StoragePlugin.MCAP)
    done = mazebot("replay", str(tmp_path / "bag"), "--service", "localization")
    assert "left out: /odom: 7 messages: quaternion not normalized" in done.stdout


def test_what_was_logged_later_than_a_stamp_can_tell_is_left_out(
    messages: list[Replayed], tmp_path: Path
) -> None:
    late = next(one for one in messages if one.topic is ODOM)._replace(time_ns=2**62)
    bag = runs.write_bag(tmp_path / "bag", [*messages, late], StoragePlugin.MCAP)
    done = mazebot("replay", str(bag), "--service", "localization")
    assert "left out: /odom: 1 message: log time later than ROS can tell" in done.stdout


@pytest.mark.parametrize("form", ["today", "one field more", "json"])
def test_documents_of_another_version_are_read(tmp_path: Path, form: str) -> None:
    topics: tuple[Topic[Any], ...] = (LOCALIZATION_STATUS, ENTITIES)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic in topics:
            kind = msg.String.__msgtype__ if form == "json" else wire.type_name(topic)
            data = (wire.encode_json if form == "json" else partial(wire.encode, topic))(
                SAMPLES[topic]
            )
            text = definition_of(kind)
            if form == "one field more":
                own, line, others = text.partition("=" * 80)
                text, data = f"{own}bool newest\n{line}{others}", data + b"\1"
            channel = writer.add_connection(topic.name, kind, msgdef=text, rihs01="none")
            writer.write(channel, runs.BEGUN_NS, data)
    recording = open_recording(tmp_path, "bag")
    read = [one for one in recording.read() if one.topic in topics]
    assert (recording.left_out, recording.unfit) == ({}, {})
    assert [one.topic for one in read] == list(topics)
    for one in read:
        assert wire.decode(one.topic, one.data) == SAMPLES[one.topic]


def test_what_follows_a_clock_that_was_set_back_is_replayed_after_it(
    messages: list[Replayed], tmp_path: Path
) -> None:
    poses = []
    for name, set_back_ns in (("whole", None), ("reset", messages[-1].time_ns // 2)):
        bag = runs.write_bag(
            tmp_path / name, messages, StoragePlugin.MCAP, clock=True, set_back_ns=set_back_ns
        )
        done = mazebot("replay", str(bag), "--service", "localization", "--json")
        told = json.loads(done.stdout)
        poses.append({row["topic"]: row["replayed"] for row in told["topics"]}["/amcl_pose"])
        assert told["rejected"] == []
        said = "the clock was set back once: what follows goes on from there"
        assert (said in told["left_out"]) == (set_back_ns is not None)
    assert abs(poses[0] - poses[1]) <= 2


def test_what_the_service_does_not_take_is_told(messages: list[Replayed], tmp_path: Path) -> None:
    def old(message: Replayed) -> Replayed:
        if message.topic is not SCAN:
            return message
        scan = wire.decode(SCAN, message.data)
        scan.header.stamp = msg.time_from_ns(1)
        return message._replace(data=wire.encode(SCAN, scan))

    bag = runs.write_bag(tmp_path / "bag", map(old, messages), StoragePlugin.MCAP)
    done = mazebot("replay", str(bag), "--service", "mapping")
    assert "rejected by mapping: /scan: " in done.stdout
    assert "without odometry at their time" in done.stdout


def test_the_clock_jumps_over_months_in_which_nothing_comes(
    messages: list[Replayed], tmp_path: Path
) -> None:
    months_ns = 10**16
    last = next(one for one in reversed(messages) if one.topic is ODOM)
    odometry = wire.decode(ODOM, last.data)
    stamp_ns = msg.ns_from_time(odometry.header.stamp) + months_ns
    odometry.header.stamp = msg.time_from_ns(stamp_ns)
    late = last._replace(data=wire.encode(ODOM, odometry), time_ns=last.time_ns + months_ns)
    bag = runs.write_bag(tmp_path / "bag", [*messages, late], StoragePlugin.MCAP)
    count = 0
    for one in open_bag(bag).read():
        count += one.topic is CLOCK
        assert count < 1000
    assert one.topic is ODOM
    assert one.time_ns > months_ns

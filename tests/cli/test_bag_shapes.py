"""Bags of every shape, through all that reads them: read whole, or refused in one line."""

from __future__ import annotations

import functools
import shutil
import sqlite3
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mazebot.cli.logs.log import Log, ScanForm, Topics
from mazebot.cli.logs.read import read_log
from mazebot.cli.replay.reading.find import open_recording
from mazebot.cli.replay.reading.replayed import in_time
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import SCAN, TF
from tests.cli.test_app import mazebot

HUMBLE = get_typestore(Stores.ROS2_HUMBLE)
BEGUN_NS = 1_700_000_000_000_000_000
STEPS = 40
Logged = tuple[str, str, int, bytes]
"""Topic, type, time in ns, CDR."""
LASER, MOVED = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"


def scan(step: int, topic: str = "/scan", kind: str = LASER) -> Logged:
    stamp_ns = BEGUN_NS + step * 100_000_000
    sweep = msg.LaserScan(
        msg.header(stamp_ns, "base_scan"), 0.0, 6.0, 0.1, 0.0, 0.1, 0.1, 9.0,
        np.full(60, 1.0 + step / 100.0, np.float32), np.zeros(0, np.float32),
    )  # fmt: skip
    return topic, kind, stamp_ns + 2_000_000, bytes(HUMBLE.serialize_cdr(sweep, LASER))


def odom(step: int, topic: str = "/odom") -> Logged:
    stamp_ns = BEGUN_NS + step * 100_000_000
    place = msg.PoseWithCovariance(msg.pose_from_se2(SE2(0.01 * step, 0.0, 0.0)), np.zeros(36))
    still = msg.TwistWithCovariance(
        msg.Twist(msg.Vector3(0.0, 0.0, 0.0), msg.Vector3(0.0, 0.0, 0.0)), np.zeros(36)
    )
    moved = msg.Odometry(msg.header(stamp_ns, "odom"), "base_footprint", place, still)
    return topic, MOVED, stamp_ns + 1_000_000, bytes(HUMBLE.serialize_cdr(moved, MOVED))


def transform(step: int, parent: str = "odom", child: str = "base_footprint") -> Logged:
    stamp_ns = BEGUN_NS + step * 100_000_000
    pose = SE2(0.01 * step, 0.0, 0.0)
    message = msg.TFMessage([msg.planar_transform_stamped(stamp_ns, parent, child, pose)])
    return "/tf", TRANSFORMS, stamp_ns, bytes(HUMBLE.serialize_cdr(message, TRANSFORMS))


def drive(*kinds: Callable[[int], Logged]) -> list[Logged]:
    return sorted(
        (kind(step) for step in range(STEPS) for kind in kinds), key=lambda logged: logged[2]
    )


SCAN_AND_ODOM = drive(scan, odom)


def write_mcap(path: Path, messages: Iterable[Logged], profile: str = "ros2", **how: Any) -> Path:
    """A file by the reference writer."""
    with path.open("wb") as file:
        writer = McapWriter(file, **{"chunk_size": 4096, **how})
        writer.start(profile)
        channels: dict[tuple[str, str], int] = {}
        for number, (topic, kind, log_ns, data) in enumerate(messages):
            if (topic, kind) not in channels:
                ours = kind in HUMBLE.fielddefs
                text = HUMBLE.generate_msgdef(kind)[0].encode() if ours else b"{}"
                schema = writer.register_schema(kind, "ros2msg" if ours else "jsonschema", text)
                channels[topic, kind] = writer.register_channel(
                    topic, "cdr" if ours else "json", schema
                )
            writer.add_message(channels[topic, kind], log_ns, data, log_ns, number)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_rosbag2(
    path: Path,
    messages: Iterable[Logged],
    plugin: StoragePlugin,
    packed: CompressionMode | None = None,
    version: Literal[8, 9] = 9,
) -> Path:
    writer = Writer(path, version=version, storage_plugin=plugin)
    if packed is not None:
        writer.set_compression(packed, CompressionFormat.ZSTD)
    with writer:
        channels: dict[str, Any] = {}
        for topic, kind, log_ns, data in messages:
            if topic not in channels:
                channels[topic] = writer.add_connection(topic, kind, typestore=HUMBLE)
            writer.write(channels[topic], log_ns, data)
    return path


def replayed(path: Path) -> Counter[str]:
    """Messages by topic, of which none is older than the one before it."""
    recording = open_recording(path.parent, path.name)
    counts: Counter[str] = Counter()
    last_ns = 0
    for message in in_time(recording.read()):
        assert message.time_ns >= last_ns
        assert message.service in recording.services | {"cli"}, message.topic.name
        last_ns = message.time_ns
        counts[message.topic.name] += 1
    return counts


def logged(path: Path, topics: Topics | None = None) -> Log:
    return read_log(path, ScanForm(), topics)


def ways(log: Log) -> list[float]:
    return [one.odom_from_base.x_m for one in log.entries if one.odom_from_base is not None]


def assert_whole(path: Path) -> None:
    """All scans and odometry are read, in order, by both readers."""
    log = logged(path)
    assert log.scans == STEPS
    assert ways(log) == pytest.approx([0.01 * step for step in range(STEPS)])
    counts = replayed(path)
    assert (counts["/scan"], counts["/odom"]) == (STEPS, STEPS)


def refused(read: Callable[[], object]) -> str:
    with pytest.raises(ConfigError) as error:
        read()
    assert "\n" not in str(error.value)
    return str(error.value)


FORMS: dict[str, dict[str, Any]] = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "plain": {"compression": CompressionType.NONE},
    "without chunks": {"use_chunking": False},
    "without an index": {"index_types": IndexType.NONE},
    "without a summary": {
        "index_types": IndexType.NONE, "repeat_channels": False, "repeat_schemas": False,
        "use_statistics": False, "use_summary_offsets": False,
    },
    "of no profile": {"profile": ""},
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_an_mcap_file_of_any_writer(tmp_path: Path, form: str) -> None:
    assert_whole(write_mcap(tmp_path / "a.mcap", SCAN_AND_ODOM, **FORMS[form]))


@pytest.mark.parametrize("form", ["zstd", "without chunks", "without a summary"])
def test_messages_out_of_order(tmp_path: Path, form: str) -> None:
    """Farther out than a replay sorts by itself."""
    late = [*SCAN_AND_ODOM[60:], *SCAN_AND_ODOM[:60]]
    path = write_mcap(tmp_path / "a.mcap", late, **FORMS[form])
    assert_whole(path)
    scans = [one for one in open_recording(tmp_path, "a.mcap").read() if one.topic is SCAN]
    ranges = [float(wire.decode(SCAN, one.data).ranges[0]) for one in scans]
    assert ranges == sorted(ranges)
    ages_ns = {
        one.time_ns - msg.ns_from_time(wire.decode(SCAN, one.data).header.stamp) for one in scans
    }
    assert max(ages_ns) < 10_000_000


@pytest.mark.parametrize(
    ("plugin", "packed"),
    [
        (plugin, packed)
        for plugin in (StoragePlugin.MCAP, StoragePlugin.SQLITE3)
        for packed in (None, *CompressionMode)
        # SQLite packs no storage.
        if (plugin, packed) != (StoragePlugin.SQLITE3, CompressionMode.STORAGE)
    ],
)
def test_a_folder_of_rosbag2(
    tmp_path: Path, plugin: StoragePlugin, packed: CompressionMode | None
) -> None:
    bag = write_rosbag2(tmp_path / "bag", SCAN_AND_ODOM, plugin, packed, 8)
    assert_whole(bag)
    # One of its files, and then its files alone.
    (file,) = (one for one in bag.iterdir() if one.name != "metadata.yaml")
    assert_whole(file)
    (bag / "metadata.yaml").unlink()
    assert_whole(bag)


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("has_metadata", [False, True])
def test_several_files(tmp_path: Path, plugin: StoragePlugin, has_metadata: bool) -> None:
    """Named so that they sort otherwise than in time, and with a part of each time in both."""
    bag = tmp_path / "bag"
    bag.mkdir()
    parts = {"bag_2": SCAN_AND_ODOM[:30], "bag_10": SCAN_AND_ODOM[30:]}
    names = []
    for name, messages in parts.items():
        for file in write_rosbag2(tmp_path / name, messages, plugin).iterdir():
            if file.name != "metadata.yaml":
                names.append(file.name)
                shutil.move(file, bag / file.name)
    if has_metadata:
        about = (tmp_path / "bag_2" / "metadata.yaml").read_text()
        first = names[0]
        about = about.replace(f"- {first}", f"- {names[1]}\n  - {first}", 1)
        (bag / "metadata.yaml").write_text(about)
        # It is no part of the bag.
        write_mcap(bag / "other.mcap", SCAN_AND_ODOM)
    assert_whole(bag)


def test_files_that_metadata_does_not_name_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_rosbag2(
        tmp_path / "bag", SCAN_AND_ODOM, StoragePlugin.MCAP, CompressionMode.FILE, 8
    )
    (packed,) = bag.glob("*.zstd")
    unpacked = zstandard.ZstdDecompressor().decompressobj().decompress(packed.read_bytes())
    packed.with_suffix("").write_bytes(unpacked)
    assert logged(bag).scans == STEPS
    assert capsys.readouterr().err == ""
    write_mcap(bag / "bag_1.mcap", SCAN_AND_ODOM)
    assert logged(bag).scans == STEPS
    line = "not read: bag_1.mcap: metadata.yaml does not name it"
    assert capsys.readouterr().err == f"warning: --log: {bag}: {line}\n"
    # Without it, nothing is read twice.
    (bag / "bag_1.mcap").unlink()
    (bag / "metadata.yaml").unlink()
    assert logged(bag).scans == STEPS


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("share", [0.3, 0.6, 0.97])
def test_an_mcap_file_that_is_cut(tmp_path: Path, form: str, share: float) -> None:
    whole = write_mcap(tmp_path / "a.mcap", SCAN_AND_ODOM, **FORMS[form]).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: int(share * len(whole))])
    log, counts = logged(cut), replayed(cut)
    assert 0 < log.scans == counts["/scan"] <= STEPS
    assert 0 < len(ways(log)) == counts["/odom"] <= STEPS


def test_what_is_in_a_write_ahead_log_is_read_and_stays_there(tmp_path: Path) -> None:
    """As `ros2 bag record --storage-preset-profile resilient` leaves it where it is killed."""
    bag = write_rosbag2(tmp_path / "bag", SCAN_AND_ODOM, StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    left = tmp_path / "left.db3"
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        rows = database.execute("SELECT * FROM messages WHERE id > 50").fetchall()
        database.execute("DELETE FROM messages WHERE id > 50")
        database.commit()
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        database.executemany(f"INSERT INTO messages VALUES ({','.join('?' * len(rows[0]))})", rows)
        database.commit()
        for ending in ("", "-wal"):
            shutil.copy(f"{file}{ending}", f"{left}{ending}")
    before = {one.name: one.read_bytes() for one in tmp_path.glob("left*")}
    assert_whole(left)
    assert {one.name: one.read_bytes() for one in tmp_path.glob("left*")} == before


def test_other_damage_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for suffix, write in (
        (".mcap", lambda path: write_mcap(path, SCAN_AND_ODOM)),
        (".db3", lambda path: shutil.copy(
            next(write_rosbag2(tmp_path / "s", SCAN_AND_ODOM, StoragePlugin.SQLITE3).glob("*.db3")),
            path,
        )),
    ):  # fmt: skip
        path = tmp_path / f"a{suffix}"
        write(path)
        whole = path.read_bytes()
        for content in (b"", b"no bag", whole[:12], whole[: len(whole) // 2]):
            path.write_bytes(content)
            for read in (logged, replayed):
                if suffix == ".mcap" and len(content) > 12:
                    assert read(path)
                else:
                    assert str(path) in refused(functools.partial(read, path))
    # A chunk in the middle.
    path = write_mcap(tmp_path / "b.mcap", SCAN_AND_ODOM, enable_crcs=True)
    data = bytearray(path.read_bytes())
    at = len(data) // 3
    data[at : at + 200] = bytes(200)
    path.write_bytes(data)
    capsys.readouterr()
    assert 0 < logged(path).scans < STEPS
    assert "left out: b.mcap: 1 corrupt chunk" in capsys.readouterr().err
    recording = open_recording(tmp_path, "b.mcap")
    assert 0 < sum(one.topic is SCAN for one in recording.read()) < STEPS
    assert recording.lines_of_unfit() == ["left out: b.mcap: 1 corrupt chunk"]


def test_transforms_of_the_map_without_a_pose(tmp_path: Path) -> None:
    path = write_mcap(
        tmp_path / "a.mcap", drive(transform, lambda step: transform(step, "map", "odom"), scan)
    )
    recording = open_recording(tmp_path, "a.mcap")
    assert {"localization", "physics"} <= recording.services
    services = Counter(one.service for one in recording.read() if one.topic is TF)
    assert services == {"localization": STEPS, "physics": STEPS}
    assert replayed(path)["/tf"] == 2 * STEPS
    # They are in their places only where they are: another localization may run beside this one.
    write_mcap(tmp_path / "b.mcap", drive(transform, scan))
    assert "localization" not in open_recording(tmp_path, "b.mcap").services


def test_only_some_topics(tmp_path: Path) -> None:
    transforms = write_mcap(tmp_path / "tf.mcap", drive(transform))
    assert replayed(transforms)["/tf"] == STEPS
    assert "has no sensor_msgs/msg/LaserScan on /scan, nor on another topic: it has /tf" in refused(
        lambda: logged(transforms)
    )
    both = write_mcap(tmp_path / "both.mcap", drive(transform, scan))
    assert logged(both).scans == STEPS
    assert len(ways(logged(both))) == STEPS
    scans = write_mcap(tmp_path / "scans.mcap", drive(scan))
    assert replayed(scans)["/scan"] == STEPS
    assert "has no nav_msgs/msg/Odometry on /odom, nor on another topic: it has /scan" in refused(
        lambda: logged(scans)
    )


def test_topics_of_other_names(tmp_path: Path) -> None:
    path = write_mcap(
        tmp_path / "a.mcap",
        drive(lambda step: scan(step, "/front/scan"), lambda step: odom(step, "/wheel/odom")),
    )
    assert logged(path, Topics("/front/scan", "/wheel/odom")).scans == STEPS
    assert "--scan-topic must be one of its /front/scan" in refused(lambda: logged(path))
    assert "--odom-topic must be one of its /wheel/odom" in refused(
        lambda: logged(path, Topics("/front/scan"))
    )
    assert "/front/scan: not a topic of Mazebot" in refused(lambda: replayed(path))


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_topics_without_messages(tmp_path: Path, plugin: StoragePlugin) -> None:
    def bag(name: str, empty: dict[str, str], messages: list[Logged]) -> Path:
        with Writer(tmp_path / name, version=9, storage_plugin=plugin) as writer:
            for topic, kind in empty.items():
                writer.add_connection(topic, kind, typestore=HUMBLE)
            channels: dict[str, Any] = {}
            for topic, kind, log_ns, data in messages:
                if topic not in channels:
                    channels[topic] = writer.add_connection(topic, kind, typestore=HUMBLE)
                writer.write(channels[topic], log_ns, data)
        return tmp_path / name

    path = bag("scan", {"/scan": LASER}, drive(odom))
    assert "/scan is empty: must hold sensor_msgs/msg/LaserScan, and there is no other" in refused(
        lambda: logged(path)
    )
    assert replayed(path)["/odom"] == STEPS
    path = bag("other", {"/scan": LASER}, drive(odom, lambda step: scan(step, "/front")))
    assert "/scan is empty: --scan-topic must be one of its /front" in refused(lambda: logged(path))
    path = bag("odom", {"/odom": MOVED}, drive(transform, scan))
    assert len(ways(logged(path))) == STEPS
    path = bag("all", {"/scan": LASER, "/odom": MOVED}, [])
    assert "/scan is empty" in refused(lambda: logged(path))
    assert "no usable messages: it has none" in refused(lambda: replayed(path))
    path = bag("none", {}, [])
    assert "nor on another topic: it has none" in refused(lambda: logged(path))
    assert "no usable messages: it has none" in refused(lambda: replayed(path))


def test_types_and_encodings_that_nobody_knows(tmp_path: Path) -> None:
    def strange(step: int) -> Logged:
        return "/stats", "some.Protobuf", BEGUN_NS + step * 100_000_000, b"{}"

    path = write_mcap(tmp_path / "a.mcap", drive(scan, odom, strange))
    assert_whole(path)
    assert open_recording(tmp_path, "a.mcap").left_out == {"/stats": "not a topic of Mazebot"}
    path = write_mcap(
        tmp_path / "b.mcap", drive(lambda step: scan(step, kind="foxglove.LaserScan"), odom)
    )
    assert "/scan is foxglove.LaserScan: must be sensor_msgs/msg/LaserScan" in refused(
        lambda: logged(path)
    )
    assert replayed(path)["/odom"] == STEPS
    assert open_recording(tmp_path, "b.mcap").left_out == {
        "/scan": "is encoded as json: must be cdr"
    }


def test_the_commands_take_the_same_files(tmp_path: Path) -> None:
    bag = write_rosbag2(tmp_path / "bag", SCAN_AND_ODOM, StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    done = mazebot("map", "build", "--log", str(file), "--out", str(tmp_path / "map"))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "map.yaml").is_file() or any((tmp_path / "map").iterdir())
    cut = tmp_path / "cut.db3"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    for command in (
        ("map", "build", "--log", str(cut), "--out", str(tmp_path / "no")),
        ("replay", str(cut)),
    ):
        done = mazebot(*command)
        assert done.returncode == 2
        assert done.stderr.splitlines()[-1].count(str(cut)) == 1
        assert "Traceback" not in done.stderr

"""MCAP files as other people's tools read them, and as they are when something went wrong."""

from __future__ import annotations

import resource
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2, QosDurability
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mazebot.cli.bags.mcap_bag import McapBag
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages import wire
from mazebot.common.messages.documents import Document
from mazebot.common.messages.topics import (
    LOCALIZATION_STATUS,
    ROBOT_DESCRIPTION,
    TOPICS,
    WORLD,
    Delivery,
    Topic,
)
from mazebot.common.node.node import Envelope
from mazebot.common.recordings.mcap.mcap_channels import definition_of, qos_profiles_of
from mazebot.common.recordings.mcap.mcap_file import McapFile, Row, repair
from mazebot.common.recordings.mcap.mcap_messages import RecordedMessage, read_messages
from mazebot.common.recordings.mcap.mcap_records import RECORD_HEAD, McapError
from mazebot.common.recordings.mcap.mcap_scan import scan
from tests.common.samples import SAMPLES

ATTACHED = {"config.yaml": ("application/yaml", b"seed: 7\n")}


def begun(path: Path) -> McapFile:
    """A file with a channel for each topic."""
    file = McapFile(path)
    file.add_metadata("mazebot", {"run": "a run"})
    for topic in TOPICS:
        type_name = wire.type_name(topic)
        texts = {
            "source": "ab", "world_hash": "cd", "offered_qos_profiles": qos_profiles_of(topic.name),
        }  # fmt: skip
        file.add_channel(topic.name, type_name, definition_of(type_name), texts)
    return file


def rows(number: int) -> list[Row]:
    """A message on each topic."""
    return [
        (channel, number, number * 10**9 + channel, number * 10**9, wire.encode_in_pieces(topic, m))
        for channel, (topic, m) in enumerate((topic, SAMPLES[topic]) for topic in TOPICS)
    ]


def recorded(numbers: Sequence[int]) -> list[RecordedMessage]:
    """What is read of these rows."""
    return [
        RecordedMessage(
            topic.name,
            wire.type_name(topic),
            wire.encode(topic, SAMPLES[topic]),
            Envelope("ab", number, number * 10**9, "cd"),
            number * 10**9 + channel,
        )
        for number in numbers
        for channel, topic in enumerate(TOPICS)
    ]


def test_documents_recorded_as_json_are_read_as_messages_of_today(tmp_path: Path) -> None:
    file = McapFile(tmp_path / "run.mcap")
    kind = msg.String.__msgtype__
    own = [topic for topic in TOPICS if issubclass(topic.type, Document)]
    topics: list[Topic[Any]] = [*own, ROBOT_DESCRIPTION, WORLD]
    for number, topic in enumerate(topics):
        name = topic.name
        file.add_channel(name, kind, definition_of(kind), {"source": "ab", "world_hash": "cd"})
        message = SAMPLES[topic]
        data = wire.encode_json(message) if topic in own else wire.encode(topic, message)
        # The last one is none of the topic's documents.
        data = wire.encode(ROBOT_DESCRIPTION, msg.String("{}")) if number > len(own) else data
        file.add_messages([(number, 0, 0, 0, (data,))])
    file.close({})
    *read, described, damaged = read_messages([tmp_path / "run.mcap"])
    for topic, found in zip(own, read, strict=True):
        assert (found.topic, found.type_name) == (topic.name, wire.type_name(topic))
        assert wire.decode(topic, found.data) == SAMPLES[topic]
    assert described.type_name == kind
    assert wire.decode(ROBOT_DESCRIPTION, described.data) == SAMPLES[ROBOT_DESCRIPTION]
    assert damaged.type_name == "std_msgs/msg/String of another version (invalid schema)"


def test_documents_of_a_version_with_other_fields_are_read(tmp_path: Path) -> None:
    sample = SAMPLES[LOCALIZATION_STATUS]
    kind = wire.type_name(LOCALIZATION_STATUS)
    older = "string state\nfloat64 quality\nstring reason\nstring mood\n"
    without_state = "float64 quality\n"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(older, kind))
    data = bytes(store.serialize_cdr(store.types[kind]("lost", 0.25, "why", "sad"), kind))
    parts = [tmp_path / "run.mcap", tmp_path / "other.mcap"]
    sent = (data, data[:4] + bytes(8))
    for part, text, content in zip(parts, (older, without_state), sent, strict=True):
        file = McapFile(part)
        file.add_channel(LOCALIZATION_STATUS.name, kind, text, {"source": "ab"})
        file.add_messages([(0, 0, 0, 0, (content,))])
        file.close({})
    read, unfit = read_messages(parts)
    found = wire.decode(LOCALIZATION_STATUS, read.data)
    assert found == type(sample)(state="lost", quality=0.25, reason="why")
    assert unfit.type_name == f"{kind} of another version (invalid schema)"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A whole file with three chunks."""
    file = begun(tmp_path / "run.mcap")
    for number in range(3):
        file.add_messages(rows(number))
    file.close(ATTACHED)
    return tmp_path / "run.mcap"


def test_what_is_written_is_read(path: Path) -> None:
    assert list(read_messages([path])) == recorded(range(3))
    some = list(read_messages([path], {"/scan", "/world"}))
    assert {message.topic for message in some} == {"/scan", "/world"}
    assert len(some) == 6


def test_the_mcap_library_reads_it_with_all_its_checksums(path: Path) -> None:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 3 * len(TOPICS)
        assert set(summary.statistics.channel_message_counts.values()) == {3}
        decoded = list(reader.iter_decoded_messages())
        assert len(decoded) == 3 * len(TOPICS)
        scans = [one.decoded_message for one in decoded if one.channel.topic == "/scan"]
        assert np.array_equal(scans[0].ranges, SAMPLES[table.SCAN].ranges)
        assert [a.data for a in reader.iter_attachments()] == [ATTACHED["config.yaml"][1]]
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [
            ("mazebot", {"run": "a run"})
        ]
        # By its indexes, some messages of some time.
        assert [
            message.sequence
            for _, _, message in reader.iter_messages(
                ["/odom"], starting_at=10**9, ending_before=2 * 10**9
            )
        ] == [1]  # fmt: skip


def test_rosbags_reads_it_with_the_quality_of_service(path: Path) -> None:
    with AnyReader([path]) as reader:
        assert sum(1 for _ in reader.messages()) == 3 * len(TOPICS)
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
        durability = {}
        for connection in reader.connections:
            assert isinstance(connection.ext, ConnectionExtRosbag2)
            (qos,) = connection.ext.offered_qos_profiles
            durability[connection.topic] = qos.durability
    for topic in TOPICS:
        latched = topic.delivery is Delivery.LATCHED
        expected = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
        assert durability[topic.name] is expected, topic.name


@pytest.mark.slow
def test_wherever_a_file_is_cut_off_it_is_repaired_and_all_whole_chunks_are_kept(
    path: Path,
) -> None:
    data = path.read_bytes()
    chunks = scan(path).chunks
    ends = [chunk.offset + chunk.length + chunk.index_length for chunk in chunks]
    cuts = np.random.default_rng(7).integers(9, len(data), 40).tolist()
    for cut in [*cuts, *ends, ends[0] - 1, ends[1] + 1, 9, len(data) - 1]:
        path.write_bytes(data[:cut])
        whole = sum(end <= cut for end in ends)
        before = list(read_messages([path]))
        # A chunk can be read before its indexes are there, which a repair cannot do without.
        assert before[: whole * len(TOPICS)] == recorded(range(whole))
        assert repair(path, ATTACHED)
        assert not repair(path, ATTACHED)
        assert list(read_messages([path])) == recorded(range(whole))
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert sum(1 for _ in reader.iter_messages()) == whole * len(TOPICS)
            assert [a.name for a in reader.iter_attachments()] == ["config.yaml"]


def test_zeros_at_the_end_as_after_a_crash_of_the_machine_are_cut_off(path: Path) -> None:
    end = scan(path).end
    path.write_bytes(path.read_bytes()[:end] + bytes(10_000))
    assert repair(path, {})
    assert list(read_messages([path])) == recorded(range(3))


def test_a_file_is_gone_on_with_whether_it_was_ended_or_not(path: Path) -> None:
    for number in (3, 4):
        file = McapFile(path)
        assert [channel.topic for channel in file.channels] == [topic.name for topic in TOPICS]
        file.add_messages(rows(number))
        file.close(ATTACHED)
    path.write_bytes(path.read_bytes()[: scan(path).end])
    assert not scan(path).is_whole
    file = McapFile(path)
    file.add_messages(rows(5))
    file.close({})
    assert list(read_messages([path])) == recorded(range(6))
    with AnyReader([path]) as reader:
        assert sum(1 for _ in reader.messages()) == 6 * len(TOPICS)


def test_an_empty_file_and_one_without_messages_are_made_whole(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    for data in (b"", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n\x01\x05"):
        path.write_bytes(data)
        assert repair(path, {})
        with path.open("rb") as file:
            summary = make_reader(file, validate_crcs=True).get_summary()
            assert summary is not None
            assert summary.statistics is not None
            assert summary.statistics.message_count == 0


@pytest.mark.parametrize("data", [b"nothing like it", b"\x89MCA", b"#ROSBAG V2.0\n"])
def test_what_is_no_mcap_is_said_in_a_line_and_left_as_it_is(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(data)
    for use in (lambda: list(read_messages([path])), lambda: repair(path, {})):
        with pytest.raises(McapError, match="not an MCAP file") as told:
            use()
        assert "\n" not in str(told.value)
    assert path.read_bytes() == data


def test_a_damaged_chunk_is_told_of(path: Path) -> None:
    data = bytearray(path.read_bytes())
    chunk = scan(path).chunks[1]
    data[chunk.offset + chunk.length // 2] ^= 0xFF
    path.write_bytes(data)
    messages = read_messages([path])
    assert [next(messages) for _ in TOPICS] == recorded([0])
    with pytest.raises(McapError, match=f"corrupt chunk, at byte {chunk.offset}"):
        next(messages)


def test_a_chunk_too_short_to_say_what_it_holds_is_told_of(path: Path) -> None:
    data = path.read_bytes()
    first = scan(path).chunks[0]
    head = data[first.offset : first.offset + RECORD_HEAD.size + 24]
    short = head[:1] + (24).to_bytes(8, "little") + head[RECORD_HEAD.size :]
    path.write_bytes(data[: first.offset] + short + data[first.offset + first.length :])
    with pytest.raises(McapError, match="truncated record"):
        scan(path)
    with pytest.raises(McapError, match="truncated record"):
        McapBag(path)


def test_a_disk_that_refuses_a_chunk_leaves_the_file_as_it_was(path: Path) -> None:
    file = McapFile(path)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (file.size + 100, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            file.add_messages(rows(3))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.stat().st_size == file.size
    file.add_messages(rows(3))
    file.close({})
    assert list(read_messages([path])) == recorded(range(4))


def test_latched_messages_at_the_head_of_a_later_file_are_read_once(tmp_path: Path) -> None:
    first, second = tmp_path / "run.mcap", tmp_path / "run_2.mcap"
    file = begun(first)
    file.add_messages(rows(0))
    file.close({})
    file = begun(second)
    file.add_metadata("repeated", {"/map": "1", "/world": "1"})
    channels = {topic.name: number for number, topic in enumerate(TOPICS)}
    file.add_messages([rows(0)[channels["/map"]], rows(0)[channels["/world"]]])
    file.add_messages(rows(1))
    file.close({})
    assert list(read_messages([first, second])) == recorded([0, 1])
    alone = list(read_messages([second]))
    assert [message.topic for message in alone[:2]] == ["/map", "/world"]
    assert alone[2:] == recorded([1])

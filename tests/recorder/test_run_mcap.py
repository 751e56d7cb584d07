"""`run.mcap` of a run made by hand: what other people's tools find in it."""

from __future__ import annotations

import resource
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages import wire
from mazebot.common.messages.topics import BY_NAME, Delivery
from mazebot.common.node.node import Envelope
from mazebot.common.recordings.catalog import list_recordings, run_at
from mazebot.common.recordings.mcap.mcap_messages import RecordedMessage, read_messages
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.common.recordings.run_folder import MESSAGES, parts_of
from mazebot.recorder.keeping.run import run as run_module
from tests.recorder.synthetic import Bench, driving, opening, room
from tests.recorder.test_node import recorder, summary_of, verify


def messages_of(run: Path) -> list[RecordedMessage]:
    return list(read_messages(parts_of(run, MESSAGES)))


def counts_of(messages: list[RecordedMessage]) -> dict[str, int]:
    """By topic; a compressed picture counts for the whole one."""
    return dict(Counter(message.made_from or message.topic for message in messages))


def counts_in_summary(run: Path, kind: str = "received") -> dict[str, int]:
    topics = summary_of(run)["messages"].items()
    return {topic: counts[kind] for topic, counts in topics if counts[kind]}


def test_every_message_is_there_as_the_summary_counts_them(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    bench.say(driving(world, 2.0))
    bench.node.close()
    (run,) = tmp_path.iterdir()
    verify(run / "run.rrd")
    messages = messages_of(run)
    assert counts_of(messages) == counts_in_summary(run) == counts_in_summary(run, "recorded")
    # What is there before the run stands at its head.
    topics = [message.topic for message in messages]
    head = topics[: topics.index("/scan")]
    assert {"/world/request", "/world/assets", "/world", "/map", "/tf_static"} <= set(head)
    with (run / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        decoded = Counter(
            one.channel.metadata.get("made_from") or one.channel.topic
            for one in reader.iter_decoded_messages()
        )
        assert decoded == counts_of(messages)
        attached = {one.name: one.data for one in reader.iter_attachments()}
        told = {one.name: one.metadata for one in reader.iter_metadata()}
    assert attached["config.yaml"] == (run / "config.yaml").read_bytes()
    assert attached["summary.json"] == (run / "summary.json").read_bytes()
    assert told["foxglove"] == {"deviceName": "mazebot-room", "sessionKey": run.name}
    assert told["mazebot"]["world_hash"] == world.hash
    with AnyReader([run / "run.mcap"]) as bag:
        for connection, _, data in bag.messages():
            bag.deserialize(data, connection.msgtype)
        assert sum(connection.msgcount for connection in bag.connections) == len(messages)


def test_over_a_bus_the_bytes_are_those_of_the_wire(tmp_path: Path) -> None:
    node = recorder(tmp_path)
    bench = Bench(node)
    bench.say(opening(room()))
    image = next(m for _, topic, m in driving(room(), 0.1) if topic is table.CAMERA_IMAGE)
    # Padding is free: whoever encodes anew would write zeros.
    odometry = next(m for _, topic, m in driving(room(), 0.1) if topic is table.ODOM)
    data = bytearray(wire.encode(table.ODOM, odometry))
    data[3] = 7
    bench.inbox.deliver(table.ODOM, bytes(data), Envelope("robot", 5, 2_000, ""))
    bench.inbox.deliver(table.CAMERA_IMAGE, wire.encode(table.CAMERA_IMAGE, image),
                        Envelope("robot", 6, 2_000, ""))  # fmt: skip
    bench.step(100_000_000)
    node.close()
    (run,) = tmp_path.iterdir()
    odom, picture = messages_of(run)[-2:]
    assert odom.data == data
    assert odom.envelope == Envelope("robot", 5, 2_000, "")
    assert picture.topic == "/camera/color/image_raw/compressed"
    assert picture.envelope == Envelope("robot", 6, 2_000, "")


def test_pictures_can_be_recorded_as_they_are(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path, pictures="raw"))
    bench.say(opening(world))
    said = list(driving(world, 0.5))
    bench.say(said)
    bench.node.close()
    (run,) = tmp_path.iterdir()
    messages = messages_of(run)
    images = [m.data for m in messages if m.topic == "/camera/color/image_raw"]
    told = [message for _, topic, message in said if topic is table.CAMERA_IMAGE]
    assert images == [wire.encode(table.CAMERA_IMAGE, image) for image in told]
    assert counts_of(messages) == counts_in_summary(run)
    assert not any(message.made_from for message in messages)


def test_a_picture_that_has_no_jpeg_is_recorded_as_it_is(tmp_path: Path) -> None:
    bench = Bench(recorder(tmp_path))
    bench.say(opening(room()))
    pixels = np.arange(24, dtype=np.uint8)
    image = msg.Image(msg.header(0, "camera"), 2, 3, "bgra8", 0, 12, pixels)
    bench.say([(50_000_000, table.CAMERA_IMAGE, image)])
    bench.node.close()
    (run,) = tmp_path.iterdir()
    (recorded,) = (m for m in messages_of(run) if "camera" in m.topic)
    assert recorded.data == wire.encode(table.CAMERA_IMAGE, image)


def test_the_next_run_begins_with_what_a_late_subscriber_would_get(tmp_path: Path) -> None:
    first, second = room(), room("another")
    bench = Bench(recorder(tmp_path))
    bench.say(opening(first))
    bench.say(driving(first, 1.0))
    bench.say([(1_000_000_000, table.WORLD, second)])
    bench.say(driving(second, 1.0, 1_000_000_000))
    bench.node.close()
    _, run = sorted(tmp_path.iterdir(), key=lambda path: path.name.endswith("another"))
    messages = messages_of(run)
    head = [m for m in messages if m.envelope.sent_ns < 1_000_000_000]
    assert messages[: len(head)] == head
    assert {"/tf_static", "/map", "/world/assets"} <= {message.topic for message in head}
    assert all(BY_NAME[m.topic].delivery is Delivery.LATCHED for m in head)
    worlds = [wire.decode(table.WORLD, m.data).name for m in messages if m.topic == "/world"]
    assert worlds == ["another"]
    # Each run counts its own, and what stands at its head.
    for folder in tmp_path.iterdir():
        assert counts_of(messages_of(folder)) == counts_in_summary(folder)
        assert counts_in_summary(folder) == counts_in_summary(folder, "recorded")
        assert summary_of(folder)["messages"]["/clock"]["sent"] == 30


def test_a_full_disk_costs_only_what_it_has_no_room_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(run_module, "FLUSH_PERIOD_S", 0.0)
    monkeypatch.setattr(run_module, "SPACE_PERIOD_S", 1e9)
    world = room()
    node = recorder(tmp_path, pictures="raw")
    bench = Bench(node)
    bench.say(opening(world))
    bench.say(driving(world, 0.5))
    (run,) = tmp_path.iterdir()
    assert node._run is not None
    node._run.messages.wait()
    before = messages_of(run)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    # As a full disk is to whoever writes: the first byte beyond is refused.
    room_bytes = (run / "run.mcap").stat().st_size + 1000
    resource.setrlimit(resource.RLIMIT_FSIZE, (room_bytes, limit[1]))
    try:
        bench.say(driving(world, 1.0, start_ns=500_000_000))
        assert "run.mcap: File too large" in caplog.text
        assert "disk space for" in str(bench.node.waiting_for())
        bench.say([(1_500_000_000, table.WORLD_STATUS, said_of_world())])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    monkeypatch.setattr(run_module, "SPACE_PERIOD_S", 0.0)
    bench.say(driving(world, 0.5, start_ns=1_500_000_000))
    assert bench.node.waiting_for() is None
    bench.say(driving(world, 0.5, start_ns=2_000_000_000))
    bench.node.close()
    messages = messages_of(run)
    assert messages[: len(before)] == before
    assert scan(run / "run.mcap").is_whole
    assert messages[-1].time_ns > 2_400_000_000
    # What was latched meanwhile is written when there is room.
    assert sum(m.topic == "/world/status" for m in messages) == 2
    assert counts_of(messages) == counts_in_summary(run, "recorded")
    received = sum(counts_in_summary(run).values())
    assert len(messages) < received
    listed = run_at(run)
    assert listed is not None
    assert listed.gap == f"{len(messages)} of {received} messages recorded"


def test_a_disk_that_is_full_from_the_beginning_is_no_run_without_recording(tmp_path: Path) -> None:
    bench = Bench(recorder(tmp_path, min_free_mib=2**30))
    bench.say(opening(room()))
    bench.say(driving(room(), 0.5))
    bench.node.close()
    (run,) = list_recordings(tmp_path)
    assert run.gap == f"0 of {sum(counts_in_summary(run.path).values())} messages recorded"


def said_of_world() -> Any:
    return next(m for _, topic, m in opening(room()) if topic is table.WORLD_STATUS)


def test_of_a_folder_that_is_removed_the_run_goes_on_in_a_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_module, "SPACE_PERIOD_S", 0.0)
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    bench.say(driving(world, 1.0))
    (run,) = tmp_path.iterdir()
    shutil.rmtree(run)
    bench.say(driving(world, 1.0, start_ns=1_000_000_000))
    bench.node.close()
    (run,) = tmp_path.iterdir()
    messages = messages_of(run)
    topics = [message.topic for message in messages]
    assert {"/world", "/map", "/tf_static"} <= set(topics[: topics.index("/scan")])
    assert messages[-1].time_ns > 1_900_000_000


def test_of_two_recorders_each_has_a_folder(tmp_path: Path) -> None:
    world = room()
    benches = [Bench(recorder(tmp_path)) for _ in range(2)]
    for said in (opening(world), list(driving(world, 1.0))):
        for bench in benches:
            bench.say(said)
    for bench in benches:
        bench.node.close()
    runs = sorted(tmp_path.iterdir())
    assert len(runs) == 2
    assert messages_of(runs[0]) == messages_of(runs[1])
    for run in runs:
        verify(run / "run.rrd")
        assert scan(run / "run.mcap").is_whole
        assert counts_of(messages_of(run)) == counts_in_summary(run)


def test_without_messages_there_is_no_file(tmp_path: Path) -> None:
    bench = Bench(recorder(tmp_path, messages=False))
    bench.say(opening(room()))
    bench.say(driving(room(), 0.5))
    bench.node.close()
    (run,) = tmp_path.iterdir()
    assert not (run / "run.mcap").exists()
    assert counts_in_summary(run, "recorded") == {}
    verify(run / "run.rrd")

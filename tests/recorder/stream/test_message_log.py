"""`run.mcap` while it is written: large files, slow and full disks, pictures."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages import wire
from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Envelope
from mazebot.common.recordings.mcap.mcap_file import McapFile
from mazebot.common.recordings.mcap.mcap_messages import read_messages
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.common.recordings.run_folder import MESSAGES, part_path, parts_of
from mazebot.recorder.stream import message_log as module
from mazebot.recorder.stream.file_writer import RecordingError
from mazebot.recorder.stream.latched import Latched
from mazebot.recorder.stream.message_log import Compressed, MessageLog, Taken
from mazebot.recorder.stream.pictures import Pictures
from tests.common.samples import SAMPLES


def taken(topic: Topic[Any], number: int, source: str = "a", world: str = "") -> Taken:
    """The number of a message is also its time in ms."""
    message = SAMPLES[topic]
    envelope = Envelope(source, number, number * 10**6, world)
    return Taken(message, envelope, wire.encode_in_pieces(topic, message))


def log_of(folder: Path, part: int = 1, segment_bytes: int = 10**9) -> MessageLog:
    about = {"mazebot": {"run": folder.name}}
    return MessageLog(lambda number: part_path(folder, MESSAGES, number), part, about,
                      segment_bytes)  # fmt: skip


def test_a_large_file_is_followed_by_another_that_can_be_used_by_itself(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("seed: 7\n")
    latched = Latched()
    log = log_of(tmp_path, segment_bytes=3_000)
    for topic in (table.MAP, table.TF_STATIC):
        latched.keep(topic, taken(topic, 0))
        log.add(topic, taken(topic, 0), 0)
    for number in range(1, 300):
        log.add(table.SCAN, taken(table.SCAN, number), 0)
        if number % 10 == 0:
            log.flush(lambda: latched, number * 10**6)
            assert log.wait(10.0)
    log.close()
    parts = parts_of(tmp_path, MESSAGES)
    assert len(parts) > 2
    for part in parts:
        assert scan(part).is_whole
        first = [message.topic for message in read_messages([part])][:2]
        assert first == ["/map", "/tf_static"]
        # Their time is not before the file: a viewer shows them from its beginning.
        times_ns = [message.time_ns for message in read_messages([part])]
        assert times_ns == sorted(times_ns)
    read = list(read_messages(parts))
    assert [m.envelope.sequence for m in read] == [0, 0, *range(1, 300)]
    assert log.recorded() == {"/map": 1, "/tf_static": 1, "/scan": 299}
    again = log_of(tmp_path, part=len(parts))
    again.add(table.SCAN, taken(table.SCAN, 300), 0)
    again.close()
    assert again.recorded() == {"/map": 1, "/tf_static": 1, "/scan": 300}


def test_every_publisher_and_world_has_a_channel_that_names_it(tmp_path: Path) -> None:
    log = log_of(tmp_path)
    log.add(table.CMD_VEL, taken(table.CMD_VEL, 1, "navigation", "cafe"), 0)
    log.add(table.CMD_VEL, taken(table.CMD_VEL, 1, "teleop"), 0)
    log.add(table.CMD_VEL, taken(table.CMD_VEL, 2, "navigation", "cafe"), 0)
    # A script attaches nothing: the time is the recorder's.
    log.add(table.CMD_VEL, Taken(None, Envelope("", 0, 0, ""), (b"\0\1\0\0",)), 5_000_000)
    log.close()
    read = list(read_messages([tmp_path / "run.mcap"]))
    assert [(m.envelope, m.time_ns) for m in read] == [
        (Envelope("navigation", 1, 10**6, "cafe"), 10**6),
        (Envelope("teleop", 1, 10**6, ""), 10**6),
        (Envelope("navigation", 2, 2 * 10**6, "cafe"), 2 * 10**6),
        (Envelope("", 0, 0, ""), 5 * 10**6),
    ]
    assert len(scan(tmp_path / "run.mcap").channels) == 3


def test_messages_stand_in_the_order_in_which_they_were_sent(tmp_path: Path) -> None:
    """The recorder takes them topic by topic, and some are compressed meanwhile."""
    log = log_of(tmp_path)
    late: Future[tuple[wire.Buffer, ...]] = Future()
    name = table.CAMERA_COMPRESSED.name
    compressed = Compressed(name, lambda: late.result(10.0))
    log.add(table.CAMERA_IMAGE, taken(table.CAMERA_IMAGE, 2), 0, compressed)
    for number in (1, 2, 3):
        log.add(table.SCAN, taken(table.SCAN, number), 0)
    log.flush(tuple, 0)
    late.set_result(
        wire.encode_in_pieces(table.CAMERA_COMPRESSED, SAMPLES[table.CAMERA_COMPRESSED])
    )
    log.close()
    read = list(read_messages([tmp_path / "run.mcap"]))
    assert [(m.topic, m.time_ns // 10**6) for m in read] == [
        ("/scan", 1), (name, 2), ("/scan", 2), ("/scan", 3),
    ]  # fmt: skip
    assert [m.made_from for m in read] == ["", "/camera/color/image_raw", "", ""]
    # It counts for the topic of which it is a picture.
    assert log.recorded() == {"/scan": 3, "/camera/color/image_raw": 1}


def test_a_picture_is_compressed_once_for_everybody() -> None:
    pixels = np.zeros((240, 320, 3), np.uint8)
    pixels[:, :160] = (200, 30, 40)
    header = msg.header(5, "camera")
    image = msg.Image(header, 240, 320, "rgb8", 0, 960, pixels.reshape(-1))
    pictures = Pictures(75)
    first = pictures.jpeg(image)
    data = b"".join(pictures.jpeg_message(image)())
    assert pictures.jpeg(image) is first
    pictures.close()
    message = wire.decode(table.CAMERA_COMPRESSED, data)
    assert message.format == "rgb8; jpeg compressed bgr8"
    assert message.header == header
    assert message.data.tobytes() == first.result()
    shown = cv2.imdecode(message.data, cv2.IMREAD_COLOR)
    assert shown is not None
    assert np.abs(shown[120, 40].astype(int) - (40, 30, 200)).max() < 10


@pytest.fixture
def stuck(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """A disk that takes nothing until the returned function is called."""
    goes_on = threading.Event()
    add = McapFile.add_messages

    def add_messages(self: McapFile, rows: Any) -> None:
        goes_on.wait(20.0)
        add(self, rows)

    monkeypatch.setattr(McapFile, "add_messages", add_messages)
    return goes_on.set


def test_a_disk_that_hangs_is_waited_for_a_little_and_then_told_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stuck: Callable[[], None]
) -> None:
    monkeypatch.setattr(module, "MOST_WAITING_BYTES", 10_000)
    monkeypatch.setattr(module, "PATIENCE_S", 0.05)
    monkeypatch.setattr(module, "CLOSE_TIMEOUT_S", 0.05)
    log = log_of(tmp_path)

    def write_on() -> None:
        for number in range(1000):
            log.add(table.SCAN, taken(table.SCAN, number), 0)
            log.flush(tuple, 0)

    with pytest.raises(RecordingError, match="the disk is too slow"):
        write_on()
    with pytest.raises(RecordingError, match="the disk is too slow"):
        log.close()
    stuck()


def test_a_file_that_cannot_be_made_is_told_of(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="No such file or directory"):
        log_of(tmp_path / "gone")
    (tmp_path / "run.mcap").write_text("something else")
    with pytest.raises(RecordingError, match="not an MCAP file"):
        log_of(tmp_path)
    assert (tmp_path / "run.mcap").read_text() == "something else"


def test_of_latched_topics_the_newest_are_kept_of_each_publisher() -> None:
    latched = Latched()
    for number in range(3):
        for source in ("physics", "navigation"):
            latched.keep(table.PARAMETERS, taken(table.PARAMETERS, number, source))
            latched.keep(table.SCAN, taken(table.SCAN, number, source))
    for number in range(300):
        latched.keep(table.ASSETS, taken(table.ASSETS, number))
    latched.keep(table.TF_STATIC, taken(table.TF_STATIC, 0, "physics"))
    latched.keep(table.TF_STATIC, taken(table.TF_STATIC, 0, "physics, started again"))
    kept = [(topic.name, one.envelope.source, one.envelope.sequence) for topic, one in latched]
    assert kept[:2] == [("/parameters", "physics", 2), ("/parameters", "navigation", 2)]
    assert [number for name, _, number in kept if name == "/world/assets"] == [*range(44, 300)]
    # It has one publisher at a time.
    assert kept[-1] == ("/tf_static", "physics, started again", 0)
    assert len(kept) == 2 + 256 + 1

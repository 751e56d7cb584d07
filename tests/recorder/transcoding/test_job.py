"""A run's files, before and after their pictures are a video."""

from __future__ import annotations

import fcntl
import shutil
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rerun.chunk import RrdReader

from mazebot.common.messages import topics as table
from mazebot.common.messages import wire
from mazebot.common.node.node import Envelope
from mazebot.common.recordings.mcap.mcap_messages import RecordedMessage, read_messages
from mazebot.common.recordings.run_folder import LOCK, TO_COMPRESS
from mazebot.recorder.drawing.picture_drawing import CAMERA_ENTITY
from mazebot.recorder.transcoding.as_recorded import as_recorded
from mazebot.recorder.transcoding.background import end, start, waiting
from mazebot.recorder.transcoding.depth import compressed_depth, depth_m_of
from mazebot.recorder.transcoding.job import compress_run
from mazebot.recorder.transcoding.mcap_video import VIDEO_TYPE, read_video
from mazebot.recorder.transcoding.vp9 import VideoError, decode
from tests.common.samples import SAMPLES
from tests.recorder.synthetic import HEIGHT, WIDTH, Bench, Said, driving, opening, room
from tests.recorder.test_node import recorder, verify

SECONDS = 3.0
PATIENCE_S = 60.0
DEPTH = table.DEPTH_IMAGE.name


def with_depth(drive: Iterable[Said]) -> Iterator[Said]:
    """The same with a depth image beside each picture."""
    for now_ns, topic, message in drive:
        yield now_ns, topic, message
        if topic is table.CAMERA_IMAGE:
            depth = SAMPLES[table.DEPTH_IMAGE]
            yield now_ns, table.DEPTH_IMAGE, replace(depth, header=message.header)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an ended run."""
    folder = tmp_path_factory.mktemp("recordings")
    bench = Bench(recorder(folder, video=True))
    bench.say(opening(room()))
    bench.say(with_depth(driving(room(), SECONDS)))
    bench.node.close()
    return next(folder.iterdir())


@pytest.fixture
def run(recorded: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(recorded, tmp_path / "recordings" / recorded.name))


def messages_of(run: Path) -> list[RecordedMessage]:
    return list(read_messages([run / "run.mcap"]))


def columns_of(run: Path, entity: str) -> Counter[str]:
    """Rows of each column that an entity of the recording has."""
    rows: Counter[str] = Counter()
    for chunk in RrdReader(run / "run.rrd").stream():
        if chunk.entity_path == f"/{entity}":
            rows.update(dict.fromkeys(chunk.to_record_batch().schema.names, chunk.num_rows))
    return rows


def test_an_ended_run_waits_to_be_compressed_and_then_no_more(run: Path) -> None:
    assert waiting(run.parent) == [run]
    names = {path.name for path in run.iterdir()}
    done = compress_run(run)
    assert done.files == 2
    assert waiting(run.parent) == []
    assert {path.name for path in run.iterdir()} == names - {TO_COMPRESS}
    again = compress_run(run)
    assert (again.files, again.before_bytes) == (0, done.after_bytes)


def test_every_message_stays_where_it_was(run: Path) -> None:
    before = messages_of(run)
    compress_run(run)
    after = messages_of(run)
    assert len(after) == len(before)
    converted = Counter[str]()
    for old, new in zip(before, after, strict=True):
        assert (new.envelope, new.time_ns) == (old.envelope, old.time_ns)
        if new.type_name != old.type_name:
            converted[new.made_from] += 1
        else:
            assert (new.topic, new.data) == (old.topic, old.data)
    assert converted == dict.fromkeys((table.CAMERA_IMAGE.name, DEPTH), 10 * SECONDS)


def test_a_replay_gets_the_pictures_back(run: Path) -> None:
    before = messages_of(run)
    compress_run(run)
    after = list(as_recorded(messages_of(run), [run / "run.mcap"]))
    assert [one[:2] for one in after] == [one[:2] for one in before]
    assert [one[3:] for one in after] == [one[3:] for one in before]
    for old, new in zip(before, after, strict=True):
        if old.topic == DEPTH:
            continue
        if old.topic != table.CAMERA_COMPRESSED.name:
            assert new.data == old.data
            continue
        was, got = (wire.decode(table.CAMERA_COMPRESSED, one.data) for one in (old, new))
        assert got.header == was.header
        first, second = (cv2.imdecode(one.data, cv2.IMREAD_COLOR) for one in (was, got))
        assert first is not None
        assert second is not None
        assert cv2.PSNR(first, second) > 30.0


def test_other_people_s_readers_decode_every_channel(run: Path) -> None:
    compress_run(run)
    with (run / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        seen = Counter[str]()
        for schema, channel, _, message in reader.iter_decoded_messages():
            assert schema is not None
            seen[channel.topic] += 1
            if schema.name == VIDEO_TYPE:
                assert (message.format, message.frame_id) == ("vp9", "camera_rgb_optical_frame")
        summary = reader.get_summary()
        attached = {attachment.name for attachment in reader.iter_attachments()}
    assert summary is not None
    assert summary.statistics is not None
    assert seen.total() == summary.statistics.message_count
    assert attached == {"config.yaml", "summary.json"}


def test_both_files_hold_the_same_video(run: Path) -> None:
    blueprints = len(RrdReader(run / "run.rrd").blueprints())
    assert columns_of(run, CAMERA_ENTITY)["EncodedImage:blob"]
    other = columns_of(run, "scan")
    compress_run(run)
    verify(run / "run.rrd")
    video = dict(read_video([run / "run.mcap"], table.CAMERA_IMAGE.name))
    rows = columns_of(run, CAMERA_ENTITY)
    assert "EncodedImage:blob" not in rows
    assert rows["VideoStream:sample"] == len(video) == 10 * SECONDS
    assert rows["VideoStream:codec"] == 1
    # The frame of the picture, the layout and everything else are as before.
    assert rows["CoordinateFrame:frame"]
    assert len(RrdReader(run / "run.rrd").blueprints()) == blueprints
    assert columns_of(run, "scan") == other
    picture = next(decode(video.values()))
    above, below = picture[HEIGHT // 4, WIDTH // 2], picture[3 * HEIGHT // 4, WIDTH // 2]
    assert abs(above.astype(int) - (200, 60, 30)).max() < 20
    assert abs(below.astype(int) - (20, 200, 230)).max() < 20


def test_a_recording_without_messages_gets_its_own_video(run: Path) -> None:
    (run / "run.mcap").unlink()
    pictures = columns_of(run, CAMERA_ENTITY)["EncodedImage:blob"]
    assert compress_run(run).files == 1
    verify(run / "run.rrd")
    assert columns_of(run, CAMERA_ENTITY)["VideoStream:sample"] == pictures


def test_a_run_that_goes_on_or_is_compressed_already_is_left_alone(run: Path) -> None:
    (run / LOCK).touch()
    with pytest.raises(VideoError, match="has not ended"):
        compress_run(run)
    assert waiting(run.parent) == []
    (run / LOCK).unlink()
    with (run / TO_COMPRESS).open("a") as marker:
        fcntl.flock(marker, fcntl.LOCK_EX)
        with pytest.raises(VideoError, match="another process"):
            compress_run(run)
    with pytest.raises(VideoError, match="no recording"):
        compress_run(run.parent)


def test_a_damaged_file_stays_as_it_is(run: Path) -> None:
    damaged = (run / "run.rrd").read_bytes()[:1000]
    (run / "run.rrd").write_bytes(damaged)
    with pytest.raises(VideoError):
        compress_run(run)
    assert (run / "run.rrd").read_bytes() == damaged
    # It would fail again.
    assert waiting(run.parent) == []


def test_depths_stay_within_half_a_millimetre() -> None:
    image = SAMPLES[table.DEPTH_IMAGE]
    cdr = compressed_depth(wire.encode(table.DEPTH_IMAGE, image))
    message = wire.decode(table.CAMERA_COMPRESSED, cdr)
    assert message.header == image.header
    depth_m = depth_m_of(message)
    told_m = image.data.view("<f4").reshape(image.height, -1)[:, : image.width]
    assert depth_m.shape == (image.height, image.width)
    topic, envelope = f"{table.DEPTH_IMAGE.name}/compressedDepth", Envelope("physics", 1, 2, "")
    packed = RecordedMessage(topic, "", cdr, envelope, 2, table.DEPTH_IMAGE.name)
    (back,) = as_recorded([packed], [])
    assert wire.decode(table.DEPTH_IMAGE, back.data).header == image.header
    assert (back.topic, back.made_from) == (table.DEPTH_IMAGE.name, "")
    # Nothing in range is no number; in older recordings it is 0.
    assert abs(np.nan_to_num(depth_m) - np.nan_to_num(told_m)).max() <= 0.0005001


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["run.*.mp4", "run.whole_mcap", "run.video", "run.whole"])
def test_killed_at_any_moment_nothing_is_lost(run: Path, moment: str) -> None:
    before = messages_of(run)
    process = start(run)
    end_s = time.monotonic() + PATIENCE_S
    while not list(run.glob(moment)) and process.poll() is None and time.monotonic() < end_s:
        pass
    end(process)
    verify(run / "run.rrd")
    assert len(messages_of(run)) == len(before)
    compress_run(run)
    verify(run / "run.rrd")
    assert [one.envelope for one in messages_of(run)] == [one.envelope for one in before]
    assert columns_of(run, CAMERA_ENTITY)["VideoStream:sample"] == 10 * SECONDS
    assert waiting(run.parent) == []
    assert not list(run.glob("run.*[!d!p]"))

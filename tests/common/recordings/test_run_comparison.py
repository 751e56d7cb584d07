"""Where two runs part: digests made by hand, each with one thing changed."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages import wire
from mazebot.common.messages.topics import TOPICS, Topic
from mazebot.common.node.node import Envelope
from mazebot.common.recordings.comparing.digests import (
    LEFT_OUT,
    DigestError,
    Digests,
    DigestWriter,
    digest_of,
    read_digests,
)
from mazebot.common.recordings.comparing.run_comparison import Comparison, Difference, compare
from tests.common.samples import SAMPLES
from tests.recorder.synthetic import Said, driving, opening, room

Sent = tuple[Topic[Any], Any, Envelope]
S = 1_000_000_000


def sent(said: Iterable[Said], source: str = "physics") -> list[Sent]:
    """As a publisher numbers its messages."""
    numbers: dict[str, int] = {}
    result = []
    for now_ns, topic, message in said:
        number = numbers.get(topic.name, 0)
        numbers[topic.name] = number + 1
        result.append((topic, message, Envelope(source, number, now_ns, "")))
    return result


def digests(path: Path, messages: Iterable[Sent]) -> Digests:
    writer = DigestWriter(path)
    for number, (topic, message, envelope) in enumerate(messages):
        writer.add(topic, wire.encode_in_pieces(topic, message), envelope)
        if number % 100 == 0:
            writer.flush()
    writer.close()
    return read_digests(path)


def message_digest(topic: Topic[Any], message: Any) -> bytes:
    return digest_of(wire.encode_in_pieces(topic, message))


def drive() -> list[Sent]:
    world = room()
    return sent([*opening(world), *driving(world, 5.0)])


@pytest.fixture
def against(tmp_path: Path) -> Callable[[list[Sent]], Comparison]:
    """Hold another run against `drive()`."""
    first = digests(tmp_path / "first", drive())

    def hold(other: list[Sent]) -> Comparison:
        return compare(first, digests(tmp_path / "second", other))

    return hold


def odometry(messages: list[Sent], after_ns: int) -> int:
    """Index of the first odometry from a time on."""
    return next(
        i
        for i, (topic, _, envelope) in enumerate(messages)
        if topic is table.ODOM and envelope.sent_ns >= after_ns
    )


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_a_message_s_digest_is_that_of_all_it_holds(topic: Topic[Any]) -> None:
    message = SAMPLES[topic]
    digest = message_digest(topic, message)
    assert len(digest) == 8
    assert message_digest(topic, copy.deepcopy(message)) == digest
    # Over the wire it is the same, and what arrives is.
    data = wire.encode(topic, message)
    assert digest_of([data]) == digest
    assert message_digest(topic, wire.decode(topic, data)) == digest


def test_a_large_message_has_the_same_digest_in_one_piece_and_in_several() -> None:
    pixels = np.random.default_rng(7).integers(0, 255, 640 * 480 * 3).astype(np.uint8)
    image = msg.Image(msg.header(0, "camera"), 480, 640, "rgb8", 0, 1920, pixels)
    pieces = wire.encode_in_pieces(table.CAMERA_IMAGE, image)
    assert len(pieces) > 1
    digest = digest_of(pieces)
    assert digest == digest_of([wire.encode(table.CAMERA_IMAGE, image)])
    pixels[-1] ^= 1
    assert digest_of(pieces) != digest


def test_one_bit_of_a_picture_one_number_one_letter_make_another_digest() -> None:
    def changed(topic: Topic[Any], change: Callable[[Any], None]) -> bool:
        other = copy.deepcopy(SAMPLES[topic])
        change(other)
        return message_digest(topic, other) != message_digest(topic, SAMPLES[topic])

    def pixel(image: Any) -> None:
        image.data = image.data.copy()
        image.data[-1] ^= 1

    def number(odometry_: Any) -> None:
        position = odometry_.pose.pose.position
        position.x = float(np.nextafter(position.x, 9.0))

    def letter(odometry_: Any) -> None:
        odometry_.header.frame_id += "x"

    def one_more(array: Any) -> None:
        array.detections.append(array.detections[0])

    assert changed(table.CAMERA_IMAGE, pixel)
    assert changed(table.ODOM, number)
    assert changed(table.ODOM, letter)
    assert changed(table.DETECTIONS, one_more)


def test_equal_runs_are_the_same(against: Callable[[list[Sent]], Comparison]) -> None:
    comparison = against(drive())
    left_out = sum(topic in LEFT_OUT for topic, _, _ in drive())
    assert comparison.differences == ()
    assert comparison.messages == len(drive()) - left_out
    assert comparison.lost == (0, 0)


def test_what_names_folders_or_wall_time_makes_no_difference(
    against: Callable[[list[Sent]], Comparison],
) -> None:
    other = [
        (topic, SAMPLES[topic] if topic in LEFT_OUT else message, envelope)
        for topic, message, envelope in drive()
    ]
    assert any(topic in LEFT_OUT for topic, _, _ in other)
    assert against(other).differences == ()


def test_the_first_message_that_differs_is_named(
    against: Callable[[list[Sent]], Comparison],
) -> None:
    other = drive()
    for after_ns in (2 * S, 3 * S):
        at = odometry(other, after_ns)
        other[at] = (table.ODOM, SAMPLES[table.ODOM], other[at][2])
    envelope = other[odometry(other, 2 * S)][2]
    assert against(other).differences == (
        Difference(envelope.sent_ns, "/odom", "physics", envelope.sequence, None),
    )


def test_topics_are_told_in_the_order_in_which_they_part(
    against: Callable[[list[Sent]], Comparison],
) -> None:
    other = [
        (topic, SAMPLES[topic], envelope)
        if (topic is table.SCAN and envelope.sent_ns > 3 * S)
        or (topic is table.IMU and envelope.sent_ns > 2 * S)
        else (topic, message, envelope)
        for topic, message, envelope in drive()
    ]
    assert [one.topic for one in against(other).differences] == ["/imu", "/scan"]


def test_a_message_that_was_never_sent_is_a_difference(
    against: Callable[[list[Sent]], Comparison],
) -> None:
    without = [
        (now_ns, topic, message)
        for now_ns, topic, message in [*opening(room()), *driving(room(), 5.0)]
        if not (topic is table.SCAN and 2 * S < now_ns < 2 * S + 100_000_000)
    ]
    (difference,) = against(sent(without)).differences
    assert (difference.topic, difference.only_in) == ("/scan", 0)


def test_a_message_that_was_lost_on_the_way_is_none(
    against: Callable[[list[Sent]], Comparison],
) -> None:
    other = [one for one in drive() if not (one[0] is table.SCAN and one[2].sequence in (7, 8, 20))]
    comparison = against(other)
    assert comparison.differences == ()
    assert comparison.lost == (0, 3)


def test_a_run_that_ends_earlier_is_the_same_as_far_as_it_goes(
    against: Callable[[list[Sent]], Comparison],
) -> None:
    other = [one for one in drive() if one[2].sent_ns < 3 * S]
    comparison = against(other)
    assert comparison.differences == ()
    assert comparison.ends_ns[0] - comparison.ends_ns[1] == pytest.approx(2 * S, rel=0.02)


def test_a_topic_that_falls_silent_is_a_difference(
    against: Callable[[list[Sent]], Comparison],
) -> None:
    other = [one for one in drive() if not (one[0] is table.IMU and one[2].sent_ns > 2 * S)]
    (difference,) = against(other).differences
    assert (difference.topic, difference.only_in) == ("/imu", 0)


def test_before_time_passes_only_the_last_word_counts(
    against: Callable[[list[Sent]], Comparison],
) -> None:
    extra = (0, table.WORLD_STATUS, SAMPLES[table.WORLD_STATUS])
    other = sent([extra, *opening(room()), *driving(room(), 5.0)])
    assert against(other).differences == ()


def test_publishers_without_names_are_told_apart_by_what_they_say(tmp_path: Path) -> None:
    one, other = drive(), drive()
    mixed = []
    for order in (("aa", "bb"), ("dd", "cc")):
        both = [
            (topic, message, Envelope(source, e.sequence, e.sent_ns, ""))
            for source, messages in zip(order, (one, other), strict=True)
            for topic, message, e in messages
            if topic is not table.TF or source in ("aa", "dd")
        ]
        both.sort(key=lambda sent_: sent_[2].source)
        both.sort(key=lambda sent_: sent_[2].sent_ns)
        mixed.append(digests(tmp_path / order[0], both))
    assert compare(*mixed).differences == ()


def test_a_run_over_a_bus_is_held_against_one_in_one_process(tmp_path: Path) -> None:
    """There publishers have names; two speak on one topic at the same times."""
    frames = msg.TFMessage(transforms=[msg.transform_stamped(0, "a", "b", np.eye(4))])
    times_ns = [now_ns for now_ns, topic, _ in driving(room(), 5.0) if topic is table.TF]
    inside = [*drive(), *sent(((now_ns, table.TF, frames) for now_ns in times_ns), "spawner")]
    inside.sort(key=lambda one: one[2].sent_ns)
    unnamed = {"physics": "ff", "spawner": "ee"}
    over_bus = [
        (topic, message, Envelope(unnamed[e.source], e.sequence, e.sent_ns, ""))
        for topic, message, e in inside
    ]
    one, other = digests(tmp_path / "inside", inside), digests(tmp_path / "bus", over_bus)
    assert compare(one, other).differences == compare(other, one).differences == ()
    assert compare(one, other).messages == len(one.rows)
    still = next(message for topic, message, _ in inside if topic is table.ODOM)
    changed = [
        (topic, still if (topic, e.sequence) == (table.ODOM, 9) else message, e)
        for topic, message, e in over_bus
    ]
    (difference,) = compare(one, digests(tmp_path / "changed", changed)).differences
    assert (difference.topic, difference.source) == ("/odom", "physics")


def test_a_long_run_with_losses_is_compared_in_little_time(tmp_path: Path) -> None:
    import time

    from mazebot.common.recordings.comparing.digests import ROW

    count = 400_000
    rows = np.zeros(count, ROW)
    rows["time_ns"] = np.arange(count) * 8_333_333
    rows["sequence"] = np.arange(count)
    rows["digest"] = np.arange(count)
    names = tuple(topic.name for topic in TOPICS)
    lossy = Digests(names, ("physics",), rows[np.arange(count) % 1000 != 5])
    started_s = time.process_time()
    comparison = compare(Digests(names, ("physics",), rows), lossy)
    assert time.process_time() - started_s < 3.0
    assert comparison.lost == (0, 400)
    assert comparison.messages == count - 400


def test_a_file_cut_short_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    whole = digests(tmp_path / "whole", drive())
    data = (tmp_path / "whole").read_bytes()
    (tmp_path / "cut").write_bytes(data[:-30])
    assert len(read_digests(tmp_path / "cut").rows) == len(whole.rows) - 2


@pytest.mark.parametrize("content", [b"", b"\x00" * 99, b"{}\n", b"[1]\n", b'{"head": "x"}\n'])
def test_what_is_no_file_of_digests_is_refused_in_a_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(DigestError) as told:
        read_digests(tmp_path / "file")
    assert "\n" not in str(told.value)

"""Recorded messages in time, parts of them, and comparing two streams."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mazebot.cli.replay.comparison import Comparison
from mazebot.cli.replay.reading.find import open_recording
from mazebot.cli.replay.reading.replayed import Replayed, between, in_time
from mazebot.common.config import ConfigError
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import CMD_VEL, NAVIGATION_STATUS, SCAN, TF_STATIC, Topic
from mazebot.common.node.node import Envelope

_SECOND_NS = 1_000_000_000


def at(time_s: float, topic: Topic[Any] = SCAN, number: int = 0) -> Replayed:
    time_ns = round(time_s * 1e9)
    return Replayed(topic, b"", "physics", Envelope("physics", number, time_ns, ""), time_ns)


def twist(x_m_s: float) -> bytes:
    command = msg.TwistStamped(
        header=msg.header(0, "base_footprint"),
        twist=msg.Twist(
            linear=msg.Vector3(x=x_m_s, y=0.0, z=0.0), angular=msg.Vector3(x=0.0, y=0.0, z=0.0)
        ),
    )
    return wire.encode(CMD_VEL, command)


def test_messages_are_put_in_time_and_those_of_one_time_keep_their_order() -> None:
    rows = [at(0.3, number=0), at(0.1, number=1), at(0.3, number=2), at(9.0, number=3), at(8.0)]
    times = [(one.time_ns, one.envelope.sequence) for one in in_time(rows)]
    assert times == sorted(times, key=lambda row: row[0])
    assert [number for time_ns, number in times if time_ns == 300_000_000] == [0, 2]


def test_the_order_is_made_within_a_window_and_not_of_the_whole_run() -> None:
    read: list[float] = []

    def rows() -> object:
        for second in range(100):
            read.append(second)
            yield at(second)

    first = next(in_time(rows(), window_ns=3 * _SECOND_NS))  # type: ignore[arg-type]
    assert first.time_ns == 0
    assert len(read) == 5


def test_a_part_begins_with_the_latched_messages_that_held_then() -> None:
    rows = [
        at(0.0, TF_STATIC, 0), at(0.5), at(1.0, TF_STATIC, 1), at(1.5), at(2.0), at(3.0),
    ]  # fmt: skip
    part = list(between(iter(rows), round(1.2e9), round(2.5e9)))
    told = [(one.topic.name, one.envelope.sequence, one.time_ns // 100_000_000) for one in part]
    assert told == [("/tf_static", 1, 12), ("/scan", 0, 15), ("/scan", 0, 20)]


def test_the_newest_run_with_messages_is_called_latest(run_folder: Path, tmp_path: Path) -> None:
    shutil.copytree(run_folder, tmp_path / "2026-01-01_00-00-00_a")
    (tmp_path / "2026-01-02_00-00-00_b").mkdir()
    (tmp_path / "2026-01-02_00-00-00_b" / "summary.json").write_text("{}")
    assert open_recording(tmp_path, "latest").name == "2026-01-01_00-00-00_a"
    with pytest.raises(ConfigError, match=r"no run with run\.mcap"):
        open_recording(tmp_path / "2026-01-02_00-00-00_b", "latest")


def test_streams_are_compared_by_time_whichever_comes_first() -> None:
    comparison = Comparison()
    for time_ns in (0, 50, 100):
        comparison.take_recorded(CMD_VEL, time_ns, twist(0.1))
    comparison.take_replayed(CMD_VEL, 0, twist(0.1))
    comparison.take_replayed(CMD_VEL, 100, twist(0.25))
    comparison.take_replayed(CMD_VEL, 150, twist(0.1))
    comparison.end()
    (row,) = comparison.topics
    assert (row.recorded, row.replayed, row.same) == (3, 3, 1)
    assert row.first is not None
    assert (row.first.time_ns, row.first.only_in, row.first.number) == (50, "recording", 1)
    np.testing.assert_allclose(row.largest["twist.linear.x"], 0.15)
    assert not comparison.is_same


def test_the_first_field_that_differs_is_named_even_in_a_document() -> None:
    comparison = Comparison()
    for take, state in (
        (comparison.take_recorded, "idle"),
        (comparison.take_replayed, "controlling"),
    ):
        status = NAVIGATION_STATUS.type(
            localization_active=True, navigation_active=True, state=state
        )
        take(NAVIGATION_STATUS, 5, wire.encode(NAVIGATION_STATUS, status))
    first = comparison.topics[0].first
    assert first is not None
    assert (first.field, first.recorded, first.replayed) == ("state", "'idle'", "'controlling'")

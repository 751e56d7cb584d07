"""The newest rows of numbers, by their stamps."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from mazebot.recorder.judging.recent_rows import RecentRows


@pytest.mark.parametrize("capacity", [4, 5, 6, 9])
def test_the_newest_rows_are_kept_in_their_order(capacity: int) -> None:
    rows = RecentRows(2, kept=3, capacity=capacity)
    for stamp_ns in range(100):
        rows.add(stamp_ns, (stamp_ns / 2, -stamp_ns))
        newest = np.arange(stamp_ns + 1)[-len(rows.stamps_ns) :]
        assert min(3, stamp_ns + 1) <= len(newest) <= capacity
        assert np.array_equal(rows.stamps_ns, newest)
        assert np.array_equal(rows.rows, np.stack([newest / 2, -newest], axis=1))


def test_rows_are_let_go_of_by_the_one_after_the_last_there_is_room_for() -> None:
    rows = RecentRows(1, kept=1, capacity=2)
    assert not rows.is_full
    for stamp_ns in (1, 2):
        rows.add(stamp_ns, (0.0,))
    assert rows.is_full
    rows.add(3, (0.0,))
    assert rows.stamps_ns.tolist() == [2, 3]


def test_letting_go_of_rows_makes_no_copy_of_those_that_stay() -> None:
    rows = RecentRows(1, kept=10_000, capacity=10_100)
    for stamp_ns in range(10_100):
        rows.add(stamp_ns, (0.0,))
    tracemalloc.start()
    rows.add(10_100, (0.0,))
    taken_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert taken_bytes < 8_000

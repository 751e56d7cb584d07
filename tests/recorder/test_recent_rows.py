"""The newest rows of numbers, by their stamps."""

from __future__ import annotations

import numpy as np

from services.recorder.recent_rows import RecentRows


def test_the_newest_rows_are_kept_in_their_order() -> None:
    rows = RecentRows(2, kept=3, capacity=5)
    for stamp_ns in range(100):
        rows.add(stamp_ns, (stamp_ns / 2, -stamp_ns))
        newest = np.arange(stamp_ns + 1)[-len(rows.stamps_ns) :]
        assert min(3, stamp_ns + 1) <= len(newest) <= 5
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

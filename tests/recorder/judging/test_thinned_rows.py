"""Rows of bounded number."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.recorder.judging.map.thinned_rows import ThinnedRows

SECOND_NS = 1_000_000_000


def filled(count: int, most: int = 100, peaks: str | None = None) -> ThinnedRows:
    rows = ThinnedRows(("value", "other"), SECOND_NS, most, peaks)
    for number in range(count):
        rows.add(number * SECOND_NS, (float(number == count // 3), float(number)))
    return rows


@pytest.mark.parametrize("count", [1, 99, 100, 101, 5_000, 100_000])
def test_there_are_never_more_than_allowed_and_they_span_the_whole_run(count: int) -> None:
    rows = filled(count)
    stamps_s = rows.stamps_ns / SECOND_NS
    assert min(count, 50) <= len(stamps_s) <= 100
    assert stamps_s[0] == 0
    steps_s = np.diff(stamps_s)
    assert len(steps_s) == 0 or steps_s.max() == steps_s.min()
    assert count - 1 - stamps_s[-1] <= (steps_s.max() if len(steps_s) else 0)
    assert rows.column("other").tolist() == stamps_s.tolist()


def test_a_peak_is_never_thinned_out() -> None:
    assert filled(100_000, peaks="value").column("value").max() == 1.0
    assert filled(100_000).column("value").max() == 0.0


def test_of_one_period_the_peak_is_kept() -> None:
    rows = ThinnedRows(("error",), SECOND_NS, 10, peaks="error")
    for stamp_ns, error in ((0, 0.1), (100, 0.3), (200, 0.2), (SECOND_NS, 0.1)):
        rows.add(stamp_ns, (error,))
    assert rows.stamps_ns.tolist() == [100, SECOND_NS]
    assert rows.column("error").tolist() == [0.3, 0.1]


def test_older_rows_are_dropped() -> None:
    rows = ThinnedRows(("value",), SECOND_NS, 10)
    rows.add(5 * SECOND_NS, (1.0,))
    rows.add(3 * SECOND_NS, (2.0,))
    assert rows.column("value").tolist() == [1.0]


def test_a_saved_table_goes_on_as_if_it_had_never_been_saved() -> None:
    whole, first = filled(1_000), filled(600)
    second = ThinnedRows(("value", "other"), SECOND_NS, 100)
    second.restore(first.state())
    for number in range(600, 1_000):
        second.add(number * SECOND_NS, (0.0, float(number)))
    assert second.stamps_ns.tolist() == whole.stamps_ns.tolist()


@pytest.mark.parametrize("change", [{"period_ns": np.array(0)}, {"rows": np.zeros(7)}])
def test_a_table_that_is_none_is_refused(change: dict[str, np.ndarray]) -> None:
    with pytest.raises(ValueError, match=r".+"):
        ThinnedRows(("value", "other"), SECOND_NS, 100).restore(filled(20).state() | change)

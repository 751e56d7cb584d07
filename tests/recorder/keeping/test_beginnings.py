"""Where one run ends and the next begins."""

from mazebot.recorder.keeping.beginnings import Beginnings

S = 1_000_000_000


def test_time_that_goes_on_begins_nothing() -> None:
    beginnings = Beginnings()
    assert not any(beginnings.look(i * S // 10, [i * S // 10]) for i in range(100))
    assert beginnings.now_ns == 99 * S // 10


def test_a_clock_that_goes_back_begins_a_run() -> None:
    beginnings = Beginnings()
    beginnings.look(50 * S, [])
    assert not beginnings.look(50 * S - S // 2, [])  # ticks may come out of order
    assert beginnings.look(S, [])
    assert beginnings.is_before(49 * S)
    assert not beginnings.is_before(S // 2)


def test_the_simulation_s_own_word_begins_a_run_at_once() -> None:
    beginnings = Beginnings()
    beginnings.look(S // 2, [S // 5, 2 * S // 5])
    assert beginnings.look(S // 10, [S // 2, 0])
    assert beginnings.is_before(S // 2)
    assert not beginnings.is_before(S // 10)
    assert not beginnings.look(S // 5, [S // 5])


def test_a_clock_that_lags_behind_begins_no_second_run() -> None:
    beginnings = Beginnings()
    beginnings.look(50 * S, [50 * S])
    assert beginnings.look(50 * S, [0])
    assert beginnings.now_ns == 0
    assert not beginnings.look(50 * S, [])
    assert beginnings.now_ns == 0
    assert not beginnings.look(S // 10, [S // 5])
    assert beginnings.now_ns == S // 10


def test_word_that_lags_behind_the_clock_begins_no_second_run() -> None:
    beginnings = Beginnings()
    beginnings.look(50 * S, [50 * S])
    assert beginnings.look(0, [])
    assert not beginnings.look(S // 10, [0])
    assert not beginnings.look(S // 5, [S // 5])

import pytest

from mazebot.common.bus.pace import MAX_LAG_S, Pace

STEP_NS = 10_000_000


def test_steps_are_due_at_the_speed() -> None:
    pace = Pace()
    assert pace.wait_s(100.0, STEP_NS, 2.0) == 0.0
    assert pace.wait_s(100.0, 2 * STEP_NS, 2.0) == pytest.approx(0.005)
    # Asked again before it is due.
    assert pace.wait_s(100.004, 2 * STEP_NS, 2.0) == pytest.approx(0.001)
    assert pace.wait_s(100.005, 3 * STEP_NS, 2.0) == pytest.approx(0.005)


def test_at_speed_zero_there_is_no_waiting() -> None:
    pace = Pace()
    assert all(pace.wait_s(5.0, step * STEP_NS, 0.0) == 0.0 for step in range(100))


def test_a_little_lag_is_caught_up_with_and_much_is_not() -> None:
    pace = Pace()
    pace.wait_s(0.0, STEP_NS, 1.0)
    assert pace.wait_s(0.05, 2 * STEP_NS, 1.0) == 0.0
    assert pace.wait_s(0.05, 7 * STEP_NS, 1.0) == pytest.approx(0.01)
    assert pace.wait_s(0.06 + 2 * MAX_LAG_S, 8 * STEP_NS, 1.0) == 0.0
    assert pace.wait_s(0.06 + 2 * MAX_LAG_S, 9 * STEP_NS, 1.0) == pytest.approx(0.01)


def test_a_rest_is_not_caught_up_with() -> None:
    pace = Pace()
    pace.wait_s(0.0, STEP_NS, 1.0)
    pace.rest()
    assert pace.wait_s(0.09, 2 * STEP_NS, 1.0) == 0.0
    assert pace.wait_s(0.09, 3 * STEP_NS, 1.0) == pytest.approx(0.01)


@pytest.mark.parametrize("next_ns", [STEP_NS, 50 * STEP_NS])
def test_time_that_goes_back_is_followed_from_where_it_is(next_ns: int) -> None:
    pace = Pace()
    pace.wait_s(0.0, STEP_NS, 1.0)
    pace.wait_s(0.99, 100 * STEP_NS, 1.0)
    assert pace.wait_s(0.99, next_ns, 1.0) == 0.0
    assert pace.wait_s(0.99, next_ns + STEP_NS, 1.0) == pytest.approx(0.01)


def test_another_speed_holds_from_now_on() -> None:
    pace = Pace()
    pace.wait_s(0.0, STEP_NS, 1.0)
    assert pace.wait_s(0.01, 2 * STEP_NS, 0.1) == 0.0
    assert pace.wait_s(0.01, 3 * STEP_NS, 0.1) == pytest.approx(0.1)

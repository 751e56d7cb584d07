from __future__ import annotations

from dataclasses import dataclass

import pytest

from mazebot.navigation.control.mppi.batch_pace import BatchPace

PERIOD_NS = 50_000_000


@dataclass
class Sampler:
    batch_size: int = 2000
    shortfalls: int = 0


def steps(pace: BatchPace, sampler: object, periods: list[float]) -> None:
    for period in periods:
        pace.step(round(period * PERIOD_NS), sampler)


def test_steps_in_time_change_nothing() -> None:
    pace, sampler = BatchPace(PERIOD_NS), Sampler()
    # Within their periods they may come early or late.
    steps(pace, sampler, [0.0, 1.9, 2.1, 3.9, 4.0, 5.5])
    assert (sampler.batch_size, pace.missed) == (2000, 0)


def test_a_missed_period_makes_the_batch_smaller_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    pace, sampler = BatchPace(PERIOD_NS), Sampler()
    steps(pace, sampler, [0.0, 2.1, 3.2])
    assert (sampler.batch_size, pace.missed) == (1400, 1)
    assert "sampling 1400 trajectories instead of 2000" in caplog.text
    steps(pace, sampler, [5.0, 10.0, 15.0, 20.0, 25.0])
    assert sampler.batch_size == 500


def test_the_batch_grows_again_where_steps_are_in_time() -> None:
    pace, sampler = BatchPace(PERIOD_NS), Sampler()
    steps(pace, sampler, [0.0, 2.0])
    steps(pace, sampler, [3.0 + i for i in range(99)])
    assert sampler.batch_size == 1400
    steps(pace, sampler, [102.0])
    assert sampler.batch_size == 1541
    steps(pace, sampler, [103.0 + i for i in range(1000)])
    assert sampler.batch_size == 2000


def test_another_controller_has_a_batch_of_its_own() -> None:
    pace, first, second = BatchPace(PERIOD_NS), Sampler(), Sampler(batch_size=1000)
    steps(pace, first, [0.0, 2.0])
    assert first.batch_size == 1400
    steps(pace, second, [3.0, 5.0])
    assert (first.batch_size, second.batch_size) == (2000, 700)
    steps(pace, second, [6.0 + i for i in range(1000)])
    assert second.batch_size == 1000


def test_time_without_control_is_not_missed() -> None:
    pace, sampler = BatchPace(PERIOD_NS), Sampler()
    steps(pace, sampler, [0.0])
    pace.rest()
    steps(pace, sampler, [90.0])
    steps(pace, object(), [95.0])
    assert sampler.batch_size == 2000

"""How long a run took and how fast it was."""

from __future__ import annotations

import pytest

from mazebot.recorder.judging.wall_time import WallTime

S = 1_000_000_000


def test_before_two_ticks_nothing_is_measured() -> None:
    wall = WallTime()
    assert (wall.wall_time_s, wall.real_time_factor, wall.ticked) == (None, None, False)
    wall.tick(100.0, 60 * S)
    assert (wall.wall_time_s, wall.simulated_s, wall.real_time_factor) == (None, None, None)
    assert wall.ticked


def test_the_factor_is_that_between_the_first_tick_and_the_newest() -> None:
    wall = WallTime()
    wall.tick(100.0, 60 * S)
    wall.tick(104.0, 62 * S)
    assert (wall.wall_time_s, wall.simulated_s, wall.real_time_factor) == (4.0, 2.0, 0.5)


def test_pauses_are_no_part_of_it_and_the_last_one_ends_it() -> None:
    wall = WallTime()
    wall.pause(90.0)
    wall.resume(99.0)  # before the first tick: not of this run's time
    wall.tick(100.0, 0)
    wall.tick(102.0, 2 * S)
    wall.pause(102.0)
    wall.pause(103.0)  # said again
    wall.resume(112.0)
    assert wall.wall_time_s == 2.0
    wall.tick(114.0, 4 * S)
    wall.pause(114.0)
    assert (wall.pauses, wall.paused_s(120.0)) == (3, 16.0)
    assert wall.wall_time_s == 4.0
    assert wall.real_time_factor == pytest.approx(1.0)

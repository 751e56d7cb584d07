"""Driving to random goals, and what counts as a fault."""

import io
import itertools
import math

import numpy as np
import pytest
from rich.console import Console

from mazebot.bench.whole.soak import CLEARANCE_M, Drive, Ended, Sample, drive, main, reachable_goals
from mazebot.common.world.costmap import FREE
from mazebot.embedded.demo import DemoOptions
from mazebot.worldgen.recipe.loader import load_world

QUIET = DemoOptions(camera=False, record=False, renderer="none")


def drive_with_memory(mb_per_hour: float, hours: float = 1.0) -> Drive:
    """One whose memory fills caches by 50 MB in the first tenth, and then grows at this rate."""
    done = Drive()
    for time_s in np.arange(10.0, hours * 3600.0 + 1.0, 10.0).tolist():
        filled_mb = min(time_s / (360.0 * hours), 1.0) * 50.0
        done.samples.append(Sample(time_s, 300.0 + filled_mb + mb_per_hour * time_s / 3600.0))
    return done


def test_goals_have_room_around_them_and_repeat() -> None:
    loaded = load_world("enhanced")
    goals = list(itertools.islice(reachable_goals(loaded, 7), 50))
    assert goals == list(itertools.islice(reachable_goals(loaded, 7), 50))
    assert goals != list(itertools.islice(reachable_goals(loaded, 8), 50))
    rows, columns = np.nonzero(loaded.map_cells != FREE)
    side_m, origin = loaded.world.map_resolution_m, loaded.map_origin
    solid_m = np.stack([origin.x_m + (columns + 0.5) * side_m, origin.y_m + (rows + 0.5) * side_m])
    for goal in goals:
        away_m = np.hypot(*(solid_m - np.array([[goal.x_m], [goal.y_m]]))).min()
        assert away_m >= CLEARANCE_M - 1e-6
    for one, other in itertools.pairwise(goals):
        assert math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) >= 1.0


def test_memory_is_judged_after_the_warm_up() -> None:
    slope = drive_with_memory(0.5).slope_mb_h()
    assert slope is not None
    assert slope[0] == pytest.approx(0.5)
    assert drive_with_memory(0.5).faults() == []
    (fault,) = drive_with_memory(1.5).faults()
    assert fault == "memory grows by 1.50 MB per simulated hour"


def test_of_a_short_drive_memory_is_not_judged() -> None:
    short = drive_with_memory(20.0, hours=0.1)
    assert short.slope_mb_h() is None
    assert short.faults() == []


def test_a_robot_that_gets_nowhere_is_a_fault() -> None:
    done = Drive(stuck=True)
    assert done.faults() == ["no goal finished for 300 s of simulation"]


def test_it_drives_from_goal_to_goal() -> None:
    done = drive(QUIET, 20.0 / 3600.0, Console(file=io.StringIO()))
    assert done.samples[-1].time_s == pytest.approx(20.0, abs=0.01)
    assert len(done.results) >= 1
    assert done.reached == len(done.results)
    assert done.contacts == 0
    assert done.faults() == []
    assert len(done.state_hash) == 16


def test_only_what_was_reached_counts() -> None:
    ended = [Ended(error_code=code, number_of_recoveries=0) for code in (0, 208)]
    assert Drive(results=ended).reached == 1


def test_hours_that_are_none_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["--hours", "-1"])
    assert left.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--hours" in line

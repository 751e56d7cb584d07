"""What series.json says of a run made by hand."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import shapely

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Contact, Evaluation, GoalReport, Planar
from mazebot.common.recordings.series import MOST_EVENTS, MOST_ROWS, RunSeries, read_series
from mazebot.recorder.judging.history import RunHistory
from mazebot.recorder.judging.plan import solid_rings
from tests.common.recordings.made_run import made_run
from tests.recorder.synthetic import ERROR_M, room

SECOND_NS = 1_000_000_000
GOAL = GoalReport(
    name="corner", reached=False, time_s=2.0, path_length_m=2.0, shortest_path_m=None,
    goal_error_m=0.1, goal_error_rad=0.2, recoveries=0, error_code=105, error_msg="no progress",
    start_time_s=1.0, goal=Planar(x_m=1.0, y_m=2.0, yaw_rad=0.0),
)  # fmt: skip


def series_of(history: RunHistory, evaluation: Evaluation | None = None) -> RunSeries:
    series = history.series(room(), evaluation or Evaluation(), (), (), 10.0)
    return RunSeries.model_validate_json(series.model_dump_json())


def status(level: int, message: str = "active", **values: str) -> msg.DiagnosticArray:
    said = [msg.KeyValue(key, value) for key, value in values.items()]
    one = msg.DiagnosticStatus(level, "navigation", message, "", said)
    return msg.DiagnosticArray(msg.header(SECOND_NS, ""), [one])


def test_a_run_leaves_its_motion_its_errors_and_its_world(tmp_path: Path) -> None:
    series = read_series(made_run(tmp_path / "run"))
    assert series is not None
    truth, estimate = series.truth, series.estimate
    assert len(truth.time_s) == len(truth.x_m) == len(truth.speed_m_s) == pytest.approx(30, abs=1)
    assert np.hypot(truth.x_m, truth.y_m) == pytest.approx(1.0, abs=1e-3)
    assert truth.speed_m_s[-1] == 0.2
    assert estimate.error_m == pytest.approx([ERROR_M] * len(estimate.time_s), abs=1e-3)
    assert [goal.name for goal in series.goals] == ["corner"]
    assert series.goals[0].pose == Planar(x_m=1.0, y_m=1.0, yaw_rad=0.0)
    assert series.goals[0].end_s == pytest.approx(3.0, abs=0.05)
    (marker,) = series.markers
    # On the eastern wall, its face to the west.
    assert marker.x_m == 1.92
    assert abs(marker.yaw_rad) == pytest.approx(math.pi)
    assert marker.images > 0
    said = {(event.kind, event.level, event.text) for event in series.events}
    assert ("goal", "error", "corner: not reached: no progress") in said
    assert ("marker", "info", "marker 60 first seen") in said
    areas = sorted(shapely.Polygon(ring).area for ring in series.solid)
    assert areas == pytest.approx([3.85**2, 4.15**2], rel=0.01)


def test_its_size_is_bounded_whatever_happens() -> None:
    history = RunHistory()
    for number in range(30_000):
        now_ns = number * SECOND_NS
        history.add_truth(now_ns, SE2(1.0, 2.0, 3.0), 0.2, 0.1)
        history.add_estimate(now_ns, SE2(1.0, 2.0, 3.0), 0.1, 0.2)
        if number % 10 == 0:
            line = msg.Log(msg.time_from_ns(now_ns), 40, "a", "x " * 1_000, "", "", 0)
            history.add_log(line)
            history.add_diagnostics(status(0, step_time_p99_ms="3.5", missed_periods="1"))
    series = series_of(history, Evaluation(goals=(GOAL,) * 5_000))
    assert MOST_ROWS / 2 <= len(series.truth.time_s) <= MOST_ROWS
    assert len(series.events) == MOST_EVENTS
    assert series.events_dropped == 3_000 + 2 * 1_000 - MOST_EVENTS
    assert len(series.model_dump_json()) < 1_500_000


def test_costs_and_states_are_those_that_the_services_say() -> None:
    history = RunHistory()
    history.add_diagnostics(status(1, "waiting for a map", step_time_p99_ms="nan"))
    history.add_diagnostics(status(0, step_time_p99_ms="3.5", missed_periods="2"))
    history.add_diagnostics(status(2, "fault", step_time_p99_ms="1.5", missed_periods="x"))
    series = series_of(history)
    assert series.costs["navigation"].step_time_p99_ms == (3.5,)
    assert series.costs["navigation"].missed_periods == (2.0,)
    told = [(event.level, event.text) for event in series.events]
    assert told == [("info", "navigation: active"), ("error", "navigation: fault")]


def test_the_pace_is_measured_without_pauses() -> None:
    history = RunHistory()
    for wall_s, now_s, is_paused in ((0, 0, False), (2, 4, False), (9, 5, True), (11, 9, False)):
        history.tick(float(wall_s), now_s * SECOND_NS, is_paused)
    assert series_of(history).pace.real_time_factor == (2.0, 2.0)


def test_an_event_is_where_the_robot_was() -> None:
    history = RunHistory()
    history.add_truth(0, SE2(0.0, 0.0, 0.0), 0.0, 0.0)
    history.add_truth(4 * SECOND_NS, SE2(4.0, -8.0, 0.0), 0.0, 0.0)
    contact = Contact(
        time_s=2.0, robot_link="base_link", body="Wall_1", position_m=(0, 0, 0), impulse_n_s=1.0
    )
    (event,) = series_of(history, Evaluation(contacts=(contact,))).events
    assert (event.time_s, event.x_m, event.y_m) == (2.0, 2.0, -4.0)
    assert event.text == "base_link touches Wall_1"


def test_a_saved_history_goes_on(tmp_path: Path) -> None:
    history, other = RunHistory(), RunHistory()
    history.add_truth(0, SE2(1.0, 2.0, 0.5), 0.1, 0.2)
    history.see_marker(5, "60")
    history.add_diagnostics(status(0, step_time_p99_ms="3.5"))
    other.restore(history.state())
    other.restore_values(json.loads(json.dumps(history.values())))
    assert series_of(other) == series_of(history)


def test_the_outline_of_a_world_is_closed_and_has_holes() -> None:
    box, hole = shapely.box(0, 0, 4, 4), shapely.box(1, 1, 2, 2)
    lines = shapely.linestrings([[(6, 0), (7, 0)], [(7, 0), (6, 1)], [(6, 1), (6, 0)]])
    rings = solid_rings(np.array([box.difference(hole), *lines], object))
    areas = sorted(shapely.Polygon(ring).area for ring in rings)
    assert areas == pytest.approx([0.5, 1.0, 16.0])
    assert all(ring[0] == ring[-1] for ring in rings)
    assert solid_rings(np.array([], object)) == ()

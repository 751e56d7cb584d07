"""The whole robot among things that its lidar does not see."""

from __future__ import annotations

import pytest

from mazebot.bench.navigation.courses import hidden
from mazebot.bench.navigation.scenario import Options


@pytest.mark.slow
def test_a_sill_is_avoided_by_the_depth_camera() -> None:
    there, back = hidden.on_the_way(hidden.sill, 2)("sills", 1, Options())
    for row in (there, back):
        assert row.reached, row.error_msg
        assert not row.contacts_robot


@pytest.mark.slow
def test_without_a_camera_it_runs_into_it() -> None:
    rows = hidden.on_the_way(hidden.sill, 2)("sills", 1, Options(camera=False))
    assert rows[0].contacts_robot > 0


@pytest.mark.slow
def test_what_no_sensor_shows_is_run_into_once_and_driven_round() -> None:
    (row,) = hidden.panes("panes", 1, Options())
    assert row.reached, row.error_msg
    assert row.contacts_robot == 1
    assert row.extra["freed_s"] <= 20.0
    assert row.localisation_p95_m is not None
    assert row.localisation_p95_m < 0.05

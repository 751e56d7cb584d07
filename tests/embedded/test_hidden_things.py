"""The whole robot among things that its lidar does not see."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.bench.navigation.courses import bench_worlds, hidden
from mazebot.bench.navigation.scenario import Options
from mazebot.common.messages.documents import BodyEntity, Box, Shape
from mazebot.common.messages.topics import CONTACTS, GLOBAL_COSTMAP
from mazebot.embedded.session import Session


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


@pytest.mark.slow
def test_a_mat_that_is_rolled_over_leaves_the_floor_free() -> None:
    room = {"walls": bench_worlds.fenced(8.0, 4.0), "start": bench_worlds.start(-2.0, 0.0)}
    mat = Shape(name="mat", geometry=Box(size_m=(0.6, 2.0, 0.008)))
    place = bench_worlds.made("bench_mat", room)
    with Session(place.name, seed=1, worlds_dir=place.worlds_dir) as session:
        session.run_for(1.0)
        session.spawn(BodyEntity(name="mat", position_m=(0.0, 0.0, 0.004), shapes=(mat,)))
        with session.watching(CONTACTS) as contacts:
            for x_m in (2.0, -2.0, 2.0):
                result = session.goal(x_m, 0.0)
                assert result.error_code == 0, result.error_msg
        assert {one.body for one in contacts} <= {"mat"}
        costmap = session.latest(GLOBAL_COSTMAP)
        assert costmap is not None
        grid, resolution_m = costmap.info, costmap.info.resolution
        costs = np.array(costmap.data).reshape(grid.height, grid.width)
        rows, columns = np.nonzero(costs == 100)
        xs_m = grid.origin.position.x + (columns + 0.5) * resolution_m
        ys_m = grid.origin.position.y + (rows + 0.5) * resolution_m
        assert not ((np.abs(xs_m) < 3.7) & (np.abs(ys_m) < 1.7)).any()

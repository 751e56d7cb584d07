"""Sessions in which the robot makes the map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import (
    EXPLORATION_STATUS,
    MAP,
    NAVIGATION_RESULT,
    POSE_GRAPH,
)
from mazebot.common.world.map_files import write_map
from mazebot.embedded.session import Session


def test_a_reset_begins_map_and_drive_anew_and_they_are_the_same_again() -> None:
    with Session("original", camera=False, slam=True, explore=False) as session:
        hashes = []
        for _ in range(2):
            result = session.goal(0.5, 0.0, 0.8)
            assert result.error_code == 0
            hashes.append(session.stats.state_hash)
            graph = session.latest(POSE_GRAPH)
            assert graph is not None
            assert graph.epoch == session.stats.epoch
            stats = session.reset()
        assert stats.epoch == 3
        assert hashes[0] == hashes[1]


def test_the_explorer_drives_by_itself_and_the_map_can_be_driven_in(tmp_path: Path) -> None:
    with Session("original", camera=False, slam=True) as session:
        with session.watching(NAVIGATION_RESULT) as results:
            session.run_for(8.0)
        status, grid = session.latest(EXPLORATION_STATUS), session.latest(MAP)
        assert status is not None
        assert status.state == "exploring"
        assert status.driven_m > 0.5
        assert all(one.error_msg == "preempted by a new goal" for one in results if one.error_code)
        assert grid is not None
        cells = np.array(msg.cells_from_grid(grid), np.int8)
        origin = msg.se2_from_pose(grid.info.origin)
    map_file = write_map(tmp_path, "map", cells, grid.info.resolution, origin)
    with Session("original", camera=False, map_file=map_file) as session:
        assert session.goal(0.5, 0.0, 0.8).error_code == 0
        shown = session.latest(MAP)
        assert shown is not None
        assert np.array_equal(msg.cells_from_grid(shown), cells)

"""Frontiers on small floor plans."""

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.world.costmap import Cells
from mazebot.explorer.floor import Floor, floor_from
from mazebot.explorer.frontiers import find_frontiers, guessed_m2
from tests.explorer.worlds import RESOLUTION_M, plan

ORIGIN = SE2(0.0, 0.0, 0.0)
ROBOT = SE2(1.25, 1.25, 0.0)
ROOM = plan(
    "######",
    "#....#",
    "#....#",
    "#....#",
    "######",
    "??????",
)


def floor_of(cells: Cells, robot: SE2 = ROBOT) -> Floor:
    return floor_from(cells, RESOLUTION_M, ORIGIN, robot, 0.24, 0.5)


def opened(width_cells: int) -> Cells:
    """The room with an opening in its lower wall, unknown beyond it."""
    cells = ROOM.copy()
    cells[10:20, 30 : 30 + width_cells] = 0
    return cells


def test_a_closed_room_has_none() -> None:
    assert find_frontiers(floor_of(ROOM), 0.3) == []


def test_a_door_is_one_and_lies_beyond_the_door() -> None:
    (frontier,) = find_frontiers(floor_of(opened(14)), 0.3)
    assert frontier.size_m == pytest.approx(0.7)
    # The map is padded by two cells; the door's sill is unknown from row 9 down.
    assert set(frontier.cells[:, 0].tolist()) == {9 + 2}
    assert frontier.cells[:, 1].min() >= 30 + 2
    assert frontier.cells[:, 1].max() < 44 + 2


def test_a_slit_that_the_robot_does_not_fit_through_is_none() -> None:
    for width in range(1, 9):
        assert find_frontiers(floor_of(opened(width)), 0.0) == []
    assert len(find_frontiers(floor_of(opened(11)), 0.3)) == 1


def test_a_gap_that_only_the_outline_fits_through_is_one() -> None:
    for width in range(1, 13):
        floor = floor_from(opened(width), RESOLUTION_M, ORIGIN, ROBOT, 0.24, 0.5, 0.153)
        assert len(find_frontiers(floor, 0.3)) == (width >= 7)
    closed = floor_from(ROOM, RESOLUTION_M, ORIGIN, ROBOT, 0.24, 0.5, 0.153)
    assert closed.reachable_m2 == floor_of(ROOM).reachable_m2


def test_a_gap_in_a_wall_behind_which_is_floor_is_none() -> None:
    cells = ROOM.copy()
    cells[10:20, 40] = -1
    assert find_frontiers(floor_of(cells), 0.0) == []


def test_a_speck_that_the_lidar_has_missed_is_too_small() -> None:
    cells = ROOM.copy()
    cells[35:37, 30:33] = -1
    assert find_frontiers(floor_of(cells), 0.3) == []
    assert len(find_frontiers(floor_of(cells), 0.1)) == 1


def test_beyond_the_edge_of_the_map_is_unknown() -> None:
    cells = np.full((60, 60), 0, np.int8)
    (frontier,) = find_frontiers(floor_of(cells), 0.3)
    assert len(frontier.cells) == 4 * 60


def test_floor_that_no_path_leads_to_has_none() -> None:
    cells = plan("########", "#..#...?", "#..#...?", "#..#...?", "########")
    assert find_frontiers(floor_of(cells, SE2(1.0, 1.25, 0.0)), 0.3) == []
    assert len(find_frontiers(floor_of(cells, SE2(2.75, 1.25, 0.0)), 0.3)) == 1


def test_two_doors_are_two() -> None:
    cells = opened(14)
    cells[28:42, 0:10] = 0
    cells[28:42, 0] = -1
    assert len(find_frontiers(floor_of(cells), 0.3)) == 2


def test_what_is_guessed_is_what_may_be_floor() -> None:
    cells = opened(14)
    floor = floor_of(cells)
    assert guessed_m2(floor, []) == 0.0
    few = guessed_m2(floor, find_frontiers(floor, 0.3))
    # Below the map, and 1.5 m to each side at the most.
    assert 0.1 < few < 3.0

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import Location
from mazebot.worldgen.difficulty import difficulty
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world
from tests.common.house import wall, world


def test_the_house_is_as_hard_as_it_has_been_measured() -> None:
    found = difficulty(load_world("sim_house", use_aruco=False))
    assert found.goal == "location4", "the farthest"
    assert found.path_length_m == pytest.approx(8.55, abs=0.15)
    assert found.narrowest_gap_m == pytest.approx(0.97, abs=0.1)
    assert found.dead_ends is None
    assert found.free_area_m2 == pytest.approx(33.6, abs=0.5)


def test_the_figures_of_a_maze_are_those_of_its_passages() -> None:
    found = difficulty(load_world("maze", overrides=("maze.seed=4", "maze.rows=5")))
    braided = difficulty(
        load_world("maze", overrides=("maze.seed=4", "maze.rows=5", "maze.braiding=1.0"))
    )
    assert found.goal == "goal"
    assert found.turns
    assert found.dead_ends
    assert braided.dead_ends == 0
    # Walls of 0.15 m about cells of 1 m, on a map of 5 cm.
    assert found.narrowest_gap_m == pytest.approx(0.8)
    assert braided.path_length_m is not None
    assert found.path_length_m is not None
    assert braided.path_length_m <= found.path_length_m


def rooms(gap_cells: int) -> LoadedWorld:
    """Two rooms of 2 m, joined by a gap of so many cells in the middle, and a goal beyond."""
    cells = np.full((44, 84), 100, np.int8)
    cells[2:42, 2:40] = 0
    cells[2:42, 44:82] = 0
    low = 22 - gap_cells // 2
    cells[low : low + gap_cells, 40:44] = 0
    goal = Location(name="there", x_m=3.1, y_m=1.1, yaw_rad=0.0)
    one = world([wall()], [], start=SE2(1.1, 1.1, 0.0)).model_copy(update={"locations": (goal,)})
    return LoadedWorld(one, {}, cells, SE2(0.0, 0.0, 0.0))


@pytest.mark.parametrize("gap_cells", [10, 11, 16])
def test_the_narrowest_gap_is_exact_on_the_map(gap_cells: int) -> None:
    found = difficulty(rooms(gap_cells))
    assert found.narrowest_gap_m == pytest.approx(gap_cells * 0.05)
    assert found.path_length_m == pytest.approx(2.0, abs=0.06)
    assert found.turns == 0


def test_where_no_way_leads_there_is_no_length() -> None:
    found = difficulty(rooms(6))
    assert (found.goal, found.path_length_m, found.narrowest_gap_m) == ("", None, None)


def test_a_way_around_a_corner_is_pulled_straight() -> None:
    loaded = rooms(10)
    cells = loaded.map_cells.copy()
    cells[17:27, 40:44] = 100
    cells[2:12, 40:44] = 0
    one = LoadedWorld(loaded.world, {}, cells, loaded.map_origin)
    found = difficulty(one)
    # Down to the gap's upper corner, with 0.22 m between, through it, and up again.
    down = 1.1 - 0.36
    about = 2 * math.hypot(0.9 - 0.05, down) + 0.3
    assert found.path_length_m == pytest.approx(about, rel=0.05)

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import optimize

from mazebot.common.maths.frames import SE2
from mazebot.common.world.marker_entities import marker_entities
from mazebot.common.world.placement import panel_of
from mazebot.worldgen.markers import marker_cover
from mazebot.worldgen.markers.marker_cover import best_cover, cover
from mazebot.worldgen.markers.visibility import covered_share
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world
from mazebot.worldgen.recipe_model import MarkerCoverRecipe
from tests.common.house import marker, wall, world


@pytest.fixture(scope="module")
def house() -> LoadedWorld:
    return load_world("sim_house_enhanced", use_aruco=False)


def wanted(**changes: object) -> MarkerCoverRecipe:
    return MarkerCoverRecipe.model_validate(changes)


def test_four_markers_cover_nine_tenths_of_the_house(house: LoadedWorld) -> None:
    found = best_cover(house.world, house.map_cells, house.map_origin, wanted(first_id=10))
    assert [one.id for one in found.markers] == [10, 11, 12, 13]
    assert found.proven_fewest
    with_them = house.world.model_copy(update={"markers": found.markers})
    entities, _ = marker_entities(with_them)
    assert entities.refused == ()
    panels = [panel_of(entity) for entity in entities.markers]
    share = covered_share(with_them, panels, house.map_cells, house.map_origin)
    assert share == pytest.approx(found.share)
    assert share >= 0.9
    again = cover(house.world, house.map_cells, house.map_origin, wanted(first_id=10))
    assert again == found.markers


def test_markers_that_hang_already_count_and_keep_their_ids(house: LoadedWorld) -> None:
    there = load_world("sim_house_enhanced").world
    found = best_cover(there, house.map_cells, house.map_origin, wanted(share=0.7, first_id=60))
    # They cover 0.57; one more sees at least 0.13.
    assert [one.id for one in found.markers] == [61]
    enough = best_cover(there, house.map_cells, house.map_origin, wanted(share=0.5))
    assert enough.markers == ()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"max_markers": 2}, r"must be at most 0\.[67]\d: 2 markers reach no more"),
        ({"share": 1.0}, r"must be at most 0.9\d: "),
        ({"first_id": 100}, "id: 100: must be less than 100 in DICT_4X4_100"),
        ({"dictionary": "QR"}, "dictionary: 'QR': must be one of"),
        ({"height_m": 5.0}, r"must be at most 0.00"),
    ],
)
def test_what_cannot_be_had_is_said(
    house: LoadedWorld, changes: dict[str, object], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        cover(house.world, house.map_cells, house.map_origin, wanted(**changes))


def test_no_choice_of_fewer_covers_a_small_room() -> None:
    """By trying all of them."""
    room = [
        wall("south", SE2(0.0, -1.5, 0.0), 4.2), wall("north", SE2(0.0, 1.5, 0.0), 4.2),
        wall("east", SE2(2.0, 0.0, np.pi / 2), 3.2), wall("west", SE2(-2.0, 0.0, np.pi / 2), 3.2),
        wall("middle", SE2(0.0, -0.5, np.pi / 2), 1.8),
    ]  # fmt: skip
    one = world(room, [], start=SE2(-1.0, 0.0, 0.0))
    cells = np.full((80, 100), -1, np.int8)
    cells[12:68, 12:88] = 0
    cells[12:48, 48:52] = 100
    origin = SE2(-2.5, -2.0, 0.0)
    found = best_cover(one, cells, origin, wanted(share=0.9))
    assert found.proven_fewest
    assert found.share >= 0.9
    fewer = len(found.markers) - 1
    assert fewer == 1
    places = [
        marker(id=0, wall=host.name, side=side, offset_m=offset, height_m=0.25)
        for host in room
        for side in ("left", "right")
        for offset in np.arange(-1.75, 1.8, 0.25)
    ]
    shares = []
    for candidates in itertools.combinations(places, fewer):
        entities, _ = marker_entities(one.model_copy(update={"markers": candidates}))
        panels = [panel_of(entity) for entity in entities.markers]
        shares.append(covered_share(one, panels, cells, origin))
    assert 0.3 < max(shares) < 0.9


def test_what_takes_too_long_to_solve_is_chosen_greedily(monkeypatch: pytest.MonkeyPatch) -> None:
    def solved(*_: object, **__: object) -> None:
        pytest.fail("the integer program of a large maze takes minutes")

    monkeypatch.setattr(optimize, "milp", solved)
    maze = load_world("maze", overrides=("maze.rows=10", "maze.columns=10"))
    found = best_cover(maze.world, maze.map_cells, maze.map_origin, wanted(share=0.6))
    assert found.share >= 0.6
    # The program finds 13 in some seconds.
    assert len(found.markers) <= 16
    assert not found.proven_fewest


def test_more_floor_than_all_markers_show_is_refused_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def tried(*_: object) -> None:
        pytest.fail("no place need be tried")

    monkeypatch.setattr(marker_cover, "_places", tried)
    maze = load_world("maze", overrides=("maze.rows=20", "maze.columns=20"))
    with pytest.raises(ValueError, match=r"must be at most 0\.\d\d: 2 markers reach no more"):
        cover(maze.world, maze.map_cells, maze.map_origin, wanted(max_markers=2))

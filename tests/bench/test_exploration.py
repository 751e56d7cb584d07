"""The offline benchmark of exploration, and what it says of the choice."""

import numpy as np
import pytest

from mazebot.bench.slam.exploration import explore, main, offline_tour_m, place_of
from mazebot.explorer.params import ExplorerParams


def test_the_house_is_explored_and_the_robot_comes_home(capsys: pytest.CaptureFixture[str]) -> None:
    main(["original"], 1, False, None)
    told = capsys.readouterr().out
    assert "original 0, tour" in told
    assert told.count("100.0 % seen") == 3


def test_the_offline_tour_is_no_shorter_than_the_way_to_the_farthest_floor() -> None:
    place = place_of("original", 0)
    rows, columns = np.nonzero(place.reachable(0.24))
    row, column = place.cell(place.start.x_m, place.start.y_m)
    away_m = np.sqrt((rows - row) ** 2 + (columns - column) ** 2).max() * place.resolution_m
    assert offline_tour_m(place, ExplorerParams()) > 2.0 * (away_m - 3.5)


@pytest.mark.slow
def test_the_tour_drives_less_than_to_the_nearest_frontier() -> None:
    runs = {
        policy: [explore("loops", seed, policy) for seed in (2, 4)]
        + [explore("slam", 0, policy), explore("original", 0, policy)]
        for policy in ("tour", "nearest")
    }
    ours, nearest = (sum(one.driven_m for one in runs[name]) for name in ("tour", "nearest"))
    assert ours <= 0.9 * nearest
    assert all(one.seen_share > 0.99 for one in runs["tour"])
    assert all(one.driven_m <= 1.3 * one.tour_m for one in runs["tour"])

"""Things on the map that the lidar does not see."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import UnseenArea
from mazebot.common.messages.topics import LOCALIZATION_STATUS
from mazebot.embedded.session import Session
from mazebot.localization.messages import unseen_cells
from tests.worldgen import folder

THINGS: dict[str, dict[str, Any]] = {
    "step": {"size_m": [0.5, 1.0, 0.04]},
    "shelf": {"size_m": [0.4, 1.2, 0.02], "z_m": 0.2},
    "ramp": {"size_m": [1.0, 1.0, 0.02], "z_m": 0.1, "pitch_rad": -0.2},
}


@pytest.mark.parametrize("thing", THINGS)
def test_a_start_beside_a_thing_that_the_lidar_does_not_see_is_trusted(
    tmp_path: Path, thing: str
) -> None:
    one = {"name": "thing", "x_m": 1.0, "y_m": 0.0, **THINGS[thing]}
    recipe = {**folder.room(), "boxes": [one], "markers": [], "locations": {}}
    for wall in recipe["walls"]:
        wall.update(length_m=6.0, x_m=1.5 * wall["x_m"], y_m=3.0 * wall["y_m"])
    folder.make(tmp_path, recipe)
    with Session("room", worlds_dir=tmp_path, camera=False) as session:
        session.run_for(1.0)
        status = session.latest(LOCALIZATION_STATUS)
        assert status is not None
        assert status.state == "localized", status.reason


def test_the_occupied_cells_in_an_area_are_unseen_in_a_map_that_is_turned_too() -> None:
    cells = np.array([[100, 100, 100], [100, 0, 100]], np.int8)
    area = UnseenArea(low_m=(1.0, 0.0), high_m=(3.0, 2.0))
    expected = [[False, True, True], [False, False, True]]
    assert unseen_cells(cells, 1.0, SE2(0.0, 0.0, 0.0), [area]).tolist() == expected
    # The grid's x goes along the map's y.
    turned = UnseenArea(low_m=(-2.0, 1.0), high_m=(0.0, 3.0))
    assert unseen_cells(cells, 1.0, SE2(0.0, 0.0, math.pi / 2), [turned]).tolist() == expected
    elsewhere = UnseenArea(low_m=(7.0, -9.0), high_m=(9.0, 9.0))
    assert not unseen_cells(cells, 1.0, SE2(0.0, 0.0, 0.0), [elsewhere]).any()

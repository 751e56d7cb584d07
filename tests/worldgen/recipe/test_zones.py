from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mazebot.common.messages.documents import World
from mazebot.worldgen.check import problems_of
from mazebot.worldgen.recipe.loader import load_world
from tests.worldgen import folder

SQUARE = [[0.1, 0.1], [0.5, 0.1], [0.5, 0.5], [0.1, 0.5]]
SLOW = {"name": "slow", "polygon_m": SQUARE, "percent": 50.0}


def across(from_m: float, to_m: float) -> list[list[float]]:
    """A strip between the start and the corner."""
    return [[0.45, from_m], [0.55, from_m], [0.55, to_m], [0.45, to_m]]


def load(tmp_path: Path, **fields: object) -> World:
    return load_world("room", worlds_dir=folder.make(tmp_path, folder.room() | fields)).world


def problem(tmp_path: Path, **fields: object) -> str:
    worlds_dir = folder.make(tmp_path, folder.room() | fields)
    (found,) = problems_of("room", worlds_dir=worlds_dir)
    return str(found)


def test_zones_are_part_of_the_world_and_of_its_hash(tmp_path: Path) -> None:
    plain = load(tmp_path)
    world = load(
        tmp_path, keepout_zones=[{"name": "carpet", "polygon_m": SQUARE}], speed_limits=[SLOW]
    )
    assert world.keepout_zones[0].name == "carpet"
    assert world.speed_limits[0].percent == 50.0
    other = load(tmp_path, speed_limits=[SLOW | {"percent": 51.0}])
    assert len({plain.hash, world.hash, other.hash}) == 3
    assert World.model_validate_json(world.model_dump_json()) == world


def test_a_world_without_zones_is_written_as_if_there_were_none(tmp_path: Path) -> None:
    plain = load(tmp_path)
    assert "zones" not in plain.model_dump_json()
    assert "speed_limits" not in plain.model_dump(mode="json")
    assert World.model_validate_json(plain.model_dump_json()) == plain


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"keepout_zones": [{"name": "a", "polygon_m": SQUARE[:2]}]},
         "keepout_zones[0].polygon_m"),
        ({"keepout_zones": [{"name": "a", "polygon_m": [*SQUARE[:2], *SQUARE[:1:-1]]}]},
         "keepout_zones[0].polygon_m: ((0.1, 0.1), (0.5, 0.1), (0.1, 0.5), (0.5, 0.5)): "
         "must not cross or touch itself"),
        ({"keepout_zones": [{"name": "a", "polygon_m": SQUARE}], "speed_limits": [SLOW | {
            "name": "a"}]},
         "speed_limits[0].name: 'a': must be unique: already used by keepout_zones[0]"),
        ({"speed_limits": [SLOW | {"speed_limit_m_s": 0.2}]},
         "speed_limits[0]: 'slow': must have one of speed_limit_m_s and percent, not both"),
        ({"speed_limits": [{"name": "slow", "polygon_m": SQUARE}]},
         "speed_limits[0]: 'slow': must have one of speed_limit_m_s and percent, not neither"),
        ({"speed_limits": [SLOW | {"percent": 0.0}]}, "speed_limits[0].percent: 0.0: must be"),
        ({"keepout_zones": [{"name": "a", "polygon_m": [[0.5, 0.0], [1.5, 0.0], [1.0, 0.9]]}]},
         "locations.corner: (1.0, 0.5): cannot be driven to: it lies in keepout zone a"),
        ({"keepout_zones": [{"name": "a", "polygon_m": across(-2.0, 2.0)}]},
         "locations.corner: (1.0, 0.5): must be reached from the start by a way that keeps out of "
         "keepout zone a"),
        # Neither alone is in the way, and the gap between them is narrower than the robot.
        ({"keepout_zones": [{"name": "a", "polygon_m": across(-2.0, -0.1)},
                            {"name": "b", "polygon_m": across(0.15, 2.0)}]},
         "keeps out of keepout zones a, b"),
        ({"keepout_zones": [{"name": "a", "polygon_m": [[-0.1, -0.1], [0.1, -0.1], [0.0, 0.1]]}]},
         "start: (0.0, 0.0): must not lie in keepout zone a: the robot cannot come back to it"),
    ],
)  # fmt: skip
def test_a_bad_zone_is_one_line_with_its_field(
    fields: dict[str, Any], says: str, tmp_path: Path
) -> None:
    assert says in problem(tmp_path, **fields)


def test_zones_that_leave_a_way_are_no_problem(tmp_path: Path) -> None:
    zones = [{"name": "a", "polygon_m": across(-2.0, -0.4)}]
    worlds_dir = folder.make(tmp_path, folder.room() | {"keepout_zones": zones})
    assert problems_of("room", worlds_dir=worlds_dir) == ()

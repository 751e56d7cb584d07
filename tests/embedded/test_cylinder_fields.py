"""Fields of cylinders as in the BARN data set, from a Gazebo file: the robot starts on the largest
piece of floor, and drives from end to end.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from mazebot.embedded.demo import DemoOptions, run
from mazebot.worldgen.check import findings_of
from mazebot.worldgen.files import load_any
from tests.common.cylinder_fields import CELL_M, END_M, SIDE_M, cylinder_field

FIELDS = range(16)
MIDDLE_M, BEYOND_M = SIDE_M / 2.0, END_M / 2.0
ACROSS = (
    f"locations={{south: {{x_m: {MIDDLE_M}, y_m: {-BEYOND_M}, yaw_rad: 1.571}}, "
    f"north: {{x_m: {MIDDLE_M}, y_m: {SIDE_M + BEYOND_M}, yaw_rad: 1.571}}}}"
)


def starts_on_the_largest_piece(seed: int, tmp_path: Path) -> Path:
    field = cylinder_field(seed)
    file = field.write(tmp_path)
    start = load_any(str(file)).world.start
    pieces, side_m = field.pieces()
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    assert field.piece_at(pieces, side_m, start.x_m, start.y_m) == sizes.argmax()
    assert -CELL_M < min(start.x_m, start.y_m) < max(start.x_m, start.y_m) < SIDE_M + CELL_M
    problems, reach = findings_of(file)
    assert problems == ()
    assert reach is not None
    assert reach.reachable_m2 > 4.0
    assert reach.open_floor
    return file


@pytest.mark.parametrize("seed", FIELDS[:2])
def test_the_start_is_on_the_largest_piece(seed: int, tmp_path: Path) -> None:
    starts_on_the_largest_piece(seed, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=[pytest.mark.longest] * (seed % 2)) for seed in FIELDS]
)
def test_a_field_is_driven_from_end_to_end(seed: int, tmp_path: Path) -> None:
    file = starts_on_the_largest_piece(seed, tmp_path)
    options = DemoOptions(
        world_name=str(file), out_dir=tmp_path / "run", camera=False, record=False,
        renderer="none", overrides=(ACROSS,), seed=seed,
    )  # fmt: skip
    assert run(options) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert [goal["name"] for goal in summary["goals"]] == ["south", "north", "home"]
    assert all(goal["reached"] for goal in summary["goals"])
    assert summary["contacts"]["count"] == 0

"""Every shipped world, and mazes that nobody has seen, driven to the end."""

import json
import platform
from pathlib import Path
from typing import Any

import pytest

from mazebot.common.files.root import ROOT
from mazebot.embedded.demo import DemoOptions, run
from mazebot.worldgen.recipe.loader import load_world
from tests.embedded.golden_tours import GOLDEN_TOURS, drive_tour

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

WORLDS = sorted(path.stem for path in (ROOT / "worlds").glob("*.yaml"))
MAZES = [
    (algorithm, braiding, seed)
    for seed, (algorithm, braiding) in enumerate(
        [("wilson", 0.0), ("wilson", 0.5), ("recursive_backtracker", 0.0),
         ("recursive_backtracker", 1.0), ("rooms", 0.0), ("rooms", 0.3), ("wilson", 0.0),
         ("recursive_backtracker", 0.2), ("rooms", 1.0), ("wilson", 1.0)]
    )
]  # fmt: skip


def assert_driven_well(summary: dict[str, Any]) -> None:
    assert summary["contacts"]["count"] == 0, summary["contacts"]
    assert all(goal["reached"] for goal in summary["goals"]), summary["goals"]


def summary_of(out_dir: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((out_dir / "summary.json").read_text())
    return summary


def driven(out_dir: Path, **options: Any) -> None:
    assert run(DemoOptions(out_dir=out_dir, record=False, **options)) == 0
    assert_driven_well(summary_of(out_dir))


@pytest.fixture(
    scope="module",
    params=[pytest.param(world, marks=pytest.mark.xdist_group(world)) for world in WORLDS],
)
def tour(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, dict[str, Any]]:
    """A shipped world, and the summary of its tour, driven once for all tests of it."""
    out_dir = tmp_path_factory.mktemp(request.param)
    drive_tour(request.param, out_dir, {})
    return request.param, summary_of(out_dir)


def test_the_tour_of_each_shipped_world(tour: tuple[str, dict[str, Any]]) -> None:
    world, summary = tour
    assert_driven_well(summary)
    names = [location.name for location in load_world(world).world.locations]
    assert [goal["name"] for goal in summary["goals"]] == [*names, "home"]


@pytest.mark.skipif(
    platform.machine() != "x86_64", reason="PyBullet is compiled otherwise for other machines"
)
def test_every_tour_has_the_hash_that_is_written_down(tour: tuple[str, dict[str, Any]]) -> None:
    world, summary = tour
    assert summary["state_hash"] == GOLDEN_TOURS[world]


def test_every_shipped_world_has_a_hash_that_is_written_down() -> None:
    assert list(GOLDEN_TOURS) == WORLDS


@pytest.mark.parametrize(
    ("algorithm", "braiding", "seed"),
    [pytest.param(*maze, marks=[pytest.mark.longest] * (maze[2] % 2)) for maze in MAZES],
)
def test_mazes_are_driven_from_start_to_goal(
    algorithm: str, braiding: float, seed: int, tmp_path: Path
) -> None:
    overrides = (
        f"maze.algorithm={algorithm}", f"maze.braiding={braiding}", f"maze.seed={seed}",
        "maze.rows=8", "maze.columns=8",
    )  # fmt: skip
    driven(
        tmp_path / "run", world_name="maze", overrides=overrides, seed=seed, camera=False,
        renderer="none",
    )  # fmt: skip

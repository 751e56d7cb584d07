"""Every shipped world, and mazes that nobody has seen, driven to the end."""

import json
from pathlib import Path
from typing import Any

import pytest

from mazebot.common.files.root import ROOT
from mazebot.embedded.demo import DemoOptions, run
from mazebot.worldgen.recipe.loader import load_world

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


def driven(out_dir: Path, **options: Any) -> dict[str, Any]:
    assert run(DemoOptions(out_dir=out_dir, record=False, **options)) == 0
    summary: dict[str, Any] = json.loads((out_dir / "summary.json").read_text())
    assert summary["contacts"]["count"] == 0, summary["contacts"]
    assert all(goal["reached"] for goal in summary["goals"]), summary["goals"]
    return summary


@pytest.mark.parametrize("world", WORLDS)
def test_the_tour_of_each_shipped_world(world: str, tmp_path: Path) -> None:
    summary = driven(tmp_path / "run", world_name=world)
    names = [location.name for location in load_world(world).world.locations]
    assert [goal["name"] for goal in summary["goals"]] == [*names, "home"]


@pytest.mark.parametrize(("algorithm", "braiding", "seed"), MAZES)
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

"""Two hundred mazes of every kind: solvable, spawnable, valid, and their maps are their walls."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from mazebot.common.messages.documents import Wall
from mazebot.worldgen.check import problems_of
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world

ROBOT_RADIUS_M = 0.24
ALGORITHMS = ("wilson", "recursive_backtracker", "rooms")
BRAIDINGS = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0)
SIDES = tuple(range(5, 41))
KINDS = list(itertools.islice(itertools.cycle(itertools.product(ALGORITHMS, BRAIDINGS)), 200))
SHARDS = 40
SHARD_OF = [
    pytest.param(shard, marks=[] if shard == 0 else pytest.mark.slow) for shard in range(SHARDS)
]
"""One shard is quick enough for every day."""


def depth_m(loaded: LoadedWorld, walls: tuple[Wall, ...]) -> NDArray[np.float64]:
    """(rows, columns): how deep in a wall the middle of each cell lies; negative outside all."""
    rows, columns = loaded.map_cells.shape
    side = loaded.world.map_resolution_m
    x = loaded.map_origin.x_m + (np.arange(columns) + 0.5) * side
    y = (loaded.map_origin.y_m + (np.arange(rows) + 0.5) * side)[:, None]
    deepest = np.full((rows, columns), -np.inf)
    for wall in walls:
        upright = abs(np.sin(wall.yaw_rad)) > 0.5
        long, thin = wall.length_m / 2, wall.thickness_m / 2
        half_x, half_y = (thin, long) if upright else (long, thin)
        in_x = (x > wall.x_m - half_x - 2 * side) & (x < wall.x_m + half_x + 2 * side)
        in_y = (y > wall.y_m - half_y - 2 * side) & (y < wall.y_m + half_y + 2 * side)
        near = np.ix_(in_y[:, 0], in_x)
        depth = np.minimum(
            half_x - np.abs(x[in_x] - wall.x_m), half_y - np.abs(y[in_y][:, None] - wall.y_m)
        )
        deepest[near] = np.maximum(deepest[near], depth)
    return deepest


@pytest.mark.parametrize("shard", SHARD_OF)
def test_mazes_of_every_kind_hold(shard: int) -> None:
    for number in range(shard, len(KINDS), SHARDS):
        algorithm, braiding = KINDS[number]
        rows, columns = SIDES[number % len(SIDES)], SIDES[(7 * number + 3) % len(SIDES)]
        overrides = (
            f"maze.algorithm={algorithm}", f"maze.braiding={braiding}", f"maze.seed={number}",
            f"maze.rows={rows}", f"maze.columns={columns}",
        )  # fmt: skip
        assert problems_of("maze", overrides=overrides) == (), overrides
        loaded = load_world("maze", overrides=overrides)
        world, cells, side = loaded.world, loaded.map_cells, loaded.world.map_resolution_m
        depth = depth_m(loaded, world.walls)
        free, occupied = cells == 0, cells == 100
        assert not (free & (depth > 0.0)).any(), "no wall cell is free"
        assert depth[free].max() < np.hypot(side, side), "no free cell lies deep in a wall"
        assert depth[occupied].min() > -np.hypot(side, side) / 2 - 1e-9, "nothing but walls"
        fits = ndimage.distance_transform_edt(~occupied) * side > ROBOT_RADIUS_M + side / 2
        ways, _ = ndimage.label(fits & free)
        (goal,) = [place for place in world.locations if place.name == "goal"]
        start_way, goal_way = (
            ways[
                int((place.y_m - loaded.map_origin.y_m) / side),
                int((place.x_m - loaded.map_origin.x_m) / side),
            ]
            for place in (world.start, goal)
        )
        assert start_way == goal_way != 0, "the robot can stand at the start and drive to the goal"

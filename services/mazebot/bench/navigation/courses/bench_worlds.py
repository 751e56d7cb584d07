"""The worlds of the scenarios: shipped ones with overrides, and some made for one scenario."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from mazebot.bench.navigation.scenario import scratch_folder
from mazebot.common.maths.frames import SE2
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world
from mazebot.worldgen.recipe.sources import DEFAULT_WORLDS_DIR

SHIPPED = ("original", "enhanced", "floor", "rooms", "slam", "markers", "maze", "maze_rooms")
_PLAIN: dict[str, Any] = {
    "wall_height_m": 1.0,
    "materials": {"plain": {"diffuse": [0.7, 0.7, 0.7, 1.0]}},
    "wall_materials": ["plain"],
}


@dataclass(frozen=True)
class BenchWorld:
    """A world to drive in."""

    name: str
    overrides: tuple[str, ...] = ()
    worlds_dir: Path | None = None

    @property
    def shown(self) -> str:
        """Its name with the overrides, as `mazebot demo` takes them."""
        return " ".join([self.name, *self.overrides])

    def load(self) -> LoadedWorld:
        """Its geometry. Raises ConfigError where it cannot be loaded."""
        folder = self.worlds_dir or DEFAULT_WORLDS_DIR
        return load_world(self.name, worlds_dir=folder, overrides=self.overrides)

    def starting_at(self, pose: SE2) -> BenchWorld:
        """The same with another start pose."""
        start = dict(zip(("x_m", "y_m", "yaw_rad"), (round(v, 4) for v in pose), strict=True))
        return BenchWorld(
            self.name, (*self.overrides, f"start={json.dumps(start)}"), self.worlds_dir
        )


def made(name: str, recipe: dict[str, Any]) -> BenchWorld:
    """A world of its own recipe."""
    path = scratch_folder() / f"{name}.yaml"
    path.write_text(yaml.safe_dump({"name": name, **_PLAIN, **recipe}), encoding="utf-8")
    return BenchWorld(name, (), path.parent)


def narrow_maze(corridor_m: float, seed: int, rows: int = 6, columns: int = 6) -> BenchWorld:
    """A maze whose corridors are this wide between walls of 0.15 m."""
    cell_m = round(corridor_m + 0.15, 3)
    return BenchWorld(
        "maze",
        (f"maze.cell_m={cell_m}", f"maze.rows={rows}", f"maze.columns={columns}",
         f"maze.seed={seed}", "wall_thickness_m=0.15"),
    )  # fmt: skip


def fenced(width_m: float, depth_m: float) -> list[dict[str, Any]]:
    """Four walls around a floor of this size about the origin."""
    return ring("fence", SE2(0.0, 0.0, 0.0), width_m, depth_m)


def ring(name: str, centre: SE2, width_m: float, depth_m: float) -> list[dict[str, Any]]:
    """Four walls around a rectangle."""
    thick = 0.15
    sides = (
        ("north", SE2(0.0, (depth_m + thick) / 2.0, 0.0), width_m + 2.0 * thick),
        ("south", SE2(0.0, -(depth_m + thick) / 2.0, 0.0), width_m + 2.0 * thick),
        ("east", SE2((width_m + thick) / 2.0, 0.0, math.pi / 2.0), depth_m),
        ("west", SE2(-(width_m + thick) / 2.0, 0.0, math.pi / 2.0), depth_m),
    )
    return [wall(f"{name}_{side}", centre @ pose, length_m) for side, pose, length_m in sides]


def wall(name: str, pose: SE2, length_m: float) -> dict[str, Any]:
    """A wall by its middle."""
    x, y, yaw = (round(value, 4) for value in pose)
    return {"name": name, "length_m": round(length_m, 4), "x_m": x, "y_m": y, "yaw_rad": yaw}


def start(x_m: float, y_m: float, yaw_rad: float = 0.0) -> dict[str, float]:
    """A start pose."""
    return {"x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad}


def corridor_30x2() -> BenchWorld:
    """A corridor without features along 30 m."""
    return made("bench_corridor", {"walls": fenced(30.0, 2.0), "start": start(-14.0, 0.0)})


def hall(pillars: bool) -> BenchWorld:
    """A hall of 20 m square, empty or with nine pillars."""
    recipe: dict[str, Any] = {"walls": fenced(20.0, 20.0), "start": start(-8.0, -8.0, 0.8)}
    if pillars:
        recipe["cylinders"] = [
            {"name": f"pillar_{i}_{j}", "x_m": 5.0 * i, "y_m": 5.0 * j, "radius_m": 0.25,
             "height_m": 1.0}
            for i in (-1, 0, 1) for j in (-1, 0, 1)
        ]  # fmt: skip
    return made("bench_hall_pillars" if pillars else "bench_hall", recipe)


def yard() -> BenchWorld:
    """A closed house of 6 by 5 m in a fenced yard of 26 by 26 m: in the middle of the lawn
    nothing is within the lidar's 3.5 m.
    """
    house = ring("house", SE2(0.0, 0.0, 0.0), 6.0, 5.0)
    return made("bench_yard", {"walls": [*fenced(26.0, 26.0), *house], "start": start(-4.5, -4.0)})


def two_rooms() -> BenchWorld:
    """Two rooms of 4 by 4 m, joined by one door 1 m wide at (0, 0)."""
    middle = [
        wall("middle_south", SE2(0.0, -1.25, math.pi / 2.0), 1.5),
        wall("middle_north", SE2(0.0, 1.25, math.pi / 2.0), 1.5),
    ]
    return made(
        "bench_two_rooms", {"walls": [*fenced(8.0, 4.0), *middle], "start": start(-3.0, 0.0)}
    )


def docks() -> BenchWorld:
    """A room of 5 by 4 m with a marker of 0.12 m on three of its walls, low enough for the camera
    to see it whole from 0.33 m away.
    """
    sides = {7: ("fence_east", "left"), 8: ("fence_north", "right"), 9: ("fence_west", "right")}
    markers = [
        {"id": number, "wall": name, "side": side, "size_m": 0.12, "height_m": 0.12}
        for number, (name, side) in sides.items()
    ]
    return made(
        "bench_docks", {"walls": fenced(5.0, 4.0), "markers": markers, "start": start(0.0, 0.0)}
    )


DOOR_WIDTH_M = 1.0

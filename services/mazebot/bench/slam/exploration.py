"""Compares ways of choosing frontiers without physics, on the true maps of worlds:

python -m mazebot.bench.slam.exploration [--quick] [--world NAME] [--seeds N] [--json OUT]

A disc drives along the cheapest way, cell by cell, and a lidar without noise reveals the map. The
offline tour knows the map: few places from where all of the floor is seen, and a short round trip.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from mazebot.bench.slam.exploration_kernels import mark_seen, reveal
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.world.costmap import Cells, reachable_from, traversable
from mazebot.explorer.choice import costs_between, tour_through
from mazebot.explorer.exploration import Aim, Survey, aim, survey
from mazebot.explorer.floor import floor_from
from mazebot.explorer.params import ExplorerParams, Policy
from mazebot.explorer.paths import search, way
from mazebot.worldgen.files import load_any

BEAMS = 360
_SPEED_M_S = 0.4
_TOUR_STRIDE = 3
"""The offline tour stands at every so many coarse cells at most."""
_SHARES = (0.90, 0.95, 0.99)

WORLDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "original": ("sim_house", ()),
    "enhanced": ("sim_house_enhanced", ()),
    "slam": ("sim_house_slam", ()),
    "maze": ("maze", ("maze.rows=10", "maze.columns=10", "maze.seed={seed}")),
    "loops": (
        "maze", ("maze.rows=10", "maze.columns=10", "maze.seed={seed}", "maze.braiding=0.5"),
    ),
}  # fmt: skip
"""Name in the tables: the world's name, and its overrides."""
_SEEDED = ("maze", "loops")


@dataclass(frozen=True, eq=False)
class Place:
    """A world's true map."""

    cells: Cells
    resolution_m: float
    origin: SE2
    start: SE2

    def cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """(row, column) of a place."""
        return (
            int((y_m - self.origin.y_m) / self.resolution_m),
            int((x_m - self.origin.x_m) / self.resolution_m),
        )

    def reachable(self, radius_m: float) -> NDArray[np.bool_]:
        """(rows, columns) where the robot's centre can be."""
        free, _ = traversable(self.cells, self.resolution_m, radius_m)
        row, column = self.cell(self.start.x_m, self.start.y_m)
        return reachable_from(free, row, column, 0.5 / self.resolution_m)


@dataclass(frozen=True)
class Explored:
    """How one exploration went."""

    world: str
    seed: int
    policy: str
    driven_m: float
    """In all, with the way home."""
    explored_m: float
    """Until nothing was left to see."""
    seen_share: float
    """Of the floor that the robot's centre can reach."""
    to_share_m: tuple[float, ...]
    """Driven until 90, 95 and 99 % of it were seen."""
    goals: int
    slowest_ms: float
    median_ms: float
    tour_m: float
    """Of the offline tour."""


def place_of(world: str, seed: int) -> Place:
    """The true map of one of WORLDS."""
    name, overrides = WORLDS[world]
    loaded = load_any(name, overrides=[one.format(seed=seed) for one in overrides])
    return Place(
        np.ascontiguousarray(loaded.map_cells), loaded.world.map_resolution_m, loaded.map_origin,
        loaded.world.start.se2(),
    )  # fmt: skip


class _Run:
    """One exploration without physics."""

    def __init__(self, place: Place, params: ExplorerParams) -> None:
        self._place, self._params = place, params
        self.known = np.full(place.cells.shape, -1, np.int8)
        self._wanted = place.reachable(params.robot_radius)
        self.robot = place.start
        self.driven_m = 0.0
        self.goals = 0
        self.taken_ms: list[float] = []
        self.to_share_m = [float("inf")] * len(_SHARES)
        self.trace = [self.robot]
        self._look()

    def share(self) -> float:
        """Of the reachable floor that is known."""
        seen = np.count_nonzero(self.known[self._wanted] == 0)
        return float(seen / np.count_nonzero(self._wanted))

    def go(self, most_m: float) -> float:
        """Explore, then drive home; returns what was driven until nothing was left to see."""
        place, params = self._place, self._params
        step_m = _SPEED_M_S / params.planner_frequency
        to_its_end = params.choice == "nearest"
        current: Aim | None = None
        seen: Survey | None = None
        while self.driven_m < most_m:
            begun = time.perf_counter()
            seen = survey(
                params, self.known, place.resolution_m, place.origin, self.robot, place.start, seen
            )
            following = aim(params, seen, place.start, current)
            self.taken_ms.append((time.perf_counter() - begun) * 1e3)
            if following is None:
                break
            self.goals += current is None or following.is_for_another(current)
            current = following
            if not self._drive(following.pose, most_m if to_its_end else step_m, seen.gaps):
                raise RuntimeError(f"stands at {self.robot} before {following}")
        explored_m = self.driven_m
        if params.return_to_init:
            self._drive(place.start, most_m, seen is not None and seen.gaps)
        return explored_m

    def _drive(self, goal: SE2, most_m: float, gaps: bool) -> bool:
        """Drive towards a goal, also through gaps; whether the robot has moved."""
        place, params = self._place, self._params
        floor = floor_from(
            self.known, place.resolution_m, place.origin, self.robot, params.robot_radius,
            params.start_tolerance, params.inscribed_radius if gaps else None,
        )  # fmt: skip
        start = floor.coarse_index(self.robot.x_m, self.robot.y_m)
        end = floor.coarse_index(goal.x_m, goal.y_m)
        if start is None or end is None or start == end:
            return False
        _, parents = search(floor.prices, start)
        driven_m = 0.0
        for index in way(parents, end)[1:]:
            x_m, y_m = floor.center(*floor.stand(index))
            row, column = divmod(index, int(floor.prices.shape[1]))
            middle = (floor.factor - 1) / 2.0
            x_m, y_m = floor.center(row * floor.factor + middle, column * floor.factor + middle)
            moved_m = self.robot.distance_m(SE2(x_m, y_m, 0.0))
            driven_m += moved_m
            self.driven_m += moved_m
            self.robot = SE2(x_m, y_m, 0.0)
            self.trace.append(self.robot)
            self._look()
            if driven_m >= most_m:
                break
        return driven_m > 0.0

    def _look(self) -> None:
        place = self._place
        row = (self.robot.y_m - place.origin.y_m) / place.resolution_m - 0.5
        column = (self.robot.x_m - place.origin.x_m) / place.resolution_m - 0.5
        range_cells = self._params.max_range / place.resolution_m
        reveal(place.cells, row, column, range_cells, BEAMS, self.known)
        share = self.share()
        for i, least in enumerate(_SHARES):
            if share >= least:
                self.to_share_m[i] = min(self.to_share_m[i], self.driven_m)


POLICIES: tuple[Policy, ...] = ("nearest", "gain", "tour")


def explore(
    world: str, seed: int, policy: Policy, more: dict[str, Any] | None = None, most_m: float = 300.0
) -> Explored:
    """Explore one of WORLDS by a choice; `more` are other parameters of the explorer."""
    place = place_of(world, seed)
    params = ExplorerParams(choice=policy, **(more or {}))
    run = _Run(place, params)
    explored_m = run.go(most_m)
    return Explored(
        world, seed, policy, run.driven_m, explored_m, run.share(), tuple(run.to_share_m),
        run.goals, max(run.taken_ms), float(np.median(run.taken_ms)), _offline_tour_m(world, seed),
    )  # fmt: skip


@cache
def _offline_tour_m(world: str, seed: int) -> float:
    return offline_tour_m(place_of(world, seed), ExplorerParams())


def offline_tour_m(place: Place, params: ExplorerParams) -> float:
    """Length of a round trip that sees 99.9 % of the floor, planned on the true map: each time the
    place that shows most of what is left (Johnson, 1974), and a tour by 2-opt and Or-opt.
    """
    floor = floor_from(
        place.cells, place.resolution_m, place.origin, place.start, params.robot_radius,
        params.start_tolerance,
    )  # fmt: skip
    columns = int(floor.prices.shape[1])
    ways = np.flatnonzero(floor.prices.reshape(-1) > 0)
    row, column = np.divmod(ways, columns)
    candidates = ways[(row % _TOUR_STRIDE == 0) & (column % _TOUR_STRIDE == 0)]
    wanted = np.flatnonzero(floor.reachable.reshape(-1))
    views = np.zeros((len(candidates) + 1, len(wanted)), np.bool_)
    start = floor.coarse_index(place.start.x_m, place.start.y_m)
    assert start is not None
    candidates = np.append(candidates, start)
    for i, index in enumerate(candidates):
        seen = np.zeros(floor.cells.shape, np.bool_)
        range_cells = params.max_range / place.resolution_m
        mark_seen(floor.cells, *floor.stand(int(index)), range_cells, 4 * BEAMS, seen)
        views[i] = seen.reshape(-1)[wanted]
    left = ~views[-1]
    chosen: list[int] = []
    while np.count_nonzero(left) > 0.001 * len(wanted):
        gains = np.count_nonzero(views & left, axis=1)
        best = int(np.argmax(gains))
        if gains[best] == 0:
            break
        chosen.append(int(candidates[best]))
        left &= ~views[best]
    costs = costs_between(floor, [start, *chosen, start])
    tour, _ = tour_through(costs)
    places = [start, *chosen, start]
    total_m = 0.0
    for one, two in itertools.pairwise(tour):
        _, parents = search(floor.prices, places[one])
        cells = np.array(way(parents, places[two]))
        steps = np.abs(np.diff(np.stack(np.divmod(cells, columns))))
        total_m += float(np.sqrt((steps * steps).sum(0)).sum()) * floor.metres(100)
    return total_m


def main(
    world: Annotated[
        list[str] | None, typer.Option("--world", help=f"of {', '.join(WORLDS)}; all")
    ] = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="mazes of each kind")] = 5,
    quick: Annotated[bool, typer.Option("--quick", help="one maze of each kind")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="output file of the figures")
    ] = None,
) -> None:
    """Print the figures of each world, and in the mean of each kind."""
    for name in world or ():
        if name not in WORLDS:
            raise ConfigError(f"--world: {name}: must be one of {', '.join(WORLDS)}")
    console = Console()
    found = []
    for one in _all(tuple(world or WORLDS), 1 if quick else seeds):
        found.append(one)
        console.print(
            f"{one.world} {one.seed}, {one.policy}: {one.driven_m:.1f} m, "
            f"{100.0 * one.seen_share:.1f} % seen, {one.driven_m / one.tour_m:.2f} tours"
        )
    console.print(_table(found))
    if json_file is not None:
        json_file.write_text(json.dumps([asdict(one) for one in found], indent=2) + "\n")


def _all(worlds: tuple[str, ...], seeds: int) -> Iterator[Explored]:
    for world in worlds:
        for seed in range(1, seeds + 1) if world in _SEEDED else (0,):
            for policy in POLICIES:
                yield explore(world, seed, policy)


def _table(found: list[Explored]) -> Table:
    """Means by world and choice."""
    table = Table(title="exploration, means")
    shares = [f"to {100.0 * share:.0f} %, m" for share in _SHARES]
    for name in (
        "world", "choice", *shares, "driven, m", "by nearest", "by the tour", "at most", "seen",
        "median, ms",
    ):  # fmt: skip
        table.add_column(name, justify="left" if name in ("world", "choice") else "right")
    for world in dict.fromkeys(one.world for one in found):
        nearest = [one.driven_m for one in found if (one.world, one.policy) == (world, "nearest")]
        for policy in POLICIES:
            ours = [one for one in found if (one.world, one.policy) == (world, policy)]
            driven_m = np.array([one.driven_m for one in ours])
            by_tour = driven_m / np.array([one.tour_m for one in ours])
            to_m = np.array([one.to_share_m for one in ours]).mean(0)
            table.add_row(
                world, policy, *(f"{value:.1f}" for value in to_m), f"{driven_m.mean():.1f}",
                f"{driven_m.sum() / sum(nearest):.2f}", f"{by_tour.mean():.2f}",
                f"{by_tour.max():.2f}", f"{100.0 * min(one.seen_share for one in ours):.1f} %",
                f"{np.median([one.median_ms for one in ours]):.1f}",
            )  # fmt: skip
    return table


if __name__ == "__main__":
    try:
        typer.run(main)
    except ConfigError as error:
        sys.stderr.write(f"error: {error}\n")
        raise SystemExit(2) from None

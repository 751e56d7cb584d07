"""Times the global planner, and compares its paths with the optimum:

python -m mazebot.bench.parts.planning_bench [--quick] [--map FILE.map --scen FILE.scen]
    [--json OUT]
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console

from mazebot.bench.bench_figures import Figure, as_json, figure, machine, tables
from mazebot.bench.parts.planning_maps import (
    KINDS,
    Problem,
    Solid,
    read_movingai_map,
    read_movingai_scen,
)
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.world.grids import connected_regions
from mazebot.navigation.costmap.layered_costmap import Costmap, InflationParams, frame_of, inflate
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.interface import GridPlannerParams
from mazebot.navigation.planning.planner import Planner, PlannerParams

_RESOLUTION_M = 0.05
_PARAMS = PlannerParams(GridPlannerParams(cost_travel_multiplier=0.0), _RESOLUTION_M, 100)
_INFLATION = InflationParams(custom_inscribed_radius=0.0, cost_scaling_factor=10.0)
_WEIGHTED = 1.0
_NO_OPTIMUM = 1e-9

Question = tuple[SE2, SE2]


class Answer(NamedTuple):
    """One path."""

    taken_ms: float
    cost: float
    """In cells."""


def main(
    map_file: Annotated[Path | None, typer.Option("--map", help="a MovingAI .map file")] = None,
    scen_file: Annotated[Path | None, typer.Option("--scen", help="its .scen file")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="few queries on small maps")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="output file of the figures")
    ] = None,
) -> None:
    """Print the figures."""
    if (map_file is None) != (scen_file is None):
        raise ConfigError("--map and --scen: must be given together")
    if map_file is not None and scen_file is not None:
        figures = on_benchmark(map_file, scen_file, 20 if quick else 1000)
    else:
        figures = on_made_maps((100,) if quick else (400, 2000), 3 if quick else 30)
    console = Console()
    for table in tables(figures):
        console.print(table)
    if json_file is not None:
        json_file.write_text(json.dumps(as_json(figures, machine()), indent=2) + "\n")


def on_benchmark(map_file: Path, scen_file: Path, most: int) -> list[Figure]:
    """Figures of up to `most` problems of a benchmark, evenly chosen."""
    solid = read_movingai_map(map_file)
    problems = [one for one in read_movingai_scen(scen_file) if one.optimum > _NO_OPTIMUM]
    for one in problems:
        for row, column in (one.start, one.goal):
            if not (0 <= row < solid.shape[0] and 0 <= column < solid.shape[1]):
                raise ConfigError(f"{scen_file}: ({column}, {row}): must be in {map_file}")
    chosen = problems[:: max(1, -(-len(problems) // most))]
    costmap = costmap_of(solid)
    asked = [_question(costmap, one) for one in chosen]
    best = np.array([one.optimum for one in chosen])
    return list(_compared(map_file.stem, costmap, asked, best))


def on_made_maps(sides: tuple[int, ...], count: int) -> list[Figure]:
    """Figures of each kind of map by seed."""
    figures: list[Figure] = []
    for side in sides:
        for kind, make in KINDS.items():
            costmap = costmap_of(make(side, np.random.default_rng(1)))
            possible, impossible = questions(costmap, count)
            label = f"{kind} {side} x {side}"
            figures += _compared(label, costmap, possible, None)
            taken_ms = [_refused_ms(Planner(_PARAMS), costmap, one) for one in impossible]
            figures.append(
                figure(label, "impossible goal", "ms", taken_ms[1:], "no such goal on this map")
            )
    return figures


def costmap_of(solid: Solid) -> Costmap:
    """The costmap of a point on (rows, columns) obstacles."""
    frame = frame_of(_RESOLUTION_M, SE2(0.0, 0.0, 0.0), solid.astype(np.int8))
    return inflate(frame, solid, np.zeros_like(solid), _INFLATION)


def questions(costmap: Costmap, count: int) -> tuple[list[Question], list[Question]]:
    """Pairs of cells in the largest region, and from it to other ones."""
    free = costmap.costs < 253
    regions = connected_regions(free)
    sizes = np.bincount(regions.ravel())
    sizes[0] = 0
    random = np.random.default_rng(2)
    inside = np.argwhere(regions == int(np.argmax(sizes)))
    outside = np.argwhere(free & (regions != int(np.argmax(sizes))))

    def pose(cell: NDArray[np.int64]) -> SE2:
        return SE2(*costmap.frame.center(int(cell[0]), int(cell[1])), 0.0)

    chosen = random.integers(0, len(inside), (count, 2))
    possible = [(pose(inside[a]), pose(inside[b])) for a, b in chosen]
    if not len(outside):
        return possible, []
    others = random.integers(0, len(outside), count)
    return possible, [(possible[i][0], pose(outside[k])) for i, k in enumerate(others)]


def _question(costmap: Costmap, problem: Problem) -> Question:
    start, goal = (SE2(*costmap.frame.center(*cell), 0.0) for cell in (problem[0], problem[1]))
    return start, goal


def _compared(
    label: str, costmap: Costmap, asked: list[Question],
    optimum: Array | None,
) -> Iterator[Figure]:  # fmt: skip
    for weight in (0.0, _WEIGHTED):
        params = replace(_PARAMS, settings=GridPlannerParams(cost_travel_multiplier=weight))
        exact = replace(params, algorithm="a_star", smoothing_iterations=0)
        answers = [_answers(Planner(exact), costmap, asked)]
        answers += [
            _answers(Planner(replace(params, algorithm=name)), costmap, asked)
            for name in ("a_star", "any_angle")
        ]
        best = np.array([one.cost for one in answers[0]])
        if optimum is not None and weight <= 0.0:
            best = optimum
        some = best > _NO_OPTIMUM
        for name, found in zip(("a_star unsmoothed", "a_star", "any_angle"), answers, strict=True):
            full = f"{name}, cost weight {weight:g}"
            yield figure(label, full, "ms", [one.taken_ms for one in found])
            ratio = np.array([one.cost for one in found])[some] / best[some]
            yield figure(label, f"{full}: cost / optimum of 8 directions", "", list(ratio))


def _answers(planner: Planner, costmap: Costmap, asked: list[Question]) -> list[Answer]:
    found = []
    planner.plan(costmap, *asked[0])
    for start, goal in asked:
        begun_s = time.perf_counter()
        path = planner.plan(costmap, start, goal)
        taken_ms = (time.perf_counter() - begun_s) * 1e3
        found.append(Answer(taken_ms, path.cost_m / _RESOLUTION_M))
    return found


def _refused_ms(planner: Planner, costmap: Costmap, asked: Question) -> float:
    begun_s = time.perf_counter()
    try:
        planner.plan(costmap, *asked)
    except NavigationError:
        return (time.perf_counter() - begun_s) * 1e3
    raise AssertionError(f"a path from {asked[0]} to {asked[1]}, which are not connected")


if __name__ == "__main__":
    try:
        typer.run(main)
    except ConfigError as error:
        sys.stderr.write(f"error: {error}\n")
        raise SystemExit(2) from None

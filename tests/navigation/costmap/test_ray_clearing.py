"""Which cells a scan's rays clear: those in which one of their steps ends, found ray by ray."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.navigation.costmap.obstacle_layer import NOTHING_MOVES, ObstacleLayer, ObstacleParams

ROWS, COLUMNS, RESOLUTION_M = 90, 110, 0.05
RAYTRACE_M = 3.0
MARK_M = 2.5

Cells = set[tuple[int, int]]

WAYS = [
    pytest.param(0.0, 2.0 * math.pi / 360.0, 360, id="a turn"),
    pytest.param(-12.0, 2.0 * math.pi / 100.0, 100, id="a turn from far behind 0"),
    pytest.param(1.0, -2.0 * math.pi / 360.0, 360, id="clockwise"),
    pytest.param(-0.5, 0.01, 101, id="a part of a turn"),
    pytest.param(0.3, 0.05, 300, id="more than two turns"),
    pytest.param(0.7, 2.5, 5, id="fewer rays than sides of a cell"),
]


def passed(
    sensor: tuple[float, float, float], first_rad: float, step_rad: float, lengths: list[float]
) -> list[tuple[int, int, int]]:
    """Row, column and number of each step of all rays; a step is a cell long."""
    found = []
    for i, length in enumerate(lengths):
        angle_rad = first_rad + sensor[2] + step_rad * i
        for step in range(int(length) + 1 if length > -1.0 else 0):
            row = math.floor(sensor[1] + math.sin(angle_rad) * step)
            column = math.floor(sensor[0] + math.cos(angle_rad) * step)
            found.append((row, column, step))
    return found


def scan_of(ranges_m: NDArray[np.float32], first_rad: float, step_rad: float) -> Scan:
    return Scan(ranges_m, first_rad, step_rad, 0.05, 3.5, SE2(0.0, 0.0, 0.0))


def cells_of(layer: ObstacleLayer) -> Cells:
    return {(int(r), int(c)) for r, c in np.argwhere(layer.marked)}


@pytest.mark.parametrize(("first_rad", "step_rad", "count"), WAYS)
@pytest.mark.parametrize("seed", range(4))
def test_a_ray_without_echo_clears_what_was_seen_once(
    first_rad: float, step_rad: float, count: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    layer = ObstacleLayer(ROWS, COLUMNS, ObstacleParams())
    # Off the axes, so that no step ends on an edge of cells.
    sensor = (float(random.uniform(40, 70)), float(random.uniform(30, 60)), 0.1234567)
    seen = random.uniform(0.3, MARK_M, 360).astype(np.float32)
    layer.update(
        scan_of(seen, 0.0, 2.0 * math.pi / 360.0), sensor, RESOLUTION_M, None, NOTHING_MOVES
    )
    before = cells_of(layer)

    empty = np.full(count, np.inf, np.float32)
    layer.update(scan_of(empty, first_rad, step_rad), sensor, RESOLUTION_M, None, NOTHING_MOVES)

    steps = passed(sensor, first_rad, step_rad, [RAYTRACE_M / RESOLUTION_M] * count)
    cleared = before & {(row, column) for row, column, _ in steps}
    assert cleared
    assert cells_of(layer) == before - cleared


@pytest.mark.parametrize(("first_rad", "step_rad", "count"), WAYS[:2] + WAYS[3:5])
@pytest.mark.parametrize("seed", range(4))
def test_a_ray_with_an_echo_clears_what_is_near_before_it(
    first_rad: float, step_rad: float, count: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    layer = ObstacleLayer(ROWS, COLUMNS, ObstacleParams())
    sensor = (float(random.uniform(40, 70)), float(random.uniform(30, 60)), -2.3456789)
    everywhere = np.argwhere(random.random((ROWS, COLUMNS)) < 0.3)
    layer.mark(everywhere)
    before = cells_of(layer)

    ranges_m = random.uniform(MARK_M + 0.1, RAYTRACE_M, count).astype(np.float32)
    layer.update(scan_of(ranges_m, first_rad, step_rad), sensor, RESOLUTION_M, None, NOTHING_MOVES)

    lengths = [(float(one) - RESOLUTION_M) / RESOLUTION_M for one in ranges_m]
    steps = passed(sensor, first_rad, step_rad, lengths)
    near = {(row, column) for row, column, step in steps if 2.0 * step * step_rad <= 1.0}
    assert before & near
    assert cells_of(layer) == before - near


def test_a_ray_without_echo_clears_nothing_beyond_the_sensors_range() -> None:
    layer = ObstacleLayer(ROWS, COLUMNS, ObstacleParams())
    sensor = (50.1, 45.1, 0.1234567)
    step_rad = 2.0 * math.pi / 360.0
    seen = scan_of(np.full(360, 1.5, np.float32), 0.0, step_rad)
    layer.update(seen, sensor, RESOLUTION_M, None, NOTHING_MOVES)
    before = cells_of(layer)
    short = replace(scan_of(np.full(360, np.inf, np.float32), 0.0, step_rad), range_max_m=1.0)
    for _ in range(20):
        layer.update(short, sensor, RESOLUTION_M, None, NOTHING_MOVES)
    assert cells_of(layer) == before

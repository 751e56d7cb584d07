from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from services.common.documents import Wall
from services.worldgen.loader import load_world
from services.worldgen.occupancy import Grid, occupancy, rasterise, wall_corners


def wall(length_m: float, thickness_m: float, x_m: float, y_m: float, yaw_rad: float) -> Wall:
    return Wall(
        name="wall", length_m=length_m, thickness_m=thickness_m, height_m=1.0, x_m=x_m, y_m=y_m,
        yaw_rad=yaw_rad, material="plain",
    )  # fmt: skip


def cell_boxes(grid: Grid, cells: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> list[object]:
    rows, columns = np.nonzero(cells)
    x = grid.origin.x_m + columns * grid.resolution_m
    y = grid.origin.y_m + rows * grid.resolution_m
    return list(shapely.box(x, y, x + grid.resolution_m, y + grid.resolution_m))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.floats(0.05, 3.0), st.floats(0.05, 0.5), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0),
    st.floats(-math.pi, math.pi),
)  # fmt: skip
def test_a_cell_is_occupied_exactly_where_a_wall_reaches_into_it(
    length_m: float, thickness_m: float, x_m: float, y_m: float, yaw_rad: float
) -> None:
    one = wall(length_m, thickness_m, x_m, y_m, yaw_rad)
    grid = Grid([one], 0.05, margin_m=0.2)
    occupied = rasterise([one], grid)
    footprint = shapely.Polygon(wall_corners(one))
    inside = shapely.area(shapely.intersection(cell_boxes(grid, occupied), footprint))
    assert (shapely.distance(cell_boxes(grid, occupied), footprint) < 1e-5).all()
    assert inside.sum() == pytest.approx(footprint.area, abs=1e-5)
    outside = shapely.area(shapely.intersection(cell_boxes(grid, ~occupied), footprint))
    assert outside.max(initial=0.0) < 1e-6


@pytest.mark.parametrize("name", ["sim_house", "sim_house_enhanced"])
def test_no_wall_is_far_from_an_occupied_cell_nor_the_other_way(name: str) -> None:
    loaded = load_world(name)
    walls = loaded.world.walls
    grid = Grid(walls, loaded.world.map_resolution_m)
    assert grid.origin == loaded.map_origin
    occupied = shapely.union_all(cell_boxes(grid, loaded.map_cells == 100))
    footprint = shapely.union_all([shapely.Polygon(wall_corners(w)) for w in walls])
    half_diagonal_m = 0.05 * math.sqrt(2.0) / 2.0
    assert footprint.difference(occupied.buffer(1e-5)).is_empty
    centres = shapely.centroid(cell_boxes(grid, loaded.map_cells == 100))
    assert shapely.distance(centres, footprint).max() <= half_diagonal_m + 1e-9


def test_only_the_floor_connected_to_the_start_is_free() -> None:
    box = [
        wall(2.2, 0.2, 0.0, 1.0, 0.0), wall(2.2, 0.2, 0.0, -1.0, 0.0),
        wall(2.2, 0.2, 1.0, 0.0, math.pi / 2), wall(2.2, 0.2, -1.0, 0.0, math.pi / 2),
    ]  # fmt: skip
    grid = Grid(box, 0.1)
    inside, outside = grid.cell(0.0, 0.0), grid.cell(-1.5, -1.5)
    assert inside is not None
    assert outside is not None
    assert occupancy(box, grid, inside)[inside] == 0
    assert occupancy(box, grid, inside)[outside] == -1
    assert occupancy(box, grid, outside)[inside] == -1
    assert (occupancy(box, grid, inside) == 0).sum() == 18 * 18
    # Open at one side, the inside and the outside are one floor.
    assert occupancy(box[1:], grid, inside)[outside] == 0


def test_row_zero_is_at_the_smallest_y() -> None:
    low, high = wall(0.2, 0.2, 0.0, 0.0, 0.0), wall(0.2, 0.2, 3.0, 5.0, 0.0)
    grid = Grid([low, high], 0.1)
    occupied = rasterise([low, high], grid)
    row, column = (int(v) for v in np.argwhere(occupied)[0])
    assert grid.cell(-0.05, -0.05) == (row, column)
    assert row < grid.rows / 2
    assert grid.cell(-1e9, 0.0) is None

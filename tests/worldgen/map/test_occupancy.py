from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, quaternion_from_yaw
from mazebot.common.messages.documents import (
    Body,
    Box,
    Cylinder,
    Location,
    Planar,
    Shape,
    Wall,
    World,
)
from mazebot.common.world.footprint import wall_corners
from mazebot.worldgen.map.occupancy import (
    OPEN_CELLS,
    Grid,
    fill,
    floor_map,
    grid_around,
    grid_of,
    occupancy,
    rasterise,
)
from mazebot.worldgen.recipe.loader import load_world


def wall(length_m: float, thickness_m: float, x_m: float, y_m: float, yaw_rad: float) -> Wall:
    return Wall(
        name="wall", length_m=length_m, thickness_m=thickness_m, height_m=1.0, x_m=x_m, y_m=y_m,
        yaw_rad=yaw_rad, material="plain",
    )  # fmt: skip


def world(
    *walls: Wall,
    bodies: tuple[Body, ...] = (),
    start: tuple[float, float] = (0.0, 0.0),
    resolution_m: float = 0.1,
    locations: tuple[Location, ...] = (),
) -> World:
    return World(
        name="w", recipe="w.yaml", hash="", walls=walls, materials=(), bodies=bodies,
        locations=locations, start=Planar(x_m=start[0], y_m=start[1], yaw_rad=0.0),
        map_resolution_m=resolution_m,
    )  # fmt: skip


def crate(x_m: float, y_m: float, z_m: float = 0.25, yaw_rad: float = 0.0) -> Body:
    return Body(
        name="crate", position_m=(x_m, y_m, z_m), orientation_xyzw=quaternion_from_yaw(yaw_rad),
        shapes=(Shape(name="box", geometry=Box(size_m=(0.4, 0.4, 0.5))),),
    )  # fmt: skip


def cell_boxes(grid: Grid, cells: NDArray[np.bool_]) -> list[object]:
    rows, columns = np.nonzero(cells)
    x = grid.origin.x_m + columns * grid.resolution_m
    y = grid.origin.y_m + rows * grid.resolution_m
    return list(shapely.box(x, y, x + grid.resolution_m, y + grid.resolution_m))


def assert_exact(polygon: NDArray[np.float64], occupied: NDArray[np.bool_], grid: Grid) -> None:
    footprint = shapely.Polygon(polygon)
    boxes = cell_boxes(grid, occupied)
    inside = shapely.area(shapely.intersection(boxes, footprint))
    assert (shapely.distance(boxes, footprint) < 1e-5).all()
    assert inside.sum() == pytest.approx(footprint.area, abs=1e-5)
    outside = shapely.area(shapely.intersection(cell_boxes(grid, ~occupied), footprint))
    assert outside.max(initial=0.0) < 1e-6


@settings(max_examples=60)
@given(
    st.floats(0.05, 3.0), st.floats(0.05, 0.5), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0),
    st.floats(-math.pi, math.pi),
)  # fmt: skip
def test_a_cell_is_occupied_exactly_where_a_wall_reaches_into_it(
    length_m: float, thickness_m: float, x_m: float, y_m: float, yaw_rad: float
) -> None:
    one = wall(length_m, thickness_m, x_m, y_m, yaw_rad)
    grid = grid_of(world(one, resolution_m=0.05), {}, margin_m=0.2)
    corners = np.array(wall_corners(one))
    assert_exact(corners, rasterise([corners[None]], grid), grid)


@pytest.mark.parametrize("seed", range(20))
def test_a_cell_is_occupied_exactly_where_a_convex_polygon_reaches_into_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hull = shapely.convex_hull(shapely.multipoints(rng.normal(0.0, 0.4, (3 + seed, 2))))
    corners = shapely.get_coordinates(hull)[:-1][:: (-1) ** seed]
    grid = grid_around(corners.min(0), corners.max(0), 0.05, 0.2)
    assert_exact(corners, rasterise([corners[None]], grid), grid)


def test_polygons_outside_the_grid_are_cut_at_its_edges() -> None:
    grid = Grid(4, 4, 1.0, SE2(0.0, 0.0, 0.0))
    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    shifted = np.stack([square * 1.5, square + 4.0, square + 40.0, square - 40.0])
    expected = np.zeros((4, 4), np.bool_)
    expected[:2, :2] = expected[3, 3] = True
    assert np.array_equal(rasterise([shifted], grid), expected)


def test_what_only_touches_a_cell_is_not_in_it() -> None:
    grid = Grid(6, 6, 0.1, SE2(0.0, 0.0, 0.0))
    square = np.array([(0.1, 0.3), (0.3, 0.3), (0.3, 0.5), (0.1, 0.5)])
    occupied = rasterise([square[None]], grid)
    assert np.argwhere(occupied).tolist() == [[3, 1], [3, 2], [4, 1], [4, 2]]


def test_a_loop_fills_the_cells_whose_centres_it_winds_around() -> None:
    grid = Grid(10, 10, 1.0, SE2(-1.0, -1.0, 0.0))
    square = np.array([(0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (0.0, 6.0)])
    hole = np.array([(2.0, 2.0), (2.0, 4.0), (4.0, 4.0), (4.0, 2.0)])
    loops = [np.stack([loop, np.roll(loop, -1, axis=0)], axis=1) for loop in (square, hole)]
    filled = fill(np.concatenate(loops), grid)
    assert filled.sum() == 36 - 4
    assert filled[1, 1]
    assert not filled[3:5, 3:5].any()
    # Two loops of one turn wind around what either of them does.
    assert fill(np.concatenate([loops[0], loops[0] + 1.0]), grid).sum() == 36 + 36 - 25


def test_a_turned_grid_has_its_rows_along_its_own_axis() -> None:
    turned = Grid(40, 60, 0.1, SE2(1.0, -2.0, 0.5))
    straight = Grid(40, 60, 0.1, SE2(0.0, 0.0, 0.0))
    corners = np.array([(1.0, 1.0), (3.03, 1.4), (2.02, 3.01)])
    moved = np.array([(turned.origin @ SE2(x, y, 0.0))[:2] for x, y in corners])
    expected = rasterise([corners[None]], straight)
    assert np.array_equal(rasterise([moved[None]], turned), expected)
    x_m, y_m, _ = turned.origin @ SE2(2.04, 1.56, 0.0)
    assert turned.cell(x_m, y_m) == (15, 20)


@pytest.mark.parametrize("name", ["sim_house", "sim_house_enhanced"])
def test_no_wall_is_far_from_an_occupied_cell_nor_the_other_way(name: str) -> None:
    loaded = load_world(name)
    grid = grid_of(loaded.world, {})
    assert grid.origin == loaded.map_origin
    occupied = shapely.union_all(cell_boxes(grid, loaded.map_cells == 100))
    footprint = shapely.union_all([shapely.Polygon(wall_corners(w)) for w in loaded.world.walls])
    half_diagonal_m = 0.05 * math.sqrt(2.0) / 2.0
    assert footprint.difference(occupied.buffer(1e-5)).is_empty
    centres = shapely.centroid(cell_boxes(grid, loaded.map_cells == 100))
    assert shapely.distance(centres, footprint).max() <= half_diagonal_m + 1e-9


def test_only_the_floor_connected_to_the_start_is_free() -> None:
    box = [
        wall(2.2, 0.2, 0.0, 1.0, 0.0), wall(2.2, 0.2, 0.0, -1.0, 0.0),
        wall(2.2, 0.2, 1.0, 0.0, math.pi / 2), wall(2.2, 0.2, -1.0, 0.0, math.pi / 2),
    ]  # fmt: skip
    grid = grid_of(world(*box), {})
    inside, outside = grid.cell(0.0, 0.0), grid.cell(-1.5, -1.5)
    assert inside is not None
    assert outside is not None
    from_inside = occupancy(world(*box), {}, grid)
    assert from_inside[inside] == 0
    assert from_inside[outside] == -1
    assert occupancy(world(*box, start=(-1.5, -1.5)), {}, grid)[inside] == -1
    assert (from_inside == 0).sum() == 17 * 17
    # Open at one side, the inside and the outside are one floor.
    assert occupancy(world(*box[1:]), {}, grid)[outside] == 0
    # Nothing is known of a floor whose start is in a wall or off the map.
    for start in ((1.0, 0.0), (99.0, 0.0)):
        assert set(np.unique(occupancy(world(*box, start=start), {}, grid))) == {-1, 100}


def test_bodies_are_on_the_map_as_walls_are() -> None:
    south = wall(4.0, 0.2, 0.0, -1.0, 0.0)
    bodies = (crate(1.0, 1.0), crate(-1.0, 1.0, z_m=0.6))
    both = world(south, bodies=bodies)
    grid = grid_of(both, {})
    cells = occupancy(both, {}, grid)
    assert cells[grid.cell(1.15, 0.85) or (0, 0)] == 100
    assert cells[grid.cell(-1.0, 1.0) or (0, 0)] == 0
    assert (cells == 100).sum() == 41 * 3 + 5 * 5


def test_without_walls_the_floor_reaches_around_start_and_locations() -> None:
    far = Location(name="far", x_m=-5.0, y_m=7.0, yaw_rad=0.0)
    open_floor = world(bodies=(crate(2.0, 0.0),), start=(3.0, -4.0), locations=(far,))
    grid = grid_of(open_floor, {})
    cells = occupancy(open_floor, {}, grid)
    assert grid.origin == pytest.approx((-6.05, -5.05, 0.0))
    assert (grid.columns, grid.rows) == (101, 131)
    assert (cells == 0).sum() == 101 * 131 - 25
    assert grid_of(world(), {}).rows == 20


def test_too_many_cells_are_a_mistake_before_they_are_made() -> None:
    low, high = np.array([-1e6, -1e6]), np.array([1e6, 1e6])
    with pytest.raises(ValueError, match=r"^makes 20000020 x 20000020 cells: must be coarser"):
        grid_around(low, high, 0.1, 1.0)
    far = world(wall(0.2, 0.2, -900.0, 0.0, 0.0), wall(0.2, 0.2, 900.0, 900.0, 0.0))
    with pytest.raises(ValueError, match="for at most 16000000 cells"):
        grid_of(far, {})


def test_row_zero_is_at_the_smallest_y() -> None:
    low, high = wall(0.2, 0.2, 0.0, 0.0, 0.0), wall(0.2, 0.2, 3.0, 5.0, 0.0)
    grid = grid_of(world(low, high), {})
    occupied = occupancy(world(low, high, start=(1.0, 1.0)), {}, grid) == 100
    row, column = (int(v) for v in np.argwhere(occupied)[0])
    assert grid.cell(-0.1, -0.1) == (row, column)
    assert row < grid.rows / 2
    assert grid.cell(-1e9, 0.0) is None


def test_many_cylinders_and_a_maze_are_rasterised_alike_in_any_order() -> None:
    rng = np.random.default_rng(5)
    bodies = tuple(
        Body(
            name=f"c{i}",
            position_m=(*rng.uniform(-20.0, 20.0, 2).tolist(), 0.5),
            shapes=(Shape(name="c", geometry=Cylinder(radius_m=0.3, length_m=1.0)),),
        )
        for i in range(60)
    )
    whole = world(bodies=bodies)
    grid = grid_of(whole, {})
    cells = occupancy(whole, {}, grid)
    backwards = whole.model_copy(update={"bodies": bodies[::-1]})
    assert np.array_equal(cells, occupancy(backwards, {}, grid))
    assert (cells == 100).sum() > 60 * 28


def test_the_map_of_open_floor_goes_on_around_what_stands_there() -> None:
    south = wall(4.0, 0.17, 0.0, -1.0, 0.0)
    tight = grid_of(world(south), {})
    grid, cells = floor_map(world(south), {})
    assert grid.cell(11.5, 8.5) is not None
    assert cells[grid.cell(-11.5, -10.5) or (0, 0)] == 0
    assert (cells == 100).sum() == (occupancy(world(south), {}, tight) == 100).sum()
    # Where the start is shut in, nothing beyond the walls can be reached.
    box = [
        wall(2.2, 0.17, 0.0, 1.0, 0.0), wall(2.2, 0.17, 0.0, -1.0, 0.0),
        wall(2.2, 0.17, 1.0, 0.0, math.pi / 2), wall(2.2, 0.17, -1.0, 0.0, math.pi / 2),
    ]  # fmt: skip
    shut = world(*box)
    grid, cells = floor_map(shut, {})
    assert grid == grid_of(shut, {})
    assert np.array_equal(cells, occupancy(shut, {}, grid))
    # A start outside is on open floor.
    outside = world(*box, start=(4.0, 0.0))
    grid, cells = floor_map(outside, {})
    assert cells[grid.cell(4.0, 0.0) or (0, 0)] == 0
    assert cells[grid.cell(0.0, 0.0) or (0, 0)] == -1


def test_the_map_of_open_floor_is_bounded() -> None:
    far = world(wall(0.2, 0.17, -20.0, 0.0, 0.0), wall(0.2, 0.17, 20.0, 40.0, 0.0))
    grid, _ = floor_map(far, {})
    assert (grid.columns, grid.rows) == (603, 602)
    fine = far.model_copy(update={"map_resolution_m": 0.05})
    grid, _ = floor_map(fine, {})
    assert 0.95 * OPEN_CELLS < grid.rows * grid.columns < 1.01 * OPEN_CELLS
    finer = far.model_copy(update={"map_resolution_m": 0.02})
    assert floor_map(finer, {})[0] == grid_of(finer, {})


@pytest.mark.parametrize(("at_m", "inset_cells"), [(1.0, 0.5), (1.05, 0.5), (1.02, 0.8)])
def test_faces_do_not_lie_on_the_boundaries_of_cells(at_m: float, inset_cells: float) -> None:
    """Localisation takes a wall's face to lie in the middle of its cells."""
    walls = [wall(4.0, 0.2, 0.0, -at_m, 0.0), wall(4.0, 0.2, 0.0, at_m, 0.0)]
    grid = grid_of(world(*walls), {})
    cells = occupancy(world(*walls), {}, grid)
    column = grid.cell(0.0, 0.0)[1]  # type: ignore[index]
    top = np.flatnonzero(cells[:, column] == 100)[-1] + 1
    beyond = (grid.origin.y_m + top * 0.1 - (at_m + 0.1)) / 0.1
    assert beyond == pytest.approx(inset_cells, abs=1e-6)

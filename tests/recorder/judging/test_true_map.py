"""What a perfect map of a world holds, and how a made map is compared with it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import documents as doc
from mazebot.recorder.judging.map.true_map import Lattice, TrueMap, true_map
from tests.recorder.synthetic import room

RESOLUTION_M = 0.05
FREE_M = 3.85
"""Inner side of the room: its walls' axes are 4 m apart, and 0.15 m thick."""


def box(
    x_m: float, y_m: float, size_m: tuple[float, float, float], z_m: float = 0.5, **changes: object
) -> doc.Body:
    shape = doc.Shape(name="box", geometry=doc.Box(size_m=size_m), material="plain")
    body = doc.Body(name=f"box {x_m} {y_m}", position_m=(x_m, y_m, z_m), shapes=(shape,))
    return body.model_copy(update=changes)


def world_with(*bodies: doc.Body, walls: tuple[doc.Wall, ...] = ()) -> doc.World:
    plain = room()
    return plain.model_copy(update={"bodies": bodies, "walls": (*plain.walls, *walls)})


def length_m(truth: TrueMap) -> float:
    return float(np.linalg.norm(truth.faces_m[:, 1] - truth.faces_m[:, 0], axis=1).sum())


def reachable_m2(truth: TrueMap) -> float:
    return int(np.count_nonzero(truth.reachable)) * truth.raster_m**2


def perfect(truth: TrueMap, origin: SE2, rows: int, columns: int) -> NDArray[np.int8]:
    """A map with every visible face in its cells, free within the room, and unknown outside."""
    y, x = np.meshgrid(np.arange(rows) + 0.5, np.arange(columns) + 0.5, indexing="ij")
    x, y = origin.x_m + RESOLUTION_M * x, origin.y_m + RESOLUTION_M * y
    inside = (abs(x) < FREE_M / 2) & (abs(y) < FREE_M / 2)
    cells = np.where(inside, 0, -1).astype(np.int8)
    at = (truth.faces_m.mean(axis=1) - origin[:2]) / RESOLUTION_M
    column, row = np.floor(at).astype(int).T
    kept = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    cells[row[kept], column[kept]] = 100
    return cells


def test_of_a_closed_room_the_inner_faces_and_the_robot_s_floor_count() -> None:
    truth = true_map(room(), {})
    assert length_m(truth) == pytest.approx(4 * FREE_M, abs=0.1)
    assert abs(truth.faces_m).max() == pytest.approx(FREE_M / 2, abs=0.01)
    assert reachable_m2(truth) == pytest.approx((FREE_M - 2 * 0.24) ** 2, rel=0.04)
    assert not truth.is_open


def test_what_the_lidar_cannot_meet_does_not_count() -> None:
    hanging = box(0.8, 0.0, (0.4, 0.4, 0.2), z_m=1.5)
    low = doc.Wall(
        name="low", length_m=1.0, thickness_m=0.1, height_m=0.1, x_m=0.0, y_m=0.9, yaw_rad=0.0,
        material="plain",
    )  # fmt: skip
    moving = box(-0.8, 0.0, (0.4, 0.4, 1.0), mass_kg=5.0)
    truth = true_map(world_with(hanging, moving, walls=(low,)), {})
    assert length_m(truth) == pytest.approx(4 * FREE_M, abs=0.1)
    pillar = true_map(world_with(box(0.8, 0.0, (0.4, 0.4, 1.0))), {})
    assert length_m(pillar) == pytest.approx(4 * FREE_M + 4 * 0.4, abs=0.1)


def test_faces_behind_a_partition_do_not_count() -> None:
    partition = doc.Wall(
        name="partition", length_m=4.0, thickness_m=0.1, height_m=1.0, x_m=1.0, y_m=0.0,
        yaw_rad=math.pi / 2, material="plain",
    )  # fmt: skip
    truth = true_map(world_with(walls=(partition,)), {})
    near_m = FREE_M / 2 + 1.0 - 0.05
    assert length_m(truth) == pytest.approx(2 * (near_m + FREE_M), abs=0.15)
    assert truth.faces_m[..., 0].max() < 1.0
    assert reachable_m2(truth) == pytest.approx((near_m - 0.48) * (FREE_M - 0.48), rel=0.04)


def test_what_lies_behind_a_gap_counts_if_the_outline_fits_through() -> None:
    def gap(width_m: float) -> TrueMap:
        length_m = 2.0 - width_m / 2.0
        sides = (1.0 + width_m / 4.0, -1.0 - width_m / 4.0)
        return true_map(world_with(*(box(1.0, y_m, (0.1, length_m, 1.0)) for y_m in sides)), {})

    beyond = np.array([[1.5, 0.0]])
    assert gap(0.45).reachable_at(beyond)[0]
    assert gap(0.45).faces_m[..., 0].max() > 1.5
    assert not gap(0.28).reachable_at(beyond)[0]


def test_a_niche_counts_as_far_as_it_can_be_looked_into() -> None:
    # 0.2 m wide between two boxes: too narrow to enter.
    boxes = (box(0.7, 1.5, (1.2, 0.85, 1.0)), box(-0.7, 1.5, (1.2, 0.85, 1.0)))
    truth = true_map(world_with(*boxes), {})
    middle = truth.faces_m.mean(axis=1)
    back = middle[(abs(middle[:, 0]) < 0.09) & (middle[:, 1] > FREE_M / 2 - 0.01)]
    assert len(back) >= 3
    assert not truth.reachable_at(np.array([[0.0, 1.6]]))[0]
    # Through the gap the lidar sees no further than its range.
    short = true_map(world_with(*boxes), {}, scan_range_m=0.5)
    middle = short.faces_m.mean(axis=1)
    back = middle[(abs(middle[:, 0]) < 0.09) & (middle[:, 1] > FREE_M / 2 - 0.01)]
    assert not len(back)


def test_a_floor_without_an_end_has_no_share() -> None:
    plain = room()
    truth = true_map(plain.model_copy(update={"walls": plain.walls[:3]}), {})
    assert truth.is_open
    origin = SE2(-2.5, -2.5, 0.0)
    shares = Lattice(truth, RESOLUTION_M, origin).judge(np.zeros((100, 100), np.int8), origin)
    assert shares.coverage is None


def test_a_perfect_map_has_full_marks_and_keeps_them_as_it_grows() -> None:
    truth = true_map(room(), {})
    origin = SE2(-2.5, -2.5, 0.0)
    lattice = Lattice(truth, RESOLUTION_M, origin)
    first = lattice.judge(perfect(truth, origin, 100, 100), origin)
    assert (first.walls_found, first.walls_true, first.free_wrong) == (1.0, 1.0, 0.0)
    assert first.coverage == 1.0
    grown = SE2(-4.0, -3.05, 0.0)
    assert lattice.holds(RESOLUTION_M, grown)
    assert lattice.judge(perfect(truth, grown, 170, 140), grown) == first
    small = SE2(-2.0, -2.0, 0.0)
    assert lattice.judge(perfect(truth, small, 80, 80), small) == first


def test_maps_between_the_cells_are_of_another_lattice() -> None:
    truth = true_map(room(), {})
    lattice = Lattice(truth, RESOLUTION_M, SE2(0.0, 0.0, 0.0))
    assert not lattice.holds(RESOLUTION_M, SE2(0.02, 0.0, 0.0))
    assert not lattice.holds(0.1, SE2(0.0, 0.0, 0.0))


@pytest.mark.parametrize(("off_m", "found"), [(0.05, 1.0), (0.35, 0.5)])
def test_a_map_that_is_off_along_x_misses_the_walls_across_x(off_m: float, found: float) -> None:
    truth = true_map(room(), {})
    origin = SE2(-2.5, -2.5, 0.0)
    moved = SE2(origin.x_m + off_m, origin.y_m, 0.0)
    lattice = Lattice(truth, RESOLUTION_M, origin)
    shares = lattice.judge(perfect(truth, origin, 100, 100), moved)
    assert shares.walls_found == pytest.approx(found, abs=0.06)
    assert shares.walls_true == pytest.approx(found, abs=0.06)


def test_the_known_half_of_the_floor_is_half_of_the_coverage() -> None:
    truth = true_map(room(), {})
    origin = SE2(-2.5, -2.5, 0.0)
    cells = perfect(truth, origin, 100, 100)
    cells[:, 50:] = -1
    shares = Lattice(truth, RESOLUTION_M, origin).judge(cells, origin)
    assert shares.coverage == pytest.approx(0.5, abs=0.02)
    assert shares.walls_found == pytest.approx(0.5, abs=0.02)
    assert shares.walls_true == 1.0


def test_free_cells_deep_in_a_wall_are_wrong_and_those_at_its_face_are_not() -> None:
    truth = true_map(room(), {})
    origin = SE2(-2.5, -2.5, 0.0)
    lattice = Lattice(truth, RESOLUTION_M, origin)
    cells = np.full((100, 100), -1, np.int8)
    x = origin.x_m + RESOLUTION_M * (np.arange(100) + 0.5)
    column = int(np.argmin(abs(x - 2.0)))
    cells[20:80, column] = 0
    cells[20:80, 50] = 0
    assert lattice.judge(cells, origin).free_wrong == pytest.approx(0.5)
    cells[20:80, column] = -1
    at_face = int(np.argmin(abs(x - FREE_M / 2 - 0.01)))
    cells[20:80, at_face] = 0
    assert lattice.judge(cells, origin).free_wrong == 0.0


def test_an_empty_map_has_no_shares_of_its_own() -> None:
    truth = true_map(room(), {})
    origin = SE2(-2.5, -2.5, 0.0)
    lattice = Lattice(truth, RESOLUTION_M, origin)
    for cells, at in (
        (np.full((100, 100), -1, np.int8), origin),
        (np.full((10, 10), -1, np.int8), SE2(50.0, -2.5, 0.0)),
    ):
        shares = lattice.judge(cells, at)
        assert (shares.walls_found, shares.coverage) == (0.0, 0.0)
        assert (shares.walls_true, shares.free_wrong) == (None, None)

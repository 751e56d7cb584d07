import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.mapping.matching.occupancy import MapGrid, Occupancy, share_in_free
from mazebot.mapping.matching.scan_points import ScanPoints, scan_points
from tests.mapping.simulated import LDS, box, scan, wall

ORIGIN = SE2(0.0, 0.0, 0.0)
ROOM = np.concatenate([box(0.0, 0.0, 4.0, 3.0), wall(2.0, 0.0, 2.0, 1.2)])


def seen(pose: SE2, seed: int = 1) -> ScanPoints:
    ranges = scan(ROOM, pose, LDS, np.random.default_rng(seed))
    return scan_points(
        Scan(
            ranges,
            LDS.angle_min_rad,
            LDS.increment_rad,
            LDS.range_min_m,
            LDS.range_max_m,
            LDS.base_from_scan,
        ),
        20.0,
    )


def at(grid: MapGrid, x_m: float, y_m: float) -> int:
    column = math.floor((x_m - grid.origin.x_m) / grid.resolution_m)
    row = math.floor((y_m - grid.origin.y_m) / grid.resolution_m)
    rows, columns = grid.cells.shape
    return int(grid.cells[row, column]) if 0 <= row < rows and 0 <= column < columns else -1


def points(hits: list[tuple[float, float]], misses: list[tuple[float, float]]) -> ScanPoints:
    return ScanPoints(
        np.array(hits, np.float64).reshape(-1, 2), np.array(misses, np.float64).reshape(-1, 2),
        ORIGIN,
    )  # fmt: skip


def test_a_beam_frees_its_way_and_marks_its_end() -> None:
    occupancy = Occupancy(0.05)
    occupancy.add(ORIGIN, points([(1.02, 0.01)], [(0.01, 1.02)]))
    grid = occupancy.grid()
    assert at(grid, 1.02, 0.01) == 100
    assert at(grid, 0.5, 0.01) == 0
    assert at(grid, 1.2, 0.01) == -1
    assert at(grid, 0.01, 0.9) == 0
    assert at(grid, 0.01, 1.02) == -1


def test_cells_begin_at_multiples_of_the_resolution_wherever_the_map_grows() -> None:
    occupancy = Occupancy(0.05)
    for x, y in ((0.3, 0.7), (-9.0, 4.0), (12.0, -33.0)):
        occupancy.add(SE2(x, y, 1.0), points([(1.0, 0.2)], []))
    origin = occupancy.grid().origin
    for value in (origin.x_m, origin.y_m):
        assert abs(value / 0.05 - round(value / 0.05)) < 1e-9
    grid = occupancy.grid()
    end = SE2(-9.0, 4.0, 1.0) @ SE2(1.0, 0.2, 0.0)
    assert at(grid, end.x_m, end.y_m) == 100


def test_a_wall_seen_along_it_is_not_worn_off() -> None:
    occupancy = Occupancy(0.05)
    for i in range(8):
        pose = SE2(0.3 + 0.4 * i, 2.75, 0.0)
        occupancy.add(pose, seen(pose, i))
    grid = occupancy.grid()
    top = [max(at(grid, x, 2.98), at(grid, x, 3.02)) for x in np.arange(0.1, 3.9, 0.05)]
    assert np.mean(np.array(top) == 100) > 0.97


def test_what_is_gone_is_freed_again() -> None:
    occupancy = Occupancy(0.05)
    occupancy.add(ORIGIN, points([(1.02, 0.01)], []))
    for _ in range(3):
        occupancy.add(ORIGIN, points([(2.02, 0.01)], []))
    assert at(occupancy.grid(), 1.02, 0.01) == 0


def test_rebuilding_gives_the_same_grid() -> None:
    occupancy = Occupancy(0.05)
    keyframes = [
        (pose, seen(pose, i)) for i, pose in enumerate([SE2(1.0, 2.0, 0.3), SE2(3.0, 1.0, 2.0)])
    ]
    for pose, one in keyframes:
        occupancy.add(pose, one)
    before = occupancy.grid()
    occupancy.rebuild(keyframes)
    assert occupancy.grid().cells.tobytes() == before.cells.tobytes()
    occupancy.rebuild([])
    assert (occupancy.grid().cells == -1).all()


def test_a_pose_out_of_the_world_is_left_out() -> None:
    occupancy = Occupancy(0.05)
    occupancy.add(ORIGIN, points([(1.0, 0.0)], []))
    before = occupancy.grid().cells.tobytes()
    for far in (SE2(1e9, 0.0, 0.0), SE2(math.nan, 0.0, 0.0)):
        occupancy.add(far, points([(1.0, 0.0)], []))
    assert occupancy.grid().cells.tobytes() == before


def test_returns_lie_where_the_map_is_free_on_its_walls_or_beyond_its_edge() -> None:
    occupancy = Occupancy(0.05)
    occupancy.add(SE2(0.0, 0.0, 0.0), points([(2.01, 0.02 * i) for i in range(-20, 21)], []))
    ends_m = np.array([[1.0, 0.1], [1.5, -0.1], [2.01, 0.02], [-1.0, 0.0], [50.0, 0.0]])
    assert share_in_free(occupancy.grid(), ORIGIN, ends_m) == pytest.approx(0.4)
    assert share_in_free(occupancy.grid(), SE2(0.0, 0.0, math.pi), ends_m) == pytest.approx(0.2)
    assert share_in_free(occupancy.grid(), ORIGIN, ends_m[:0]) == 0.0

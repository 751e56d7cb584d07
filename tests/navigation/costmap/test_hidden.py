"""What the lidar does not show is marked beside what it shows, and stays until it is seen free."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.navigation.control.safety.collision_monitor import moved_points
from mazebot.navigation.costmap.inflation_layer import InflationParams
from mazebot.navigation.costmap.layered_costmap import LETHAL_OBSTACLE, LocalCostmap
from mazebot.navigation.costmap.obstacle_layer import ObstacleParams
from mazebot.navigation.robot.hidden import (
    HiddenThings,
    depth_points,
    hidden_from,
    points_behind,
)

CAMERA = SE2(0.069, 0.0, 0.0)
LIDAR = SE2(-0.064, 0.0, 0.0)
HERE = SE2(0.0, 0.0, 0.0)
BEAMS, WIDTH_RAD = 41, 1.0
UNKNOWN = np.zeros(0, np.float32)


def seen(range_m: float, half_rad: float = 0.1) -> Scan:
    """A depth image's scan: something straight ahead, else floor."""
    angles = np.linspace(-WIDTH_RAD / 2, WIDTH_RAD / 2, BEAMS)
    ranges = np.where(np.abs(angles) <= half_rad, range_m, np.inf).astype(np.float32)
    return Scan(ranges, -WIDTH_RAD / 2, WIDTH_RAD / (BEAMS - 1), 0.27, 3.5, CAMERA)


def turn(range_m: float, stamp_ns: int = 0) -> Scan:
    """A turn of the lidar in the middle of a round wall."""
    ranges = np.full(360, range_m, np.float32)
    return Scan(ranges, 0.0, math.radians(1.0), 0.12, 3.5, LIDAR, stamp_ns)


def local() -> LocalCostmap:
    return LocalCostmap(0.05, InflationParams(), ObstacleParams())


def show(
    costmap: LocalCostmap, scan: Scan, pose: SE2 = HERE, reaches_m: NDArray[np.float32] = UNKNOWN
) -> None:
    _, echo = depth_points(scan)
    behind_m = moved_points(points_behind(scan, reaches_m, echo), pose, HERE)
    costmap.update_seen_low(pose @ CAMERA, scan, echo, behind_m)


def is_marked(costmap: LocalCostmap, x_m: float, y_m: float = 0.0) -> bool:
    return costmap.master.cost_at(x_m, y_m) == LETHAL_OBSTACLE


@pytest.mark.parametrize(("lidar_m", "hidden"), [(3.0, True), (1.15, False), (0.5, False)])
def test_what_the_lidar_shows_is_not_hidden(lidar_m: float, hidden: bool) -> None:
    points_m, echo = depth_points(seen(1.0))
    found = hidden_from(points_m[echo], HERE, turn(lidar_m), HERE)
    assert len(found) == echo.sum() > 0
    assert (found == hidden).all()


def test_the_robot_may_have_moved_between_both() -> None:
    points_m, echo = depth_points(seen(1.0))
    # The lidar saw a wall 1.6 m ahead from 0.5 m further back: it is this one.
    back = SE2(-0.5, 0.0, 0.0)
    assert not hidden_from(points_m[echo], HERE, turn(1.63), back).any()


def test_without_a_lidar_all_is_hidden() -> None:
    points_m, echo = depth_points(seen(1.0))
    assert hidden_from(points_m[echo], HERE, None, HERE).all()


def test_rays_of_the_lidar_do_not_clear_what_they_pass_above() -> None:
    costmap = local()
    show(costmap, seen(1.0))
    for second in range(100):
        costmap.update(LIDAR, turn(3.0, second * 1_000_000_000), map_from_base=HERE)
    assert is_marked(costmap, 1.08)


def test_the_camera_clears_it_where_it_sees_floor() -> None:
    costmap = local()
    show(costmap, seen(1.0))
    for _ in range(10):
        show(costmap, seen(math.inf))
    assert not is_marked(costmap, 1.08)


def test_it_stays_where_the_camera_does_not_look() -> None:
    costmap = local()
    show(costmap, seen(0.6))
    beside, near = SE2(0.0, 0.0, 1.5), SE2(0.5, 0.0, 0.0)
    for pose in (beside, near):
        for _ in range(20):
            show(costmap, seen(math.inf), pose)
    assert is_marked(costmap, 0.68)


def test_recoveries_leave_it() -> None:
    costmap = local()
    show(costmap, seen(1.0))
    costmap.mark_touched(np.array([[0.3, -0.5]]))
    costmap.clear_scanned()
    assert is_marked(costmap, 1.08)
    assert is_marked(costmap, 0.3, -0.5)
    costmap.clear_hidden()
    assert not is_marked(costmap, 1.08)
    assert not is_marked(costmap, 0.3, -0.5)


def test_it_moves_with_the_window() -> None:
    costmap = local()
    show(costmap, seen(1.0))
    costmap.move(SE2(0.4, -0.2, 0.0))
    assert is_marked(costmap, 1.08)


def test_what_was_touched_is_cleared_by_no_ray() -> None:
    costmap = local()
    costmap.mark_touched(np.array([[0.8, 0.0]]))
    for second in range(100):
        costmap.update(LIDAR, turn(3.0, second * 1_000_000_000))
        show(costmap, seen(math.inf))
    assert is_marked(costmap, 0.8)


def reaching(scan: Scan, reach_m: float) -> NDArray[np.float32]:
    return np.where(np.isfinite(scan.ranges_m), reach_m, 0.0).astype(np.float32)


def test_what_is_seen_of_a_thing_behind_its_front_is_marked_as_well() -> None:
    costmap, scan = local(), seen(0.8)
    show(costmap, scan, reaches_m=reaching(scan, 0.2))
    assert [is_marked(costmap, 0.87 + 0.05 * i) for i in range(7)] == [True] * 5 + [False] * 2
    # From where only its front is seen, the rest of it stays.
    show(costmap, seen(0.6), SE2(0.2, 0.0, 0.0))
    assert is_marked(costmap, 1.02)


@pytest.mark.parametrize(
    "reaches_m",
    [
        UNKNOWN,
        np.full(BEAMS, np.nan, np.float32),
        np.full(BEAMS, -1.0, np.float32),
        np.zeros(BEAMS, np.float32),
        np.full(BEAMS + 1, 0.3, np.float32),
    ],
)
def test_without_a_reach_there_is_nothing_behind(reaches_m: NDArray[np.float32]) -> None:
    scan = seen(1.0)
    assert not len(points_behind(scan, reaches_m, np.isfinite(scan.ranges_m)))


@pytest.mark.parametrize("reach_m", [math.inf, 1e30, 255.0])
def test_a_reach_ends_where_rows_of_an_image_are_too_far_apart(reach_m: float) -> None:
    scan = seen(1.0)
    points_m = points_behind(scan, reaching(scan, reach_m), np.isfinite(scan.ranges_m))
    away_m = np.hypot(points_m[:, 0] - CAMERA.x_m, points_m[:, 1])
    assert 1.0 < away_m.min() < away_m.max() <= 2.0 + 1e-9
    far = seen(2.5)
    assert not len(points_behind(far, reaching(far, reach_m), np.isfinite(far.ranges_m)))


def test_points_are_kept_while_their_cells_are_marked() -> None:
    costmap, hidden = local(), HiddenThings()
    scan = seen(1.0)
    points_m, echo = depth_points(scan)
    show(costmap, scan)
    hidden.see(points_m[echo], costmap)
    kept = hidden.from_base(SE2(0.5, 0.0, 0.0))
    assert len(kept) >= 5
    assert kept[:, 0].min() == pytest.approx(0.56, abs=0.01)
    hidden.see(np.empty((0, 2)), costmap)
    assert len(hidden.points_m) == len(kept)
    for _ in range(10):
        show(costmap, seen(math.inf))
    hidden.see(np.empty((0, 2)), costmap)
    assert not len(hidden.points_m)

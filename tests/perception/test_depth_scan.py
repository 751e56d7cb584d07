"""The scan of a depth image: things on the floor are told from the floor, from what is above the
robot and from noise.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import (
    LINK_FROM_OPTICAL,
    Array,
    rotation_from_rpy,
    transform_matrix,
)
from mazebot.perception.depth_scan import (
    Depths,
    DepthScan,
    DepthScanParams,
    depth_scan,
    unseen_ahead,
)

WIDTH, HEIGHT, FOCAL_PX = 640, 480, 554.4
CAMERA_M = 0.117
INTRINSICS = np.array([[FOCAL_PX, 0.0, WIDTH / 2], [0.0, FOCAL_PX, HEIGHT / 2], [0.0, 0.0, 1.0]])
PARAMS = DepthScanParams(beams=40, min_points=3)
FLOOR_FROM_M = CAMERA_M * FOCAL_PX / (HEIGHT - 1 - HEIGHT / 2)


def camera(
    pitch_rad: float = 0.0, roll_rad: float = 0.0, yaw_rad: float = 0.0, height_m: float = CAMERA_M
) -> Array:
    """Pose of the camera; a positive pitch looks down."""
    turned = rotation_from_rpy(roll_rad, pitch_rad, yaw_rad)
    return transform_matrix(turned, (0.07, 0.0, height_m)) @ LINK_FROM_OPTICAL


def picture(
    *boxes: tuple[float, float, float, float],
    level: tuple[tuple[float, float, float, float], ...] = (),
    pose: Array | None = None,
) -> Depths:
    """Depths of a floor with upright boards that face the camera: distance ahead of it, height of
    the lower and of the upper edge, half width; and with level ones: their height, their two edges
    ahead, half width.
    """
    pose = camera() if pose is None else pose
    camera_m = pose[2, 3]
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - WIDTH / 2) / FOCAL_PX, (v - HEIGHT / 2) / FOCAL_PX, np.ones(u.shape)], -1)
    x, y, z = np.moveaxis(rays @ pose[:3, :3].T, -1, 0)
    with np.errstate(divide="ignore"):
        depth = np.where(z < 0.0, camera_m / -z, np.inf)
    for ahead_m, low_m, high_m, half_m in boxes:
        at = ahead_m / x
        up = camera_m + at * z
        hit = (at > 0.0) & (up >= low_m) & (up <= high_m) & (np.abs(at * y) <= half_m)
        hit &= at < depth
        depth = np.where(hit, at, depth)
    for height_m, near_m, far_m, half_m in level:
        with np.errstate(divide="ignore"):
            at = (height_m - camera_m) / z
        hit = (at > 0.0) & (at * x >= near_m) & (at * x <= far_m) & (np.abs(at * y) <= half_m)
        depth = np.where(hit & (at < depth), at, depth)
    return np.where(depth < 10.0, depth, 0.0).astype(np.float32)


def scanned(image: Depths, pitch_rad: float = 0.0, params: DepthScanParams = PARAMS) -> DepthScan:
    scan = depth_scan(image, INTRINSICS, camera(pitch_rad), 0.0, params)
    assert scan is not None
    return scan


def test_bare_floor_is_free_from_where_the_camera_sees_it() -> None:
    scan = scanned(picture())
    assert np.isposinf(scan.ranges_m).all()
    assert scan.range_min_m == pytest.approx(FLOOR_FROM_M, rel=0.02)
    assert scan.angle_min_rad == pytest.approx(-math.atan(320 / FOCAL_PX), abs=0.02)


@pytest.mark.parametrize(("low_m", "high_m"), [(0.0, 0.03), (0.0, 0.1), (0.14, 0.17), (0.0, 1.0)])
def test_sills_boxes_table_tops_and_walls_are_seen(low_m: float, high_m: float) -> None:
    scan = scanned(picture((1.0, low_m, high_m, 0.2)))
    angles = scan.angle_min_rad + scan.angle_increment_rad * np.arange(len(scan.ranges_m))
    inside = np.abs(np.tan(angles)) < 0.18
    assert scan.ranges_m[inside] == pytest.approx(1.0 / np.cos(angles[inside]), abs=0.02)
    assert np.isposinf(scan.ranges_m[np.abs(np.tan(angles)) > 0.23]).all()


@pytest.mark.parametrize(
    ("front", "height_m", "depth_m"),
    [((0.0, 0.06), 0.06, 0.2), ((0.0, 0.03), 0.03, 0.3), ((0.2, 0.21), 0.2, 0.3)],
)
def test_a_beam_tells_how_far_a_thing_reaches(
    front: tuple[float, float], height_m: float, depth_m: float
) -> None:
    board = (0.9, *front, 0.2)
    scan = scanned(picture(board, level=((height_m, 0.9, 0.9 + depth_m, 0.2),)))
    middle = slice(len(scan.ranges_m) // 2 - 3, len(scan.ranges_m) // 2 + 3)
    assert scan.ranges_m[middle] == pytest.approx(0.9, abs=0.02)
    assert scan.reaches_m[middle] == pytest.approx(depth_m, abs=0.06)
    assert not scan.reaches_m[np.isinf(scan.ranges_m)].any()


def test_a_wall_reaches_nowhere_and_what_is_behind_a_gap_is_another_thing() -> None:
    assert scanned(picture((1.0, 0.0, 1.0, 0.4))).reaches_m.max() < 0.06
    behind = picture((0.8, 0.0, 0.05, 0.3), (1.2, 0.0, 0.2, 0.3))
    assert scanned(behind).reaches_m[len(scanned(behind).ranges_m) // 2] < 0.06


def test_what_is_above_the_robot_is_passed() -> None:
    assert np.isposinf(scanned(picture((1.0, 0.25, 0.6, 0.3))).ranges_m).all()


@pytest.mark.parametrize("pitch_rad", [-0.006, 0.006])
def test_a_slightly_tilted_camera_sees_no_things_in_the_floor(pitch_rad: float) -> None:
    assert np.isposinf(scanned(picture(pose=camera(pitch_rad)), 0.0).ranges_m).all()


def test_a_camera_that_looks_down_is_taken_as_it_is() -> None:
    scan = scanned(picture((1.0, 0.0, 0.1, 0.2), pose=camera(0.3)), 0.3)
    assert scan.ranges_m[len(scan.ranges_m) // 2] == pytest.approx(1.0, abs=0.02)


def test_a_few_pixels_are_noise() -> None:
    image = picture()
    image[300, 320:324] = 0.5
    assert np.isposinf(scanned(image).ranges_m).all()


def test_what_the_camera_does_not_measure_is_not_free() -> None:
    image = picture()
    image[:, :160] = 0.0
    image[:, 160:200] = np.nan
    scan = scanned(image)
    # The image's left side is where angles are largest.
    assert np.isneginf(scan.ranges_m[-10:]).all()
    assert np.isposinf(scan.ranges_m[:20]).all()


def test_a_camera_that_looks_up_makes_no_scan() -> None:
    assert depth_scan(picture(), INTRINSICS, camera(-0.6), 0.0, PARAMS) is None


@pytest.mark.parametrize("degrees", [30, 45, 90, 180, 270])
def test_a_camera_mounted_on_its_head_or_its_side_sees_what_is_before_it(degrees: int) -> None:
    pose = camera(roll_rad=math.radians(degrees))
    image = picture((1.0, 0.0, 0.1, 0.15), pose=pose)
    u, v = np.meshgrid(np.arange(WIDTH) - WIDTH / 2, np.arange(HEIGHT) - HEIGHT / 2)
    image[pose[1, 0] * u + pose[1, 1] * v < -FOCAL_PX * pose[1, 2]] = 0.0
    scan = depth_scan(image, INTRINSICS, pose, 0.0, PARAMS)
    assert scan is not None
    angles = scan.angle_min_rad + scan.angle_increment_rad * np.arange(len(scan.ranges_m))
    left = angles > 0.02
    thing = left & (angles < 0.13)
    assert scan.ranges_m[thing] == pytest.approx(1.0 / np.cos(angles[thing]), abs=0.02)
    assert np.isposinf(scan.ranges_m[left & (angles > 0.17) & (angles < 0.3)]).all()
    assert np.isneginf(scan.ranges_m[angles < -0.05]).all()
    assert 0.2 < scan.range_min_m < 0.5


@pytest.mark.parametrize("pitch_rad", [0.9, 1.2, 1.5])
def test_a_camera_on_a_mast_that_looks_steeply_down_knows_how_far_it_sees(
    pitch_rad: float,
) -> None:
    pose = camera(pitch_rad, height_m=1.0)
    far_m = 1.0 / math.tan(pitch_rad - math.atan(HEIGHT / 2 / FOCAL_PX))
    scan = depth_scan(picture((0.3, 0.0, 0.1, 0.2), pose=pose), INTRINSICS, pose, 0.0, PARAMS)
    assert scan is not None
    assert scan.range_max_m == pytest.approx(min(far_m, PARAMS.range_max_m), rel=0.01)
    assert scan.ranges_m[len(scan.ranges_m) // 2] == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        (camera(), ""),
        (camera(roll_rad=math.pi), ""),
        (camera(1.3, height_m=1.0), ""),
        (camera(-1.0), "it looks -57 degrees down and 0 degrees to the left, and sees no floor"),
        (camera(1.4), "it looks 80 degrees down and 0 degrees to the left, and sees the floor "
         "there from 0.00 to 0.08 m; must see the floor at least up to 0.4 m ahead of the axle"),
        (camera(yaw_rad=1.6), "it looks 0 degrees down and 92 degrees to the left, and sees the "
         "floor there from 0.27 to 3.50 m"),
    ],
)  # fmt: skip
def test_a_camera_that_does_not_see_the_floor_ahead_tells_where_it_looks(
    pose: Array, reason: str
) -> None:
    yaw_rad = math.atan2(pose[1, 2], pose[0, 2])
    told = unseen_ahead((WIDTH, HEIGHT), INTRINSICS, pose, yaw_rad, PARAMS)
    assert told.startswith(reason)
    assert bool(told) == bool(reason)

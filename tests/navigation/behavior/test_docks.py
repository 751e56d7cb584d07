from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, position_and_quaternion, rotation_from_rpy
from mazebot.common.messages.documents import MarkerEntity
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.docking.docks import CameraView, DockPlaces, Docks
from mazebot.navigation.errors import NavigationError

WIDTH, HEIGHT, FOCAL = 640, 480, 554.4
BASE_FROM_CAMERA = np.array(
    [[0.0, 0.0, 1.0, 0.069], [-1.0, 0.0, 0.0, -0.047], [0.0, -1.0, 0.0, 0.117], [0, 0, 0, 1.0]]
)
CAMERA = CameraView(BASE_FROM_CAMERA, (FOCAL, FOCAL), (320.0, 240.0), (WIDTH, HEIGHT))


def marker(number: int, foot: SE2, height_m: float = 0.25, panel_m: float = 0.4) -> MarkerEntity:
    """A marker on a wall, whose face points along the foot's x axis."""
    out = np.array([math.cos(foot.yaw_rad), math.sin(foot.yaw_rad), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = np.cross(up, out), up, out
    matrix[:3, 3] = (foot.x_m, foot.y_m, height_m)
    return entity(number, matrix, panel_m)


def entity(number: int, matrix: np.ndarray, panel_m: float = 0.4) -> MarkerEntity:
    position_m, orientation_xyzw = position_and_quaternion(matrix)
    return MarkerEntity(
        name=f"aruco_{number}", position_m=position_m, orientation_xyzw=orientation_xyzw,
        panel_side_m=panel_m, texture_sha256="0" * 64, marker_id=number,
        marker_size_m=0.75 * panel_m, dictionary="DICT_4X4_100",
    )  # fmt: skip


def pixels(away_m: float, height_m: float, side_m: float) -> np.ndarray:
    """(4, 2) of the corners of a square straight before the robot."""
    sides = [(y, z) for y in (-side_m / 2, side_m / 2) for z in (-side_m / 2, side_m / 2)]
    corners = np.array([(away_m, y, height_m + z, 1.0) for y, z in sides])
    seen = corners @ np.linalg.inv(BASE_FROM_CAMERA).T
    assert (seen[:, 2] > 0.0).all()
    return np.asarray(FOCAL * seen[:, :2] / seen[:, 2:3] + (WIDTH / 2, HEIGHT / 2))


@pytest.mark.parametrize(("height_m", "side_m"), [(0.25, 0.4), (0.12, 0.16), (0.6, 0.3)])
def test_the_nearest_whole_view_touches_the_margin_of_the_picture(
    height_m: float, side_m: float
) -> None:
    away_m = CAMERA.whole_view_m(height_m, side_m, 0.02)
    u, v = pixels(away_m, height_m, side_m).T
    room = (u.min() - 0.02 * WIDTH, 0.98 * WIDTH - u.max(),
            v.min() - 0.02 * HEIGHT, 0.98 * HEIGHT - v.max())  # fmt: skip
    assert min(room) == pytest.approx(0.0, abs=1e-6)


def test_the_half_view_is_the_angle_to_the_nearer_edge_of_the_picture() -> None:
    edge_rad = math.atan(0.48 * WIDTH / FOCAL)
    assert CAMERA.half_view_rad(0.02) == pytest.approx(edge_rad)
    turn = math.radians(10.0)
    c, s = math.cos(turn), math.sin(turn)
    turned = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    aslant = CameraView(turned @ BASE_FROM_CAMERA, (FOCAL, FOCAL), (320.0, 240.0), (WIDTH, HEIGHT))
    assert aslant.half_view_rad(0.02) == pytest.approx(edge_rad - turn)
    back = CameraView(
        np.diag([-1.0, -1.0, 1.0, 1.0]) @ BASE_FROM_CAMERA,
        (FOCAL, FOCAL), (320.0, 240.0), (WIDTH, HEIGHT),
    )  # fmt: skip
    assert back.half_view_rad(0.02) == 0.0


def rolled(roll_rad: float) -> CameraView:
    pose = BASE_FROM_CAMERA.copy()
    pose[:3, :3] = rotation_from_rpy(roll_rad, 0.0, 0.0) @ pose[:3, :3]
    return CameraView(pose, (FOCAL, FOCAL), (320.0, 240.0), (WIDTH, HEIGHT))


@pytest.mark.parametrize(("degrees", "across"), [(90, HEIGHT), (180, WIDTH), (270, HEIGHT)])
def test_the_half_view_of_a_camera_on_its_head_or_its_side(degrees: int, across: int) -> None:
    seen_rad = rolled(math.radians(degrees)).half_view_rad(0.02)
    assert seen_rad == pytest.approx(math.atan(0.48 * across / FOCAL))


def test_a_camera_that_looks_away_never_sees_it_whole() -> None:
    down = BASE_FROM_CAMERA.copy()
    # The optical axis points at the floor.
    down[:3, 1], down[:3, 2] = (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)
    camera = CameraView(down, (FOCAL, FOCAL), (320.0, 240.0), (WIDTH, HEIGHT))
    assert camera.whole_view_m(0.25, 0.4, 0.02) == math.inf
    docks = Docks()
    docks.learn([marker(60, SE2(1.0, 2.0, 0.5))], camera)
    with pytest.raises(NavigationError, match="does not look ahead at the height") as caught:
        docks.by_name("60")
    assert caught.value.code is ErrorCode.DOCK_NOT_VALID


def test_a_dock_is_as_near_as_the_camera_allows_and_no_nearer_than_the_least() -> None:
    docks = Docks()
    foot = SE2(1.0, 2.0, 0.5)
    docks.learn([marker(60, foot), marker(8, foot, 0.12, 0.16)], CAMERA)
    dock = docks.by_name("60")
    assert dock is docks.by_name("aruco_60")
    assert dock.marker_from_dock.x_m == pytest.approx(0.88)
    assert dock.whole_view_m == pytest.approx(0.872, abs=0.002)
    assert docks.docked()["60"] == dock.map_from_dock
    assert dock.map_from_dock == pytest.approx(foot @ SE2(0.88, 0.0, math.pi))
    assert docks.by_name("8").marker_from_dock.x_m == DockPlaces().least_m


def test_what_is_no_dock_is_refused_by_name_with_the_reason() -> None:
    flat = np.eye(4)
    flat[:3, 3] = (0.0, 0.0, 0.01)
    docks = Docks()
    docks.learn([marker(5, SE2(0, 0, 0), 2.0), entity(6, flat)], CAMERA)
    for name, reason in (("5", r"dock '5': .* only from 5\.0\d m"), ("aruco_6", "lies flat")):
        with pytest.raises(NavigationError, match=reason) as caught:
            docks.by_name(name)
        assert caught.value.code is ErrorCode.DOCK_NOT_VALID
    with pytest.raises(
        NavigationError, match="'7': there is no marker that the robot knows"
    ) as unknown:
        docks.by_name("7")
    assert unknown.value.code is ErrorCode.DOCK_NOT_IN_DB


def test_a_name_that_is_another_markers_id_leads_to_no_other_wall() -> None:
    here, there = marker(8, SE2(0.0, 0.0, 0.0)), marker(5, SE2(9.0, 0.0, 3.1))
    both = there.model_copy(update={"name": "8"})
    docks = Docks()
    for order in ((here, both), (both, here)):
        docks.learn(order, CAMERA)
        with pytest.raises(
            NavigationError, match=r"'8': the id of marker 'aruco_8', and the name of .* id 5"
        ) as caught:
            docks.by_name("8")
        assert caught.value.code is ErrorCode.DOCK_NOT_VALID
        assert docks.by_name("aruco_8").marker_id == "8"
        assert docks.by_name("5").marker_id == "5"
    # One at which the robot cannot dock takes no id from another.
    high = marker(5, SE2(9.0, 0.0, 3.1), 2.0).model_copy(update={"name": "8"})
    for order in ((here, high), (high, here)):
        docks.learn(order, CAMERA)
        assert docks.by_name("8").marker_id == "8"
    own = marker(8, SE2(0.0, 0.0, 0.0)).model_copy(update={"name": "8"})
    docks.learn([own], CAMERA)
    assert docks.by_name("8").marker_id == "8"


def test_without_the_camera_there_is_no_dock_until_it_comes() -> None:
    docks = Docks()
    docks.learn([marker(60, SE2(1.0, 2.0, 0.5))], None)
    with pytest.raises(NavigationError, match="docking needs the camera"):
        docks.by_name("60")
    assert len(docks) == 2
    docks.learn([marker(60, SE2(1.0, 2.0, 0.5))], CAMERA)
    assert docks.by_name("60").marker_id == "60"


def test_a_pose_is_a_dock_of_the_nearest_marker_that_it_faces() -> None:
    docks = Docks()
    docks.learn([marker(1, SE2(2.0, 0.0, math.pi)), marker(2, SE2(0.0, 1.0, -1.57))], CAMERA)
    dock = docks.at(SE2(1.5, 0.02, 0.1))
    assert dock.marker_id == "1"
    # Nearer than the camera sees it: the pose that was asked for, all the same.
    assert dock.map_from_dock == pytest.approx(SE2(1.5, 0.02, 0.1))
    for pose in (SE2(1.5, 0.0, 1.0), SE2(-1.0, 0.0, 0.0), SE2(2.5, 0.0, math.pi)):
        with pytest.raises(NavigationError, match=r"must face a marker within 2\.5 m") as caught:
            docks.at(pose)
        assert caught.value.code is ErrorCode.DOCK_NOT_VALID

"""Markers in pictures of any size."""

from __future__ import annotations

import functools
import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.perception.detect import Detector
from mazebot.perception.photo import markers_in_photo, unreadable_in_photo
from mazebot.perception.pose import Camera
from tests.perception.scene import (
    CAMERA,
    MARKER_ID,
    MARKER_SIDE_M,
    camera_from_marker,
    project,
    render,
)

BOOK = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
PINHOLE = Camera(CAMERA, np.zeros(5))
POSE = camera_from_marker(1.5, math.radians(40), 0.05, 0.1)


@functools.cache
def picture() -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(render(POSE, "bricks"), cv2.COLOR_RGB2GRAY), np.uint8)


def test_a_marker_has_both_poses_and_their_ambiguity() -> None:
    (one,) = markers_in_photo(picture(), BOOK, PINHOLE, MARKER_SIDE_M)
    assert one.marker_id == MARKER_ID
    assert len(one.solutions) == 2
    better, worse = one.solutions
    assert better.reprojection_error_px < worse.reprojection_error_px
    assert one.ambiguity == worse.reprojection_error_px / better.reprojection_error_px
    assert one.ambiguity > 10.0
    assert np.abs(better.camera_from_marker[:3, 3] - POSE[:3, 3]).max() < 0.01


def test_without_a_camera_there_are_corners_alone() -> None:
    (one,) = markers_in_photo(picture(), BOOK)
    assert one.solutions == ()
    assert one.ambiguity is None
    assert np.abs(one.corners - project(POSE)).max() < 0.15


@pytest.mark.parametrize(("times", "blur_px"), [(2, 1.6), (6, 1.6), (6, 2.5)])
def test_a_large_picture_out_of_focus_is_read(times: int, blur_px: float) -> None:
    size = 640 * times, 480 * times
    large = cv2.resize(picture(), size, interpolation=cv2.INTER_CUBIC)
    blurred = np.asarray(cv2.GaussianBlur(large, (0, 0), blur_px * times), np.uint8)
    (one,) = markers_in_photo(blurred, BOOK)
    assert one.marker_id == MARKER_ID
    # The centre of a pixel is that of its block in the large picture.
    expected = times * (project(POSE) + 0.5) - 0.5
    assert np.abs(one.corners - expected).max() < 0.25 * times


def test_a_dim_marker_beside_a_bright_one_is_found() -> None:
    dim = np.asarray(np.rint(0.15 * picture() + 30.0), np.uint8)
    both = np.concatenate([picture(), dim], axis=1)
    left, right = markers_in_photo(both, BOOK)
    assert left.corners[:, 0].max() < 640 < right.corners[:, 0].min()


def test_a_wall_holds_none() -> None:
    bare = render(camera_from_marker(60.0), "bricks")
    grey = np.asarray(cv2.cvtColor(bare, cv2.COLOR_RGB2GRAY), np.uint8)
    assert markers_in_photo(grey, BOOK) == []


def panel(marker_id: int, module_px: int, border_px: float, around: int = 30) -> NDArray[np.uint8]:
    """A marker of DICT_5X5_1000 with a white border, dark all around, slightly out of focus."""
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
    side_px, fine = 7 * module_px, 4
    code = cv2.aruco.generateImageMarker(book, marker_id, fine * side_px)
    scene = np.full((fine * 240, fine * 320), around, np.uint8)
    left, border = fine * 60, round(fine * border_px)
    scene[left - border : left + len(code) + border, left - border : left + len(code) + border] = (
        255
    )
    scene[left : left + len(code), left : left + len(code)] = code
    small = cv2.resize(scene, (320, 240), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), 0.7), np.uint8)


@pytest.mark.parametrize(("module_px", "border_px"), [(15, 2.5), (15, 5.0), (6, 1.5), (20, 2.0)])
def test_a_thin_white_border_is_enough(module_px: int, border_px: float) -> None:
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
    (one,) = markers_in_photo(panel(1, module_px, border_px), book)
    assert one.marker_id == 1
    expected = 60 + 7 * module_px * np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) - 0.5
    # Of a border that blur has eaten half of, the edge seems nearer.
    assert np.abs(one.corners - expected).max() < 0.5


@pytest.mark.parametrize("blur_px", [0.0, 0.8])
@pytest.mark.parametrize("wall", [30, 60, 100, 140])
@pytest.mark.parametrize("border_px", [4, 8, 20])
def test_the_corners_are_those_of_the_black_square_not_of_its_border(
    border_px: int, wall: int, blur_px: float
) -> None:
    scene = np.full((480, 640), wall, np.uint8)
    left, top, side = 260, 180, 120
    scene[top - border_px : top + side + border_px, left - border_px : left + side + border_px] = (
        255
    )
    scene[top : top + side, left : left + side] = cv2.aruco.generateImageMarker(BOOK, 7, side)
    if blur_px:
        scene = np.asarray(cv2.GaussianBlur(scene, (0, 0), blur_px), np.uint8)
    expected = side * np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) + np.array([left, top]) - 0.5
    (one,) = markers_in_photo(scene, BOOK, magnify=False)
    assert one.marker_id == 7
    assert np.abs(one.corners - expected).max() < 0.5
    for seen in Detector(BOOK, 13, 20.0).detect(scene, 100.0):
        assert np.abs(seen.corners - expected).max() < 0.5


def test_no_border_is_none() -> None:
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
    assert markers_in_photo(panel(1, 15, 0.0, around=0), book) == []


@pytest.mark.parametrize("side_px", [11.0, 12.5, 16.0])
def test_small_markers_of_a_small_picture_are_read(side_px: float) -> None:
    rng = np.random.default_rng(1)
    fine = 8
    scene = np.full((fine * 240, fine * 320), 170, np.uint8)
    corners = {}
    for marker_id in range(18):
        code = cv2.aruco.generateImageMarker(BOOK, marker_id, round(fine * side_px))
        x, y = (fine * np.array([20 + 50 * (marker_id % 6), 30 + 75 * (marker_id // 6)])).tolist()
        x, y = x + int(rng.integers(fine)), y + int(rng.integers(fine))
        white = round(fine * side_px / 6)
        scene[y - white : y + len(code) + white, x - white : x + len(code) + white] = 255
        scene[y : y + len(code), x : x + len(code)] = code
        corners[marker_id] = (np.array([x, y]) / fine) - 0.5
    small = cv2.resize(scene, (320, 240), interpolation=cv2.INTER_AREA)
    noisy = np.clip(small + rng.normal(0.0, 2.0, small.shape), 0, 255).astype(np.uint8)
    found = {one.marker_id: one for one in markers_in_photo(noisy, BOOK)}
    assert len(found) >= 17
    for marker_id, one in found.items():
        assert np.abs(one.corners[0] - corners[marker_id]).max() < 0.3


def test_mirrored_and_inverted_markers_are_told_apart() -> None:
    plain = picture()
    assert unreadable_in_photo(plain, BOOK) == {}
    mirror, inverse = np.ascontiguousarray(plain[:, ::-1]), np.asarray(255 - plain, np.uint8)
    for way, wrong in (
        ("mirrored", mirror),
        ("inverted", inverse),
        ("mirrored and inverted", np.asarray(255 - mirror, np.uint8)),
    ):
        assert markers_in_photo(wrong, BOOK) == []
        assert unreadable_in_photo(wrong, BOOK) == {way: [MARKER_ID]}


def test_a_marker_that_cannot_be_read_is_told_beside_others() -> None:
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    scene = np.full((360, 640), 255, np.uint8)
    for index, marker_id in enumerate((3, 77, 500)):
        left = 40 + 200 * index
        scene[30:150, left : left + 120] = cv2.aruco.generateImageMarker(book, marker_id, 120)
    assert unreadable_in_photo(scene, book, markers_in_photo(scene, book, magnify=False)) == {}
    scene[180:360, 40:220] = 0
    scene[210:330, 70:190] = 255 - cv2.aruco.generateImageMarker(book, 9, 120)
    scene[210:330, 340:460] = cv2.aruco.generateImageMarker(book, 10, 120)[:, ::-1]
    markers = markers_in_photo(scene, book, magnify=False)
    assert [one.marker_id for one in markers] == [3, 77, 500]
    assert unreadable_in_photo(scene, book, markers) == {"mirrored": [10], "inverted": [9]}

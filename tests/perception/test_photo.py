"""Markers in pictures of any size."""

from __future__ import annotations

import functools
import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.perception.photo import markers_in_photo
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

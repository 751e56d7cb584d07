"""Whether what was read is a code that somebody printed."""

from __future__ import annotations

import functools
import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.perception.code_check import CodeCheck
from mazebot.perception.detect import MIN_CLARITY
from tests.perception.scene import MARKER_ID, WIDTH, camera_from_marker, project, render

BOOK = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
POSE = camera_from_marker(2.5, math.radians(40), 0.05, 0.1)
CORNERS = project(POSE)
SHADE = np.interp(np.arange(WIDTH), [CORNERS[:, 0].min() - 5, CORNERS[:, 0].max() + 5], [0.1, 1.0])
"""A shadow's edge across the marker."""


@functools.cache
def picture() -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(render(POSE, "bricks"), cv2.COLOR_RGB2GRAY), np.uint8)


def clarity(grey: NDArray[np.uint8], marker_id: int = MARKER_ID) -> float:
    return CodeCheck(BOOK).clarity(grey, CORNERS, marker_id)


def test_a_printed_code_is_clear() -> None:
    assert clarity(picture()) > 5 * MIN_CLARITY


@pytest.mark.parametrize(
    "change",
    [
        lambda grey: 0.1 * grey + 20.0,
        lambda grey: grey * SHADE,
        lambda grey: cv2.GaussianBlur(grey, (0, 0), 1.0),
        lambda grey: grey + np.random.default_rng(1).normal(0.0, 12.0, grey.shape),
    ],
    ids=["dim", "shaded", "blurred", "noisy"],
)
def test_light_and_noise_do_not_hide_it(change) -> None:  # type: ignore[no-untyped-def]
    changed = np.clip(np.rint(change(picture().astype(np.float64))), 0, 255).astype(np.uint8)
    assert clarity(changed) > MIN_CLARITY


def test_a_shadows_edge_is_no_scatter() -> None:
    shaded = np.clip(np.rint(picture() * SHADE), 0, 255).astype(np.uint8)
    assert clarity(shaded) > 10 * MIN_CLARITY


def test_another_id_does_not_explain_it() -> None:
    others = [clarity(picture(), other) for other in range(0, 100, 3) if other != MARKER_ID]
    assert max(others) < MIN_CLARITY


def test_a_wall_holds_no_code() -> None:
    far = render(camera_from_marker(30.0), "bricks", noise=4.0)
    bare = np.asarray(cv2.cvtColor(far, cv2.COLOR_RGB2GRAY), np.uint8)
    check = CodeCheck(BOOK)
    assert (
        max(check.clarity(bare, CORNERS, marker_id) for marker_id in range(0, 100, 5)) < MIN_CLARITY
    )


def test_a_code_in_the_dark_is_none() -> None:
    """A code's modules in a picture without the light surroundings of its black border."""
    grey = picture()
    black = np.zeros_like(grey)
    inside = np.zeros_like(grey)
    cv2.fillConvexPoly(inside, np.round(CORNERS).astype(np.int32), 255)
    assert clarity(np.where(inside > 0, grey, black).astype(np.uint8)) == 0.0
    grey_wall = np.full_like(grey, 110)
    assert clarity(np.where(inside > 0, grey, grey_wall).astype(np.uint8)) > MIN_CLARITY


def test_surroundings_outside_of_the_picture_do_not_count() -> None:
    left = int(CORNERS[:, 0].min())
    cut = np.ascontiguousarray(picture()[:, left:])
    moved = CORNERS - (left, 0)
    assert CodeCheck(BOOK).clarity(cut, moved, MARKER_ID) > MIN_CLARITY


@pytest.mark.parametrize(
    "corners",
    [
        np.full((4, 2), 100.0),
        np.array([(0.0, 0.0), (10.0, 0.0), (20.0, 0.0), (30.0, 0.0)]),
        np.array([(600.0, 400.0), (700.0, 400.0), (700.0, 500.0), (600.0, 500.0)]),
    ],
    ids=["point", "line", "half outside"],
)
def test_corners_of_no_square_have_no_code(corners: NDArray[np.float64]) -> None:
    assert CodeCheck(BOOK).clarity(picture(), corners, MARKER_ID) == 0.0


def test_a_code_with_a_single_white_module_can_be_judged() -> None:
    bits = np.zeros((4, 4), np.uint8)
    bits[1, 2] = 1
    book = cv2.aruco.Dictionary(cv2.aruco.Dictionary.getByteListFromBits(bits), 4, 0)
    black = np.asarray(cv2.aruco.generateImageMarker(book, 0, 120), np.uint8)
    grey = np.pad(black, 40, constant_values=255)
    corners = np.array([(39.5, 39.5), (159.5, 39.5), (159.5, 159.5), (39.5, 159.5)])
    assert CodeCheck(book).clarity(grey, corners, 0) > MIN_CLARITY

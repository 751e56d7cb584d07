"""Corners from edges."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from mazebot.perception.corners import refine_corners
from tests.perception.scene import camera_from_marker, project, render


@pytest.mark.parametrize(("distance_m", "turn_deg"), [(1.0, 0), (2.5, 50), (4.0, -20)])
@pytest.mark.parametrize("blur_px", [0.0, 0.8])
def test_corners_are_found_to_a_tenth_of_a_pixel(
    distance_m: float, turn_deg: float, blur_px: float
) -> None:
    pose = camera_from_marker(distance_m, math.radians(turn_deg), 0.05, 0.1)
    grey = cv2.cvtColor(render(pose, "bricks"), cv2.COLOR_RGB2GRAY)
    if blur_px:
        grey = cv2.GaussianBlur(grey, (0, 0), blur_px)
    true = project(pose)
    rough = true + np.array([(1.0, 0.8), (-0.9, 0.7), (-0.6, -1.0), (0.9, -0.7)])
    assert np.abs(refine_corners(np.asarray(grey, np.uint8), rough) - true).max() < 0.1


def test_corners_stay_where_there_is_no_edge() -> None:
    rough = np.array([(100.0, 100.0), (140.0, 100.0), (140.0, 140.0), (100.0, 140.0)])
    flat = np.full((480, 640), 90, np.uint8)
    assert refine_corners(flat, rough).tolist() == rough.tolist()


def test_corners_do_not_go_astray_among_speckles() -> None:
    rough = np.array([(100.0, 100.0), (140.0, 100.0), (120.0, 104.0), (100.0, 104.0)])
    rng = np.random.default_rng(0)
    for _ in range(20):
        speckled = rng.integers(0, 255, (200, 200), np.uint8)
        assert np.abs(refine_corners(speckled, rough) - rough).max() <= 3.0


@pytest.mark.parametrize("side_px", [0.0, 0.5])
def test_a_square_of_no_size_stays_as_it_is(side_px: float) -> None:
    rough = side_px * np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]) + 50.0
    grey = np.full((100, 100), 90, np.uint8)
    assert refine_corners(grey, rough).tolist() == rough.tolist()

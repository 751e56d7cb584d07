"""A marker's pose from its corners."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from mazebot.common.maths.frames import Array
from mazebot.perception.pose import Camera, Solution, solve
from tests.perception.scene import (
    CAMERA,
    MARKER_SIDE_M,
    camera_from_marker,
    project,
    turn_between,
)

PINHOLE = Camera(CAMERA, np.zeros(5))
SIGMA_PX = 0.1
MIN_SCORE = 0.01


def solutions(corners: Array, sigma_px: float = SIGMA_PX) -> list[Solution]:
    return solve(corners, MARKER_SIDE_M, PINHOLE, sigma_px, MIN_SCORE)


def error(solution: Solution, pose: Array) -> Array:
    """(6,) error in the order of the covariance."""
    found = solution.camera_from_marker
    return np.concatenate([found[:3, 3] - pose[:3, 3], turn_between(found, pose)])


@pytest.mark.parametrize("distance_m", [0.5, 2.0, 5.0])
@pytest.mark.parametrize("turn_deg", [-60, -20, 0, 35, 60])
def test_true_corners_give_the_true_pose(distance_m: float, turn_deg: float) -> None:
    pose = camera_from_marker(distance_m, math.radians(turn_deg), 0.1, 0.2, 0.05)
    best = solutions(project(pose))[0]
    assert np.abs(error(best, pose)).max() < 1e-4
    assert best.reprojection_error_px < 1e-3
    assert best.score > 0.5


def test_a_marker_seen_head_on_has_x_right_y_up_and_z_towards_the_camera() -> None:
    corners = np.array([(270.0, 190.0), (370.0, 190.0), (370.0, 290.0), (270.0, 290.0)])
    pose = solutions(corners)[0].camera_from_marker
    # The optical frame has x right, y down, z away.
    assert pose[:3, 0] @ np.array([1.0, 0.0, 0.0]) > 0.99
    assert pose[:3, 1] @ np.array([0.0, -1.0, 0.0]) > 0.99
    assert pose[:3, 2] @ np.array([0.0, 0.0, -1.0]) > 0.99
    assert pose[2, 3] == pytest.approx(MARKER_SIDE_M * CAMERA[0, 0] / 100.0, rel=1e-3)


def test_a_far_marker_nearly_head_on_keeps_both_tilts() -> None:
    """With the corners' noise, the wrong one comes first now and then; the true one is kept."""
    rng = np.random.default_rng(5)
    pose = camera_from_marker(5.0, math.radians(8))
    both = wrong_first = 0
    for _ in range(100):
        found = solutions(project(pose) + rng.normal(0.0, SIGMA_PX, (4, 2)))
        turns = [float(np.linalg.norm(turn_between(s.camera_from_marker, pose))) for s in found]
        assert min(turns) < math.radians(15)
        assert sum(s.score for s in found) == pytest.approx(1.0, abs=MIN_SCORE)
        assert found[0].score >= found[-1].score
        both += len(found) == 2
        wrong_first += turns[0] > min(turns)
    assert both > 30
    assert wrong_first > 0


def test_the_two_tilts_mirror_each_other_about_the_line_of_sight() -> None:
    found = solutions(project(camera_from_marker(5.0, math.radians(10))), sigma_px=0.5)
    assert len(found) == 2
    yaws = [math.atan2(-z[0], -z[2]) for z in (s.camera_from_marker[:3, 2] for s in found)]
    assert yaws[0] == pytest.approx(math.radians(10), abs=0.01)
    assert yaws[1] == pytest.approx(-math.radians(10), abs=0.03)


@pytest.mark.parametrize(("distance_m", "turn_deg"), [(1.0, 15), (1.0, 60), (4.0, 45), (5.0, 60)])
def test_a_near_or_oblique_marker_has_one_pose(distance_m: float, turn_deg: float) -> None:
    pose = camera_from_marker(distance_m, math.radians(turn_deg))
    (only,) = solutions(project(pose))
    # The other solution's share is not shown.
    assert only.score > 1.0 - MIN_SCORE


@pytest.mark.parametrize(("distance_m", "turn_deg"), [(1.0, 20), (2.0, -45), (4.0, 40), (3.0, 60)])
def test_errors_are_as_large_as_the_covariance_says(distance_m: float, turn_deg: float) -> None:
    """The normalised squared error has mean 6; less, since great residuals raise the covariance."""
    rng = np.random.default_rng(11)
    pose = camera_from_marker(distance_m, math.radians(turn_deg), 0.1, 0.2)
    normalised = []
    for _ in range(200):
        best = solutions(project(pose) + rng.normal(0.0, SIGMA_PX, (4, 2)))[0]
        off = error(best, pose)
        normalised.append(float(off @ np.linalg.solve(best.covariance, off)))
    assert 4.0 < np.mean(normalised) < 7.0
    assert np.percentile(normalised, 95) < 16.0


def test_the_covariance_is_symmetric_positive_and_largest_along_the_line_of_sight() -> None:
    for distance_m in (0.5, 2.0, 6.0):
        covariance = solutions(project(camera_from_marker(distance_m)))[0].covariance
        assert (covariance == covariance.T).all()
        assert np.linalg.eigvalsh(covariance).min() > 0.0
        assert covariance[2, 2] > 2.0 * max(covariance[0, 0], covariance[1, 1])


def test_the_turn_of_a_marker_nearly_lost_in_noise_is_still_finite() -> None:
    covariance = solutions(project(camera_from_marker(6.0)), sigma_px=50.0)[0].covariance
    assert np.diag(covariance)[3:].max() <= 1.0


def test_a_marker_seen_from_behind_is_none() -> None:
    assert solutions(project(camera_from_marker(2.0, 0.5))[::-1]) == []


def test_corners_that_fit_badly_have_a_larger_covariance() -> None:
    pose = camera_from_marker(2.0, math.radians(40))
    bent = project(pose) + np.array([(1.5, 0.0), (0.0, 0.0), (1.5, 0.0), (0.0, 0.0)])
    good, bad = solutions(project(pose))[0], solutions(bent)[0]
    assert bad.reprojection_error_px > 0.4
    assert bad.covariance[2, 2] > 4.0 * good.covariance[2, 2]


def seen_by(lens: Camera, pose: Array) -> Array:
    half_m = MARKER_SIDE_M / 2
    square = np.array([(-1, 1, 0), (1, 1, 0), (1, -1, 0), (-1, -1, 0)]) * half_m
    turn, _ = cv2.Rodrigues(pose[:3, :3])
    pixels = cv2.projectPoints(square, turn, pose[:3, 3], lens.matrix, lens.distortion)[0]
    return np.asarray(pixels, np.float64)[:, 0]


def lens_of(focal_px: float, *distortion: float) -> Camera:
    matrix = np.array([(focal_px, 0.0, 320.0), (0.0, focal_px, 240.0), (0.0, 0.0, 1.0)])
    return Camera(matrix, np.array(distortion))


WIDE = lens_of(380.0, -0.32, 0.11, 0.0005, -0.0003, -0.017)
WIDER = lens_of(330.0, -0.30, 0.075, 0.0, 0.0, -0.0075)


def test_a_lens_distortion_is_taken_into_account() -> None:
    pose = camera_from_marker(1.2, math.radians(30), 0.0, 0.35)
    lens = Camera(CAMERA, np.array([-0.25, 0.08, 0.001, -0.001, 0.0]))
    corners = seen_by(lens, pose)
    best = solve(corners, MARKER_SIDE_M, lens, SIGMA_PX, MIN_SCORE)[0]
    assert np.abs(error(best, pose)).max() < 1e-3
    wrong = solutions(corners)[0]
    assert np.abs(error(wrong, pose)).max() > 1e-2


@pytest.mark.parametrize("lens", [WIDE, WIDER], ids=["wide", "wider"])
@pytest.mark.parametrize(("distance_m", "bearing_rad"), [(0.5, 0.5), (1.0, 0.62), (1.2, -0.6)])
def test_at_the_edge_of_a_wide_lens_errors_are_as_large_as_the_covariance_says(
    lens: Camera, distance_m: float, bearing_rad: float
) -> None:
    pose = camera_from_marker(distance_m, math.radians(35), 0.1, bearing_rad)
    corners = seen_by(lens, pose)
    best = solve(corners, MARKER_SIDE_M, lens, SIGMA_PX, MIN_SCORE)[0]
    assert np.abs(error(best, pose)).max() < 1e-4
    rng = np.random.default_rng(11)
    normalised = []
    for _ in range(100):
        noisy = corners + rng.normal(0.0, SIGMA_PX, (4, 2))
        found = solve(noisy, MARKER_SIDE_M, lens, SIGMA_PX, MIN_SCORE)[0]
        off = error(found, pose)
        normalised.append(float(off @ np.linalg.solve(found.covariance, off)))
    assert 4.0 < np.mean(normalised) < 7.0
    assert np.percentile(normalised, 95) < 16.0


def test_corners_that_a_lens_cannot_show_have_no_pose() -> None:
    """Its distortion turns back within the picture: no place ahead is seen in the corner."""
    lens = lens_of(330.0, -0.35, 0.0, 0.0, 0.0, 0.0)
    corners = np.array([(610.0, 440.0), (635.0, 440.0), (635.0, 465.0), (610.0, 465.0)])
    assert solve(corners, MARKER_SIDE_M, lens, SIGMA_PX, MIN_SCORE) == []


@pytest.mark.parametrize(
    "corners",
    [
        np.full((4, 2), 100.0),
        np.array([(0.0, 0.0), (10.0, 0.0), (20.0, 0.0), (30.0, 0.0)]),
        np.array([(0.0, 0.0), (50.0, 50.0), (50.0, 0.0), (0.0, 50.0)]),
        np.full((4, 2), np.nan),
    ],
    ids=["point", "line", "bow", "nan"],
)
def test_corners_of_no_square_never_give_what_is_not_finite(corners: Array) -> None:
    for solution in solutions(corners):
        assert np.isfinite(solution.camera_from_marker).all()
        assert np.isfinite(solution.covariance).all()
        assert 0.0 <= solution.score <= 1.0

"""Where a marker is, from its corners: every pose that explains them, with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from services.common.frames import Array
from services.perception.corners import Corners

SAME_ROTATION_RAD = 0.03
"""Two solutions nearer than this to each other are one."""

_ROTATION_PRIOR_RAD = 1.0
"""No marker is turned by more than this from a solution: keeps a far one's covariance finite."""


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a pinhole camera, a pixel's coordinates being those of its centre.

    `matrix` is (3, 3) float64 in pixels, `distortion` OpenCV's (k1, k2, p1, p2, ...) float64.
    """

    matrix: Array
    distortion: Array


@dataclass(frozen=True)
class Solution:
    """One pose of a marker, in the camera's optical frame.

    `camera_from_marker` is (4, 4): the marker's x axis points to its right, y up, z out of its
    face. `covariance` is (6, 6) of (x, y, z, rx, ry, rz) in m2 and rad2: a displacement along the
    camera's axes, and a small turn about them at the marker's centre. `score` is the solution's
    share in the likelihood of all.
    """

    camera_from_marker: Array
    covariance: Array
    score: float
    reprojection_error_px: float


def solve(
    corners: Corners,
    side_m: float,
    camera: Camera,
    corner_sigma_px: float,
    min_score: float,
) -> list[Solution]:
    """The poses of a square marker that explain its corners, best first; one or two.

    A square seen from far or nearly head-on looks the same tilted either way. IPPE
    (Collins and Bartoli, https://doi.org/10.1007/s11263-014-0725-5) finds both poses, and both are
    refined by Levenberg-Marquardt on the reprojection error. With Gaussian corner noise, the
    likelihood of a pose is exp(-e2 / (2 sigma2)), e2 being the sum of its squared reprojection
    errors; a solution's score is its likelihood over the sum of both, and the worse one is kept
    where its score reaches `min_score`.

    Args:
        corners: (4, 2) corners in pixels: top left, top right, bottom right, bottom left of the
            marker as one looks at it upright.
        side_m: side of the black square.
        camera: intrinsics.
        corner_sigma_px: standard deviation of a corner's coordinate; the residuals of the best
            solution can only raise it.
        min_score: least score, 0 to 0.5, at which the second solution is kept.

    Returns:
        Solutions in front of the camera and seen from their face; empty where there is none.
    """
    half_m = side_m / 2
    square = np.array(
        [(-half_m, half_m, 0), (half_m, half_m, 0), (half_m, -half_m, 0), (-half_m, -half_m, 0)]
    )
    try:
        count, rotations, translations, _ = cv2.solvePnPGeneric(
            square,
            corners[:, None, :],
            camera.matrix,
            camera.distortion,
            flags=cv2.SOLVEPNP_IPPE_SQUARE,
        )
    except cv2.error:
        return []
    fits: list[_Fit] = []
    for rotation, translation in zip(rotations[:count], translations[:count], strict=True):
        fit = _refined(square, corners, camera, rotation, translation)
        if fit is not None and not any(_same(fit, other) for other in fits):
            fits.append(fit)
    if not fits:
        return []
    fits.sort(key=lambda fit: fit.squared_error_px2)
    best_px2 = fits[0].squared_error_px2
    # Eight coordinates less six of the pose leave two degrees of freedom.
    variance_px2 = max(corner_sigma_px**2, best_px2 / 2)
    likelihoods = [math.exp(-(f.squared_error_px2 - best_px2) / (2 * variance_px2)) for f in fits]
    total = sum(likelihoods)
    return [
        Solution(
            camera_from_marker=fit.camera_from_marker,
            covariance=_covariance(fit.jacobian, variance_px2),
            score=likelihood / total,
            reprojection_error_px=math.sqrt(fit.squared_error_px2 / 4),
        )
        for fit, likelihood in zip(fits, likelihoods, strict=True)
        if fit is fits[0] or likelihood / total >= min_score
    ]


@dataclass(frozen=True)
class _Fit:
    """A refined pose; `jacobian` is (8, 6) of the corners' pixels by (x, y, z, rx, ry, rz)."""

    camera_from_marker: Array
    squared_error_px2: float
    jacobian: Array


def _refined(
    square: Array,
    corners: Corners,
    camera: Camera,
    rotation: NDArray[Any],
    translation: NDArray[Any],
) -> _Fit | None:
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 1e-10)
    turn, shift = cv2.solvePnPRefineLM(
        square,
        corners[:, None, :],
        camera.matrix,
        camera.distortion,
        rotation.copy(),
        translation.copy(),
        criteria,
    )
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(turn)[0]
    pose[:3, 3] = np.asarray(shift)[:, 0]
    from_marker_px, by_parameter = cv2.projectPoints(
        square, turn, shift, camera.matrix, camera.distortion
    )
    errors_px = from_marker_px[:, 0] - corners
    squared_error_px2 = float((errors_px**2).sum())
    towards_camera = -float(pose[:3, 2] @ pose[:3, 3])
    if not math.isfinite(squared_error_px2) or pose[2, 3] <= 0.0 or towards_camera <= 0.0:
        return None
    by_translation = np.asarray(by_parameter, np.float64)[:, 3:6].reshape(4, 2, 3)
    # A point displaced as the whole marker is, or by a small turn w about its centre: w x arm.
    arms = square @ pose[:3, :3].T
    by_turn = np.stack(
        [-d @ _cross_matrix(arm) for d, arm in zip(by_translation, arms, strict=True)]
    )
    jacobian = np.concatenate([by_translation, by_turn], axis=2).reshape(8, 6)
    return _Fit(pose, squared_error_px2, jacobian)


def _covariance(jacobian: Array, variance_px2: float) -> Array:
    """(6, 6) covariance of a least-squares pose from the noise of its corners."""
    information = jacobian.T @ jacobian / variance_px2
    information[3:, 3:] += np.eye(3) / _ROTATION_PRIOR_RAD**2
    covariance = np.asarray(np.linalg.inv(information), np.float64)
    return (covariance + covariance.T) / 2


def _same(first: _Fit, second: _Fit) -> bool:
    turn = first.camera_from_marker[:3, :3].T @ second.camera_from_marker[:3, :3]
    return math.acos(min(max((float(np.trace(turn)) - 1) / 2, -1.0), 1.0)) < SAME_ROTATION_RAD


def _cross_matrix(v: NDArray[np.float64]) -> Array:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])

"""A marker's pose from its corners: every pose that explains them, with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array, rotation_from_vector
from mazebot.perception.corners import Corners

SAME_ROTATION_RAD = 0.03
"""Two solutions whose rotations differ by less than this are one."""

_ROTATION_PRIOR_RAD = 1.0
"""No marker is turned by more than this from a solution: keeps a far one's covariance finite."""

_UNIT_SQUARE = np.array([(-0.5, 0.5, 0), (0.5, 0.5, 0), (0.5, -0.5, 0), (-0.5, -0.5, 0)])
_MIN_DEPTH_M = 1e-3
_MAX_STEPS = 30
_SMALL_GAIN_PX2 = 1e-10
_DIAGONAL = np.diag_indices(6)
_UNDISTORTING = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-10)
"""By default OpenCV does five steps, which are too few at the edge of a wide lens."""
_NOT_UNDISTORTED_PX = 0.01
_NOWHERE = np.zeros(3)


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

    A square seen from far or nearly head-on looks the same with its depths reversed, so that the
    reprojection error has two minima (Collins and Bartoli, Infinitesimal Plane-Based Pose
    Estimation, https://doi.org/10.1007/s11263-014-0725-5). The first is found from the homography
    (Zhang 2000), the second from the first with its depths reversed, both by Levenberg-Marquardt.
    OpenCV's SOLVEPNP_IPPE_SQUARE is not used: it returns NaN, or a marker seen from behind, if the
    corners are exactly symmetrical.

    With Gaussian corner noise, the likelihood of a pose is exp(-e2 / (2 sigma2)), e2 being the sum
    of its squared reprojection errors. A solution's score is its likelihood over the sum of both,
    and the worse one is kept if its score reaches `min_score`.

    Args:
        corners: (4, 2) corners in pixels: top left, top right, bottom right, bottom left of the
            upright marker.
        side_m: side of the black square.
        camera: intrinsics.
        corner_sigma_px: standard deviation of a corner's coordinate; the residuals of the best
            solution can only raise it.
        min_score: least score, 0 to 0.5, at which the second solution is kept.

    Returns:
        Solutions in front of the camera and seen from their face; empty if there is none, also
        where the lens distortion has no inverse at a corner.
    """
    if not np.isfinite(corners).all():
        return []
    square = side_m * _UNIT_SQUARE
    undistorted = _undistorted(corners, camera)
    if undistorted is None:
        return []
    seen = _Seen(square, *undistorted, camera.matrix)
    start = _pose_from_homography(square, seen.pixels, camera.matrix)
    if start is None:
        return []
    first = _refined(seen, start)
    fits = [first]
    if first.faces_camera:
        second = _refined(seen, _depths_reversed(first.camera_from_marker))
        if not _same(first, second):
            fits.append(second)
    fits = sorted((f for f in fits if f.faces_camera), key=lambda f: f.squared_error_px2)
    if not fits:
        return []
    best_px2 = fits[0].squared_error_px2
    # Eight coordinates less six of the pose leave two degrees of freedom.
    variance_px2 = max(portable.square(corner_sigma_px), best_px2 / 2)
    likelihoods = [
        portable.exp(-(f.squared_error_px2 - best_px2) / (2 * variance_px2)) for f in fits
    ]
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


def _undistorted(corners: Corners, camera: Camera) -> tuple[Array, Array | None] | None:
    """(4, 2) corners in pixels of the camera without distortion, and (4, 2, 2) how far one in the
    picture moves with each of them, None where there is no distortion; None where a corner has no
    inverse.
    """
    points, matrix, distortion = corners[:, None], camera.matrix, camera.distortion
    if not distortion.any():
        plain = cv2.undistortPoints(points, matrix, distortion, P=matrix)
        return np.asarray(plain, np.float64)[:, 0], None
    rays = np.asarray(
        cv2.undistortPoints(points, matrix, distortion, criteria=_UNDISTORTING), np.float64
    )[:, 0]
    if not np.isfinite(rays).all():
        return None
    ahead = np.column_stack([rays, np.ones(4)])
    again, derivative = cv2.projectPoints(ahead, _NOWHERE, _NOWHERE, matrix, distortion)
    focal_px = np.diag(matrix)[:2]
    # By a shift of a point that is at a depth of 1.
    by_pixel = np.asarray(derivative, np.float64)[:, 3:5].reshape(4, 2, 2) / focal_px
    turned = by_pixel[:, 0, 0] * by_pixel[:, 1, 1] - by_pixel[:, 0, 1] * by_pixel[:, 1, 0] <= 0.0
    if turned.any() or not np.abs(again[:, 0] - corners).max() < _NOT_UNDISTORTED_PX:
        return None
    return rays * focal_px + matrix[:2, 2], by_pixel


@dataclass(frozen=True)
class _Seen:
    """A square, and its corners as a camera without distortion would see them.

    `square` is (4, 3) in metres, `pixels` (4, 2), `by_pixel` (4, 2, 2) how far a corner in the
    picture moves with each of them; None: as far.
    """

    square: Array
    pixels: Array
    by_pixel: Array | None
    matrix: Array


@dataclass(frozen=True)
class _Fit:
    """A pose compared with the corners.

    `errors_px` is (8,) in the picture, and `jacobian` (8, 6) its derivative by
    (x, y, z, rx, ry, rz).
    """

    camera_from_marker: Array
    errors_px: Array
    jacobian: Array

    @property
    def squared_error_px2(self) -> float:
        return float(portable.product(self.errors_px, self.errors_px))

    @property
    def faces_camera(self) -> bool:
        """Whether the marker is in front of the camera, with its face towards it."""
        normal, place = self.camera_from_marker[:3, 2], self.camera_from_marker[:3, 3]
        return bool(
            math.isfinite(self.squared_error_px2)
            and place[2] > 0.0
            and portable.product(normal, place) < 0.0
        )


def _fit(seen: _Seen, pose: Array) -> _Fit:
    square, matrix = seen.square, seen.matrix
    # Rotated, but not translated: the lever arms by which a turn moves the corners.
    arms = portable.product(square, pose[:3, :3].T)
    points = arms + pose[:3, 3]
    depth_m = np.maximum(points[:, 2], _MIN_DEPTH_M)
    rays = points[:, :2] / depth_m[:, None]
    errors_px = portable.product(rays, matrix[:2, :2].T) + matrix[:2, 2] - seen.pixels
    by_point = np.zeros((4, 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = 1.0
    by_point[:, :, 2] = -rays
    by_point = portable.product(matrix[:2, :2], by_point) / depth_m[:, None, None]
    if seen.by_pixel is not None:
        # The noise of a corner is that in the picture.
        errors_px = portable.product(seen.by_pixel, errors_px[:, :, None])[:, :, 0]
        by_point = portable.product(seen.by_pixel, by_point)
    x, y, z = arms.T
    # A small turn w moves a corner by w x arm.
    by_turn = np.zeros((4, 3, 3))
    by_turn[:, 0, 1], by_turn[:, 0, 2] = z, -y
    by_turn[:, 1, 0], by_turn[:, 1, 2] = -z, x
    by_turn[:, 2, 0], by_turn[:, 2, 1] = y, -x
    jacobian = np.concatenate([by_point, portable.product(by_point, by_turn)], axis=2).reshape(8, 6)
    return _Fit(pose, errors_px.reshape(8), jacobian)


def _refined(seen: _Seen, pose: Array) -> _Fit:
    """The local minimum of the reprojection error from a start pose, by Levenberg-Marquardt."""
    fit = _fit(seen, pose)
    damping = 1e-3
    for _ in range(_MAX_STEPS):
        information = portable.product(fit.jacobian.T, fit.jacobian)
        information[_DIAGONAL] *= 1.0 + damping
        try:
            step = -portable.solve(information, portable.product(fit.jacobian.T, fit.errors_px))
        except np.linalg.LinAlgError:
            return fit
        moved = fit.camera_from_marker.copy()
        moved[:3, :3] = portable.product(rotation_from_vector(*step[3:].tolist()), moved[:3, :3])
        moved[:3, 3] += step[:3]
        there = _fit(seen, moved)
        gain_px2 = fit.squared_error_px2 - there.squared_error_px2
        if gain_px2 >= 0.0:
            fit, damping = there, damping / 10
            if gain_px2 <= _SMALL_GAIN_PX2 + 1e-6 * fit.squared_error_px2:
                break
        else:
            damping *= 10
            if not damping < 1e6:
                break
    return fit


def _pose_from_homography(square: Array, pixels: Array, matrix: Array) -> Array | None:
    """(4, 4) pose of a plane from its homography; None if the corners are not those of a square."""
    ones, none = np.ones(4), np.zeros(4)
    x, y, (u, v) = square[:, 0], square[:, 1], pixels.T
    equations = np.concatenate(
        [
            np.stack([x, y, ones, none, none, none, -u * x, -u * y], axis=1),
            np.stack([none, none, none, x, y, ones, -v * x, -v * y], axis=1),
        ]
    )
    try:
        entries = portable.solve(equations, np.concatenate([u, v]))
        homography = portable.solve(matrix, np.append(entries, 1.0).reshape(3, 3))
        right, up, place = homography.T * 2.0 / portable.lengths(homography[:, :2].T).sum()
        rotation = np.stack([right, up, np.cross(right, up)], axis=1)
        turn = portable.nearest_rotation(rotation)
    except np.linalg.LinAlgError:
        return None
    pose = np.eye(4)
    pose[:3, :3] = turn
    pose[:3, 3] = place
    return pose if place[2] > 0.0 else None


def _depths_reversed(pose: Array) -> Array:
    """The pose whose points lie as far before the marker's centre as they were behind it."""
    sight = pose[:3, 3] / portable.lengths(pose[:3, 3])
    reversed_ = pose.copy()
    mirror = np.eye(3) - 2.0 * np.outer(sight, sight)
    # Mirrored once more along the marker's own normal, it is a rotation again.
    reversed_[:3, :3] = portable.product(mirror, pose[:3, :3]) * (1.0, 1.0, -1.0)
    return reversed_


def _covariance(jacobian: Array, variance_px2: float) -> Array:
    """(6, 6) covariance of a least-squares pose from the noise of its corners."""
    information = portable.product(jacobian.T, jacobian) / variance_px2
    information[3:, 3:] += np.eye(3) / portable.square(_ROTATION_PRIOR_RAD)
    covariance = np.asarray(portable.inverse(information), np.float64)
    return (covariance + covariance.T) / 2


def _same(first: _Fit, second: _Fit) -> bool:
    turn = portable.product(first.camera_from_marker[:3, :3].T, second.camera_from_marker[:3, :3])
    return portable.acos(min(max((float(np.trace(turn)) - 1) / 2, -1.0), 1.0)) < SAME_ROTATION_RAD

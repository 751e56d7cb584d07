"""The likelihood of a marker's sighting from each pose: a mixture of the sighting's solutions.

A square seen from afar has two poses that look almost alike (IPPE), so a sighting has several
candidates, of which at most one is right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2, Array, inverse_matrix

MarkerCandidate = tuple[Array, Array, float]
"""camera_from_marker (4, 4), its (6, 6) covariance of (x, y, z, turns about x, y, z), its score."""


@dataclass(frozen=True)
class MarkerNoise:
    """Noise added to a candidate's own covariance: errors of calibration, timing, placement."""

    position_std_m: float
    range_ratio_per_m: float
    """Standard deviation of the range, as a ratio of it, for each metre of it."""
    bearing_std_rad: float
    yaw_std_rad: float


@dataclass(frozen=True)
class Sighting:
    """One candidate for a marker's pose, in the base's frame."""

    x_m: float
    y_m: float
    heading_rad: float
    """Of the marker's normal."""
    information: Array
    """(2, 2) inverse covariance of the position."""
    heading_std_rad: float
    weight: float
    """Share in the mixture, its height included: the narrower, the higher."""
    map_from_base: SE2
    """The robot's pose if the candidate is right."""


def sightings(
    map_from_marker: Array,
    candidates: Sequence[MarkerCandidate],
    base_from_camera: Array,
    noise: MarkerNoise,
) -> list[Sighting]:
    """The usable candidates of one sighting; non-finite ones are left out.

    `map_from_marker` and `base_from_camera`: rigid (4, 4), the camera's frame optical.
    """
    found: list[Sighting] = []
    for candidate in candidates:
        sighting = _sighting(map_from_marker, candidate, base_from_camera, noise)
        if sighting is not None:
            found.append(sighting)
    scores = sum(sighting.weight for sighting in found)
    volumes = [
        sighting.heading_std_rad / math.sqrt(_determinant(sighting.information))
        for sighting in found
    ]
    return [
        replace(
            sighting,
            weight=(sighting.weight / scores if scores > 0.0 else 1.0 / len(found))
            * min(volumes)
            / volume,
        )
        for sighting, volume in zip(found, volumes, strict=True)
    ]


def mixture_likelihood(
    poses: Array, map_from_marker: Array, seen: Sequence[Sighting], pose_from_base: SE2
) -> Array:
    """(n,) likelihood, at most about 1, of a sighting from each pose (n, 3), x, y, yaw in the map.

    `pose_from_base`: pose of the base at the sighting, relative to the poses.
    """
    c, s = portable_kernels.cos_sin_each(poses[:, 2])
    east = map_from_marker[0, 3] - poses[:, 0] - c * pose_from_base.x_m + s * pose_from_base.y_m
    north = map_from_marker[1, 3] - poses[:, 1] - s * pose_from_base.x_m - c * pose_from_base.y_m
    yaw_rad = poses[:, 2] + pose_from_base.yaw_rad
    c, s = portable_kernels.cos_sin_each(yaw_rad)
    heading = (
        portable_kernels.atan2(float(map_from_marker[1, 2]), float(map_from_marker[0, 2])) - yaw_rad
    )
    likelihood = np.zeros(len(poses))
    for sighting in seen:
        x = c * east + s * north - sighting.x_m
        y = c * north - s * east - sighting.y_m
        turn = (heading - sighting.heading_rad + math.pi) % (2.0 * math.pi) - math.pi
        info = sighting.information
        squared = info[0, 0] * x * x + 2.0 * info[0, 1] * x * y + info[1, 1] * y * y
        squared += portable.square(turn / sighting.heading_std_rad)
        likelihood += sighting.weight * portable_kernels.exp_each(-0.5 * squared)
    return likelihood


def _determinant(matrix: Array) -> float:
    """Of (2, 2)."""
    return float(matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0])


def _sighting(
    map_from_marker: Array,
    candidate: MarkerCandidate,
    base_from_camera: Array,
    noise: MarkerNoise,
) -> Sighting | None:
    camera_from_marker, covariance, score = candidate
    if not (np.isfinite(camera_from_marker).all() and np.isfinite(covariance).all()):
        return None
    if not (math.isfinite(score) and score >= 0.0):
        return None
    base_from_marker = portable.product(base_from_camera, camera_from_marker)
    base_from_optical = base_from_camera[:3, :3]
    x_m, y_m = float(base_from_marker[0, 3]), float(base_from_marker[1, 3])
    range_m = max(math.hypot(x_m, y_m), 1e-3)
    towards = np.array([x_m, y_m]) / range_m
    across = np.array([-towards[1], towards[0]])
    own = portable.product(base_from_optical, covariance[:3, :3], base_from_optical.T)[:2, :2]
    range_std_m = noise.range_ratio_per_m * range_m * range_m
    place = own + portable.square(noise.position_std_m) * np.eye(2)
    place += portable.square(range_std_m) * np.outer(towards, towards)
    place += portable.square(noise.bearing_std_rad * range_m) * np.outer(across, across)
    determinant = _determinant(place)
    if not (0.0 < determinant < 1e12 and place[0, 0] > 0.0):
        return None
    own_turn = portable.product(base_from_optical, covariance[3:, 3:], base_from_optical.T)[2, 2]
    heading_std_rad = math.sqrt(max(float(own_turn), 0.0) + portable.square(noise.yaw_std_rad))
    normal_x, normal_y = float(base_from_marker[0, 2]), float(base_from_marker[1, 2])
    if math.hypot(normal_x, normal_y) < 0.5:
        # The marker lies flat, so its normal has no heading.
        heading_std_rad = 1e3
    map_from_base = portable.product(map_from_marker, inverse_matrix(base_from_marker))
    return Sighting(
        x_m,
        y_m,
        portable_kernels.atan2(normal_y, normal_x),
        np.asarray(portable.inverse(place), np.float64),
        heading_std_rad,
        score,
        SE2(
            float(map_from_base[0, 3]),
            float(map_from_base[1, 3]),
            portable_kernels.atan2(float(map_from_base[1, 0]), float(map_from_base[0, 0])),
        ),
    )

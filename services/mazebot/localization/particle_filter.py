"""The arithmetic of a particle filter on planar poses: motion, weights, resampling, mean.

Particles are (n, 3) float64 rows of x in metres, y in metres and yaw in radians. Random numbers
come in as arrays. Formulas and tables: Thrun, Burgard, Fox, Probabilistic Robotics (2005).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.maths.kernels import kernel, shared_kernel
from mazebot.localization.likelihood_field import LikelihoodField

_NO_TURN_BELOW_M = 0.01
"""A shorter move has no defined direction: its first turn is taken as zero, as in AMCL."""

FACE_STRIDE = 3
WRONG_FACE = 2.0
"""Loss of log-likelihood of a beam that ends at the far face of a wall."""
IN_WALL_M = -0.02
"""A signed distance below this is inside a wall."""


@dataclass(frozen=True)
class OdometryNoise:
    """Table 5.6 in AMCL's units: variance of a turn or a move for each unit of its square."""

    alpha1: float
    """of a turn, by turning"""
    alpha2: float
    """of a turn, by moving, in rad^2/m^2"""
    alpha3: float
    """of a move, by moving"""
    alpha4: float
    """of a move, by turning, in m^2/rad^2"""


@dataclass(frozen=True)
class OdometryMotion:
    """A motion as a turn, a straight move and a second turn, with their standard deviations."""

    rotation1_rad: float
    translation_m: float
    rotation2_rad: float
    rotation1_std_rad: float
    translation_std_m: float
    rotation2_std_rad: float


def odometry_motion(before_from_after: SE2, noise: OdometryNoise) -> OdometryMotion:
    """The motion that odometry reports, with its noise (table 5.6)."""
    moved = math.hypot(before_from_after.x_m, before_from_after.y_m)
    turn1 = (
        portable_kernels.atan2(before_from_after.y_m, before_from_after.x_m)
        if moved >= _NO_TURN_BELOW_M
        else 0.0
    )
    turn2 = wrap_angle(before_from_after.yaw_rad - turn1)
    # Driving backwards is not a half turn: its noise is that of the smaller angle, as in AMCL.
    small1 = min(abs(turn1), abs(wrap_angle(turn1 - math.pi)))
    small2 = min(abs(turn2), abs(wrap_angle(turn2 - math.pi)))
    moved_2, turn1_2, turn2_2 = moved * moved, small1 * small1, small2 * small2
    return OdometryMotion(
        turn1,
        moved,
        turn2,
        math.sqrt(noise.alpha1 * turn1_2 + noise.alpha2 * moved_2),
        math.sqrt(noise.alpha3 * moved_2 + noise.alpha4 * (turn1_2 + turn2_2)),
        math.sqrt(noise.alpha1 * turn2_2 + noise.alpha2 * moved_2),
    )


def move_particles(
    particles: Array, motion: OdometryMotion, standard_normal: Array, scales: Array
) -> None:
    """Move each particle, in place, by the motion and its own draw of `standard_normal` (n, 3).

    `scales` (n, 2) are each particle's own errors of odometry's scale, in moves and in turns.
    """
    _move(
        particles, standard_normal, scales, motion.rotation1_rad, motion.translation_m,
        motion.rotation2_rad, wrap_angle(motion.rotation1_rad + motion.rotation2_rad) / 2.0,
        motion.rotation1_std_rad, motion.translation_std_m, motion.rotation2_std_rad,
    )  # fmt: skip


def scan_log_weights(
    field: LikelihoodField, particles: Array, points_m: Array, before_m: Array, beam_weight: float
) -> Array:
    """(n,) log-likelihood of a scan at each particle: the likelihood field model of table 6.3.

    `particles` are in the map frame; `points_m` (m, 2) are the ends of the beams in the base's
    frame, `before_m` (m, 2) points shortly before them. Each beam's term is multiplied by
    `beam_weight`. The field is as high at the far face of a wall as at the near one: of every third
    beam the point before the end is looked at, which must not be inside the wall.
    """
    weights = np.empty(len(particles))
    pose = field.map_from_field
    _score(
        particles, np.ascontiguousarray(points_m),
        np.ascontiguousarray(before_m[:: FACE_STRIDE]), field.log_likelihood, field.distance_m,
        1.0 / field.cell_m, pose.x_m, pose.y_m, pose.yaw_rad, field.least_log_likelihood, weights,
    )  # fmt: skip
    weights *= beam_weight
    return weights


def normalised(log_weights: Array) -> Array:
    """(n,) weights that sum to one, from logarithms of any scale."""
    weights = portable_kernels.exp_each(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum(), np.float64)


def effective_sample_size(weights: Array) -> float:
    """Effective sample size of normalised weights: one over the sum of their squares."""
    return 1.0 / float(np.square(weights).sum())


def low_variance_resample(weights: Array, uniform: float, count: int) -> NDArray[np.int64]:
    """(count,) indices in proportion to normalised weights, by one draw in [0, 1): table 4.4."""
    indices: NDArray[np.int64] = _systematic(weights, uniform, count)
    return indices


def smoothed(
    states: Array, chosen: NDArray[np.int64], ratio: float, least_std: Array, standard_normal: Array
) -> Array:
    """(n, d) the `chosen` (n,) of states (m, d), shrunk to their mean and spread by a kernel of
    their own covariance with their draws (n, d), so that the covariance of the whole stays what it
    was (Liu and West, 2001). The third column is an angle.

    `ratio` is the kernel's share of the spread. Each deviation is at least `least_std` (d,). The
    kernel makes up for what drawing n of them loses on average, one n-th of the covariance.
    """
    made = np.empty((len(chosen), states.shape[1]))
    _smooth(states, chosen, ratio, least_std, standard_normal, made)
    return made


def kld_sample_size(
    particles: Array, bin_m: float, bin_rad: float, error: float, quantile: float
) -> int:
    """Particles needed for a Kullback-Leibler `error` at a standard normal `quantile` (table 8.4).

    It grows with the number of bins in which particles lie.
    """
    column = np.floor(particles[:, 0] / bin_m).astype(np.int64)
    row = np.floor(particles[:, 1] / bin_m).astype(np.int64)
    turn = np.floor(particles[:, 2] / bin_rad).astype(np.int64)
    k = len(np.unique((column * 1_000_003 + row) * 1_009 + turn))
    if k <= 1:
        return 1
    b = 2.0 / (9.0 * (k - 1))
    root = 1.0 - b + math.sqrt(b) * quantile
    return math.ceil((k - 1) / (2.0 * error) * (root * root * root))


def difference(pose: SE2, other: SE2) -> Array:
    """(3,) x, y and yaw of a pose, less those of another."""
    turn_rad = wrap_angle(pose.yaw_rad - other.yaw_rad)
    return np.array([pose.x_m - other.x_m, pose.y_m - other.y_m, turn_rad])


def squared_mahalanobis(pose: SE2, other: SE2, covariance: Array) -> float:
    """Squared Mahalanobis distance of two poses, by the (3, 3) covariance of x, y and yaw."""
    off = difference(pose, other)
    return float(portable.product(off, portable.solve(covariance, off)))


def mean_and_covariance(particles: Array, weights: Array) -> tuple[SE2, Array]:
    """Weighted mean, its yaw a circular mean, and the (3, 3) covariance of (x, y, yaw) about it."""
    mean, covariance = _moments(particles, weights)
    return SE2(float(mean[0]), float(mean[1]), float(mean[2])), covariance


def heaviest_cluster(
    particles: Array, weights: Array, bin_m: float, bin_rad: float
) -> NDArray[np.bool_]:
    """(n,) which particles lie within one bin of the mean of the heaviest bin.

    The mean of two distant hypotheses would be a pose that neither of them supports.
    """
    column = np.floor(particles[:, 0] / bin_m).astype(np.int64)
    row = np.floor(particles[:, 1] / bin_m).astype(np.int64)
    turn = np.floor(particles[:, 2] / bin_rad).astype(np.int64)
    _, index = np.unique((column * 1_000_003 + row) * 1_009 + turn, return_inverse=True)
    inside = index == np.argmax(np.bincount(index, weights))
    total = weights[inside].sum()
    centre, _ = mean_and_covariance(particles[inside], weights[inside] / total)
    turned = (particles[:, 2] - centre.yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
    near = portable.hypot_each(particles[:, 0] - centre.x_m, particles[:, 1] - centre.y_m) <= bin_m
    return np.asarray(near & (np.abs(turned) <= bin_rad))


@kernel(
    "void(float64[:, ::1], float64[:, ::1], float64[:, ::1], float64, float64, float64, float64, "
    "float64, float64, float64)",
)
def _move(
    particles: Array,
    draws: Array,
    scales: Array,
    turn1: float,
    moved: float,
    turn2: float,
    half_turn: float,
    turn1_std: float,
    moved_std: float,
    turn2_std: float,
) -> None:
    for i in range(particles.shape[0]):
        # Of the whole turn: driving backwards is no half turn and another.
        more = scales[i, 1] * half_turn
        heading = particles[i, 2] + turn1 + more + turn1_std * draws[i, 0]
        distance = (1.0 + scales[i, 0]) * moved + moved_std * draws[i, 1]
        c, s = portable_kernels.cos_sin(heading)
        particles[i, 0] += distance * c
        particles[i, 1] += distance * s
        yaw = heading + turn2 + more + turn2_std * draws[i, 2]
        particles[i, 2] = (yaw + math.pi) % (2.0 * math.pi) - math.pi


@shared_kernel()
def _cells_of(
    x: Array,
    y: Array,
    cosine: Array,
    sine: Array,
    ahead: float,
    aside: float,
    rows: int,
    columns: int,
    cells: NDArray[np.int32],
) -> None:
    """Index in the field of a point seen from each pose, all in cells; -1: outside."""
    width, height, stride = np.float64(columns), np.float64(rows), np.int32(columns)
    for i in range(cells.size):
        u = x[i] + cosine[i] * ahead - sine[i] * aside
        v = y[i] + sine[i] * ahead + cosine[i] * aside
        inside = (u >= 0.0) & (v >= 0.0) & (u < width) & (v < height)
        u, v = u if inside else 0.0, v if inside else 0.0
        cell = np.int32(v) * stride + np.int32(u)
        cells[i] = cell if inside else np.int32(-1)


@kernel(
    "void(float64[:, ::1], float64[:, ::1], float64[:, ::1], float32[:, ::1], float32[:, ::1], "
    "float64, float64, float64, float64, float64, float64[::1])",
)
def _score(
    particles: Array,
    points_m: Array,
    before_m: Array,
    log_likelihood: NDArray[np.float32],
    distance_m: NDArray[np.float32],
    cells_per_m: float,
    field_x_m: float,
    field_y_m: float,
    field_yaw_rad: float,
    outside: float,
    weights: Array,
) -> None:
    rows, columns = log_likelihood.shape
    values, distances = log_likelihood.reshape(-1), distance_m.reshape(-1)
    cf, sf = portable_kernels.cos_sin(field_yaw_rad)
    count = particles.shape[0]
    x, y, c, s = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        mx = particles[i, 0] - field_x_m
        my = particles[i, 1] - field_y_m
        x[i] = (cf * mx + sf * my) * cells_per_m
        y[i] = (cf * my - sf * mx) * cells_per_m
        cosine, sine = portable_kernels.cos_sin(particles[i, 2] - field_yaw_rad)
        c[i], s[i] = cosine * cells_per_m, sine * cells_per_m
        weights[i] = 0.0
    # Over the particles, which are independent: it compiles to vector instructions.
    cells = np.empty(count, np.int32)
    for j in range(points_m.shape[0]):
        _cells_of(x, y, c, s, points_m[j, 0], points_m[j, 1], rows, columns, cells)
        for i in range(count):
            value = np.float64(values[np.uint32(cells[i] if cells[i] >= 0 else 0)])
            weights[i] += value if cells[i] >= 0 else outside
    for j in range(before_m.shape[0]):
        _cells_of(x, y, c, s, before_m[j, 0], before_m[j, 1], rows, columns, cells)
        for i in range(count):
            in_wall = distances[np.uint32(cells[i] if cells[i] >= 0 else 0)] < IN_WALL_M
            weights[i] -= FACE_STRIDE * WRONG_FACE if in_wall & (cells[i] >= 0) else 0.0


@kernel("Tuple((float64[::1], float64[:, ::1]))(float64[:, ::1], float64[::1])")
def _moments(particles: Array, weights: Array) -> tuple[Array, Array]:
    mean = np.zeros(3)
    cosine = 0.0
    sine = 0.0
    for i in range(particles.shape[0]):
        mean[0] += weights[i] * particles[i, 0]
        mean[1] += weights[i] * particles[i, 1]
        c, s = portable_kernels.cos_sin(particles[i, 2])
        cosine += weights[i] * c
        sine += weights[i] * s
    mean[2] = portable_kernels.atan2(sine, cosine)
    covariance = np.zeros((3, 3))
    offset = np.zeros(3)
    for i in range(particles.shape[0]):
        offset[0] = particles[i, 0] - mean[0]
        offset[1] = particles[i, 1] - mean[1]
        turn = particles[i, 2] - mean[2]
        offset[2] = (turn + math.pi) % (2.0 * math.pi) - math.pi
        for j in range(3):
            for k in range(3):
                covariance[j, k] += weights[i] * offset[j] * offset[k]
    return mean, covariance


@kernel("int64[::1](float64[::1], float64, int64)")
def _systematic(weights: Array, uniform: float, count: int) -> NDArray[np.int64]:
    indices = np.empty(count, np.int64)
    last = weights.shape[0] - 1
    i = 0
    cumulative = weights[0]
    for m in range(count):
        target = (m + uniform) / count
        while target > cumulative and i < last:
            i += 1
            cumulative += weights[i]
        indices[m] = i
    return indices


@kernel(
    "void(float64[:, ::1], int64[::1], float64, float64[::1], float64[:, ::1], float64[:, ::1])"
)
def _smooth(
    states: Array,
    chosen: NDArray[np.int64],
    ratio: float,
    least_std: Array,
    draws: Array,
    made: Array,
) -> None:
    count, size = made.shape
    centre = states[chosen[count // 2], 2]
    mean = np.zeros(size)
    for i in range(count):
        for j in range(size):
            value = states[chosen[i], j]
            if j == 2:
                value = (value - centre + math.pi) % (2.0 * math.pi) - math.pi
            made[i, j] = value
            mean[j] += value
    mean /= count
    root = np.zeros((size, size))
    for i in range(count):
        for j in range(size):
            made[i, j] -= mean[j]
            for k in range(j + 1):
                root[j, k] += made[i, j] * made[i, k]
    shrink = math.sqrt(1.0 - ratio * ratio)
    share = ratio * ratio + 1.0 / count
    for j in range(size):
        for k in range(j + 1):
            root[j, k] /= count
        missing = max(least_std[j] * least_std[j] - root[j, j], 0.0)
        for k in range(j + 1):
            root[j, k] *= share
        root[j, j] += missing
    # Cholesky's factors, in place.
    for j in range(size):
        for k in range(j + 1):
            total = root[j, k]
            for m in range(k):
                total -= root[j, m] * root[k, m]
            root[j, k] = math.sqrt(max(total, 1e-18)) if j == k else total / root[k, k]
    for i in range(count):
        for j in range(size):
            value = mean[j] + shrink * made[i, j]
            for k in range(j + 1):
                value += root[j, k] * draws[i, k]
            made[i, j] = value
        made[i, 2] = (made[i, 2] + centre + math.pi) % (2.0 * math.pi) - math.pi

"""The particles of Monte Carlo localisation: carried along by odometry, weighed and resampled.

A particle filter after AMCL. Each particle also has a scale of odometry of its own, in moves and in
turns: slip and a wrong wheel radius do not average out over a drive, so that the spread must grow
with the way and not with its root where nothing is seen.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2, Array, PlanarCovariance, wrap_angles
from mazebot.localization import particle_filter as pf
from mazebot.localization.params import LocalizationParams

_LEAST_PART = 1.0 / 256.0
_CLUSTER_M, _CLUSTER_RAD = 0.6, math.radians(45.0)
_MOST_CLUSTERS = 8
_KLD_BIN_M, _KLD_BIN_RAD = 0.1, math.radians(10.0)
_SCALE_MEMORY_M = 20.0
"""Way, a turn of 1 rad counting 0.25 m, after which a particle's scale is another."""
_ONE_CLUSTER = 0.95
"""The pose is that of one cluster if it holds this share of the weight."""


class ParticleSet:
    """Particles (n, 3) of x, y, yaw in the map, and the estimate that they give."""

    def __init__(self, params: LocalizationParams, rng: np.random.Generator) -> None:
        self._params = params
        self._rng = rng
        self._noise = pf.OdometryNoise(params.alpha1, params.alpha2, params.alpha3, params.alpha4)
        self._log_weights = np.empty(0)
        self._scales = np.empty((0, 2))
        self._updates = 0
        self.poses = np.empty((0, 3))
        self.pose = SE2(0.0, 0.0, 0.0)
        """The estimate: the mean of the heaviest cluster."""
        self.covariance = np.zeros((3, 3))
        """Of all particles about the estimate."""
        self.converged = False
        self.settled = False
        """Whether it is so narrow that a robot at rest needs no more scans."""
        self.share = 0.0
        """Of the weight, in the heaviest cluster."""

    def begin(self, pose: SE2, covariance: Array) -> None:
        """Draw the largest number of particles from a Gaussian.

        Raises ValueError if the covariance has a negative variance.
        """
        self._draw(np.array([pose]), np.zeros(self._params.max_particles, np.int64), covariance)
        self.pose = SE2(*(float(value) for value in pose))
        self.covariance = covariance
        self.converged = self._is_narrow(covariance)
        self.settled = False
        self.share = 1.0

    def begin_at(self, poses: Array, weights: Array, covariance: Array) -> None:
        """Draw them about several poses (n, 3), as many as their weights (n,) say, which sum to 1;
        each has the same covariance.
        """
        count = self._params.max_particles
        chosen = pf.low_variance_resample(weights, float(self._rng.random()), count)
        self._draw(poses, chosen, covariance)
        self._estimate(np.full(count, 1.0 / count))

    def _draw(self, poses: Array, chosen: NDArray[np.int64], covariance: Array) -> None:
        values, vectors = portable.eigh((covariance + covariance.T) / 2.0)
        if values[0] < -1e-9:
            raise ValueError(f"covariance: has a negative variance, {float(values[0]):.3g}")
        draws = portable_kernels.standard_normal(self._rng, (len(chosen), 3))
        spread = portable.product(draws * np.sqrt(np.maximum(values, 0.0)), vectors.T)
        self.poses = np.ascontiguousarray(poses[chosen] + spread)
        self.poses[:, 2] = wrap_angles(self.poses[:, 2])
        self._log_weights = np.zeros(len(self.poses))
        self._scales = self._fresh_scales(len(self.poses))
        self._updates = 0

    def predict(self, before_from_now: SE2) -> None:
        """Move all by odometry."""
        motion = pf.odometry_motion(before_from_now, self._noise)
        draws = portable_kernels.standard_normal(self._rng, self.poses.shape)
        pf.move_particles(self.poses, motion, draws, self._scales)
        self._age_scales(motion.translation_m + 0.25 * abs(before_from_now.yaw_rad))
        self.covariance = self.moved_covariance(before_from_now)
        self.pose = self.pose @ before_from_now

    def measure_spread(self) -> None:
        """Take the covariance from the particles: after motion without a measurement, as their own
        scales of odometry are in it, which add up from step to step.
        """
        weights = pf.normalised(self._log_weights)
        if self.share < _ONE_CLUSTER:
            return
        mean, covariance = pf.mean_and_covariance(self.poses, weights)
        off = np.array([mean.x_m - self.pose.x_m, mean.y_m - self.pose.y_m, 0.0])
        self.covariance = covariance + np.outer(off, off)
        self.converged = self._is_narrow(self.covariance)
        self.settled = False

    def moved_covariance(self, before_from_now: SE2) -> Array:
        """(3, 3) of the estimate after more motion, propagated to first order (table 5.6)."""
        motion = pf.odometry_motion(before_from_now, self._noise)
        heading = self.pose.yaw_rad + motion.rotation1_rad
        c, s = portable_kernels.cos_sin(heading)
        x_by_yaw, y_by_yaw = -s * motion.translation_m, c * motion.translation_m
        scale = self._params.odometry_scale_std
        turned_2 = portable.square(scale * before_from_now.yaw_rad)
        moved_2 = portable.square(scale * motion.translation_m)
        return (
            PlanarCovariance.from_matrix(self.covariance)
            .moved(x_by_yaw, y_by_yaw)
            .spread(portable.square(motion.rotation1_std_rad), x_by_yaw, y_by_yaw, 1.0)
            .spread(portable.square(motion.translation_std_m) + moved_2, c, s, 0.0)
            .spread(portable.square(motion.rotation2_std_rad) + turned_2, 0.0, 0.0, 1.0)
            .matrix()
        )

    def weigh(self, log_likelihood: Array) -> None:
        """Correct the weights by a measurement's log-likelihood (n,), and resample if needed."""
        # If the particles are too sparse for a sharp measurement, one of them would take all the
        # weight, and others near the true pose would be lost: then the measurement is applied in
        # part only, and later ones do the rest.
        needed = self._params.tempering_share * len(self.poses)
        part = 1.0
        weights = pf.normalised(self._log_weights + log_likelihood)
        while pf.effective_sample_size(weights) < needed and part > _LEAST_PART:
            part *= 0.5
            weights = pf.normalised(self._log_weights + part * log_likelihood)
        self._estimate(weights)
        self._updates += 1
        few = pf.effective_sample_size(weights) < self._params.resample_share * len(weights)
        if few and self._updates % self._params.resample_interval == 0:
            self._resample(weights)
        else:
            self._log_weights = portable_kernels.log_each(np.maximum(weights, 1e-300))

    def clusters(self) -> list[tuple[float, SE2, Array]]:
        """Weight, mean and (3, 3) covariance of each cluster, the heaviest first; at most 8."""
        weights = pf.normalised(self._log_weights)
        left, poses = weights, self.poses
        found: list[tuple[float, SE2, Array]] = []
        while len(poses) and len(found) < _MOST_CLUSTERS:
            inside = pf.heaviest_cluster(poses, left, _CLUSTER_M, _CLUSTER_RAD)
            share = float(left[inside].sum())
            if share < 1e-3:
                break
            found.append((share, *pf.mean_and_covariance(poses[inside], left[inside] / share)))
            left, poses = left[~inside], np.ascontiguousarray(poses[~inside])
        return found

    def _estimate(self, weights: Array) -> None:
        mean, covariance = pf.mean_and_covariance(self.poses, weights)
        self.converged = self._is_narrow(covariance)
        self.share = 1.0
        if not self.converged:
            cluster = pf.heaviest_cluster(self.poses, weights, _CLUSTER_M, _CLUSTER_RAD)
            self.share = float(weights[cluster].sum())
            # Of one wide cluster every particle counts, not only those within its bin.
            if self.share < _ONE_CLUSTER and not self._is_one(weights, mean, covariance):
                of_all = mean
                mean, _ = pf.mean_and_covariance(self.poses[cluster], weights[cluster] / self.share)
                off = pf.difference(of_all, mean)
                covariance = covariance + np.outer(off, off)
            else:
                self.share = 1.0
        ratio_2 = portable.square(self._params.settled_ratio)
        self.settled = self.converged and self._is_narrow(covariance / ratio_2)
        self.covariance = covariance
        self.pose = mean

    def _is_one(self, weights: Array, mean: SE2, covariance: Array) -> bool:
        """Whether a wide set is of one piece: much of it is near its mean, as in a Gaussian."""
        spread_m = math.sqrt(max(float(covariance[0, 0]), float(covariance[1, 1])))
        x, y = self.poses[:, 0] - mean.x_m, self.poses[:, 1] - mean.y_m
        near = x * x + y * y < spread_m * spread_m
        return float(covariance[2, 2]) < 0.25 and float(weights[near].sum()) > 0.3

    def _resample(self, weights: Array) -> None:
        p = self._params
        offset = float(self._rng.random())
        kept = self.poses[pf.low_variance_resample(weights, offset, len(weights))]
        count = pf.kld_sample_size(kept, _KLD_BIN_M, _KLD_BIN_RAD, p.pf_err, p.pf_z)
        count = min(max(count, p.min_particles), p.max_particles)
        chosen = pf.low_variance_resample(weights, offset, count)
        # Copies would stay identical while the robot rests, and few might be near the true pose.
        least = np.array([p.roughening_m, p.roughening_m, p.roughening_rad, 0.0, 0.0])
        draws = portable_kernels.standard_normal(self._rng, (count, 5))
        states = np.column_stack([self.poses, self._scales])
        if self.share >= _ONE_CLUSTER:
            made = pf.smoothed(states, chosen, p.roughening_ratio, least, draws)
        else:
            # Several poses: each keeps its own place.
            made = states[chosen] + draws * least
        self.poses = np.ascontiguousarray(made[:, :3])
        self.poses[:, 2] = wrap_angles(self.poses[:, 2])
        self._scales = np.ascontiguousarray(made[:, 3:])
        self._log_weights = np.zeros(count)

    def _fresh_scales(self, count: int) -> Array:
        std = self._params.odometry_scale_std
        return portable_kernels.standard_normal(self._rng, (count, 2)) * std

    def _age_scales(self, travel_m: float) -> None:
        # A random process whose variance stays what it is at the start.
        old = portable.exp(-travel_m / _SCALE_MEMORY_M)
        fresh = math.sqrt(max(1.0 - old * old, 0.0))
        self._scales = old * self._scales + fresh * self._fresh_scales(len(self._scales))

    def _is_narrow(self, covariance: Array) -> bool:
        x_x, x_y, _, y_y, _, yaw_yaw = PlanarCovariance.from_matrix(covariance)
        largest_m2 = (x_x + y_y) / 2.0 + math.hypot((x_x - y_y) / 2.0, x_y)
        return largest_m2 <= portable.square(
            self._params.converged_std_m
        ) and yaw_yaw <= portable.square(self._params.converged_std_rad)

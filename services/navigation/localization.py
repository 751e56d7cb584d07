"""Monte Carlo localisation: the robot's pose in the map, from odometry, lidar scans and markers.

A particle filter after AMCL. Each update is valid at its measurement's stamp and is carried forward
by the odometry since. The field is accurate to a centimetre, so the mean of the particles needs no
scan matching after it.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from services.common import portable, portable_kernels
from services.common.frames import SE2, Array, PlanarCovariance, wrap_angle
from services.navigation import particle_filter as pf
from services.navigation.likelihood_field import likelihood_field
from services.navigation.marker_model import (
    MarkerCandidate,
    MarkerNoise,
    Sighting,
    mixture_likelihood,
    sightings,
)

__all__ = ["Localization", "LocalizationParams", "MarkerCandidate"]

_HISTORY = 90
"""Samples of odometry: 3 s."""
_EXTRAPOLATE_NS = 200_000_000
_LEAST_PART = 1.0 / 256.0
_FAR_M = 1e3
"""No lidar has a longer range, whatever its message states."""
_CLUSTER_M, _CLUSTER_RAD = 0.6, math.radians(45.0)
_KLD_BIN_M, _KLD_BIN_RAD = 0.1, math.radians(10.0)
_INJECT_ABOVE = 0.2
_INJECT_AT_MOST = 0.5
_INJECT_STD = (0.1, 0.1, 0.1)


class LocalizationParams(BaseModel):
    """Parameters, under AMCL's names where it has one.

    The defaults fit a lidar with 0.01 m of noise, wheels that slip by a few percent and a map with
    cells of 0.05 m; AMCL's own (sigma_hit 0.2, z_rand 0.5, alpha 0.2) fit a far worse robot.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    min_particles: int = Field(500, ge=10, description="particles while the pose is certain")
    max_particles: int = Field(2000, ge=10, description="particles at the start, and at most")
    pf_err: float = Field(0.05, gt=0, description="KLD sampling: error of the distribution")
    pf_z: float = Field(2.33, gt=0, description="KLD sampling: normal quantile; 2.33 is 99 %")
    alpha1: float = Field(0.02, ge=0, description="variance of a turn for each rad^2 of turn")
    alpha2: float = Field(0.02, ge=0, description="variance of a turn for each m^2 of move")
    alpha3: float = Field(0.02, ge=0, description="variance of a move for each m^2 of move")
    alpha4: float = Field(0.002, ge=0, description="variance of a move for each rad^2 of turn")
    max_beams: int = Field(90, ge=1, description="beams of a scan that weight the particles")
    z_hit: float = Field(0.9, gt=0, le=1, description="share of returns that come from the map")
    z_rand: float = Field(0.1, gt=0, le=1, description="share of returns from anything else")
    sigma_hit: float = Field(
        0.04,
        gt=0,
        description="m; scatter of returns about the map's walls: lidar noise (0.01) and the "
        "position of a wall's face in its cell (0.05 / sqrt 12), doubled for other errors",
    )
    laser_max_range: float = Field(
        3.5, gt=0, description="m; returns from unmapped objects are spread evenly up to this range"
    )
    laser_likelihood_max_dist: float = Field(
        2.0, gt=0, description="m; distances to the nearest obstacle are limited to this"
    )
    wall_inset_cells: float = Field(
        0.5,
        ge=0,
        le=1,
        description="how far inside its occupied cells a wall's face lies: 0.5 where a cell is "
        "occupied when a wall or a return lies anywhere in it, 0 where its centre decides",
    )
    beam_weight: float = Field(
        0.15,
        gt=0,
        le=1,
        description="weight of one beam: neighbours share the map raster's error on their wall",
    )
    min_returns: int = Field(10, ge=1, description="a scan with fewer returns is not used")
    update_min_d: float = Field(0.05, ge=0, description="m; least move between two updates")
    update_min_a: float = Field(0.05, ge=0, description="rad; least turn between two updates")
    still_update_period_s: float = Field(
        1.0, gt=0, description="time between two updates while the robot is at rest"
    )
    resample_share: float = Field(
        0.5, gt=0, le=1, description="resample below this share of effective particles"
    )
    tempering_share: float = Field(
        0.1, ge=0, le=1, description="one measurement leaves this share of effective particles"
    )
    roughening_m: float = Field(
        0.004, ge=0, description="least spread added to the particles by resampling"
    )
    roughening_rad: float = Field(
        0.004, ge=0, description="least spread added to the particles by resampling"
    )
    roughening_ratio: float = Field(
        0.3, ge=0, description="spread added by resampling, as a share of the particles' own"
    )
    scan_match_tolerance_m: float = Field(
        0.1, gt=0, description="a beam that ends this near to a wall fits the map"
    )
    recovery_alpha_slow: float = Field(
        0.001, gt=0, le=1, description="gain of the long mean of the scan match"
    )
    recovery_alpha_fast: float = Field(
        0.2, gt=0, le=1, description="gain of the short mean of the scan match"
    )
    converged_std_m: float = Field(
        0.15, gt=0, description="the pose is certain below this spread of the particles"
    )
    converged_std_rad: float = Field(
        0.1, gt=0, description="the pose is certain below this spread of the particles"
    )
    settled_ratio: float = Field(
        0.2, gt=0, le=1, description="above this share of the converged spread every scan is used"
    )
    marker_std_m: float = Field(
        0.02, gt=0, description="standard deviation of a marker's position at any range"
    )
    marker_range_ratio_per_m: float = Field(
        0.02, ge=0, description="standard deviation of a marker's range, as a share of it per metre"
    )
    marker_bearing_std_rad: float = Field(
        0.015, ge=0, description="standard deviation of a marker's bearing"
    )
    marker_yaw_std_rad: float = Field(0.1, gt=0, description="standard deviation of a marker's yaw")
    marker_outlier: float = Field(
        1e-3, gt=0, lt=1, description="probability that a marker's detection is an outlier"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.min_particles > self.max_particles:
            raise ValueError(
                f"min_particles: must be at most max_particles, {self.max_particles}, "
                f"not {self.min_particles}"
            )
        return self


class Localization:
    """The robot's pose in the map.

    Frames: `map_from_odom` is the correction; `odom_from_base` comes from odometry. Stamps are
    nanoseconds of simulation. The same calls with the same generator give the same bits.
    """

    def __init__(
        self,
        params: LocalizationParams,
        cells: NDArray[np.int8],
        resolution_m: float,
        origin: SE2,
        rng: np.random.Generator,
    ) -> None:
        """`cells` (rows, columns): 0 free to 100 occupied, -1 unknown, row 0 at the smallest y of
        `origin`, which is map_from_grid.

        Raises ValueError if the map cannot be used.
        """
        self._params = params
        self._rng = rng
        self._noise = pf.OdometryNoise(params.alpha1, params.alpha2, params.alpha3, params.alpha4)
        self._marker_noise = MarkerNoise(
            params.marker_std_m,
            params.marker_range_ratio_per_m,
            params.marker_bearing_std_rad,
            params.marker_yaw_std_rad,
        )
        self._field = likelihood_field(
            cells,
            resolution_m,
            origin,
            z_hit=params.z_hit,
            z_rand=params.z_rand,
            sigma_hit_m=params.sigma_hit,
            max_distance_m=params.laser_likelihood_max_dist,
            wall_inset_cells=params.wall_inset_cells,
            range_max_m=params.laser_max_range,
        )
        # The error that no number of scans averages out: about two faces fix each coordinate, and
        # each lies anywhere in its cell.
        self._raster_covariance = np.diag([1.0, 1.0, 0.0]) * (resolution_m * resolution_m) / 24.0
        self._history: deque[tuple[int, SE2]] = deque(maxlen=_HISTORY)
        self._particles = np.empty((0, 3))
        self._log_weights = np.empty(0)
        self._stamp_ns: int | None = None
        self._odom_from_base: SE2 | None = None
        """Odometry at the particles' time; None before odometry is received."""
        self._map_from_base: SE2 | None = None
        """The estimate at the particles' time."""
        self._covariance = np.zeros((3, 3))
        self._converged = self._settled = False
        self._last_scan: tuple[int, SE2] | None = None
        self._last_marker: dict[tuple[float, ...], tuple[int, SE2]] = {}
        self._match_slow = self._match_fast = 1.0

    @property
    def initialized(self) -> bool:
        """Whether an initial pose was given."""
        return self._map_from_base is not None

    @property
    def converged(self) -> bool:
        """Whether the particles agree on one pose. It may be a wrong one: see `scan_match`."""
        return self._converged

    @property
    def scan_match(self) -> float:
        """Fraction of the returns that lie near the map's walls, 0 to 1, as a running mean.

        Its gain is `recovery_alpha_fast`: half a second of scans. In the house maze it is above
        0.95 all along a drive, above 0.65 with a third of the beams blocked, and below 0.6 one
        second after the robot was moved to another pose.
        """
        return self._match_fast

    def initialize(self, map_from_base: SE2, covariance: Array) -> None:
        """Set the robot's current pose with a (3, 3) covariance of (x, y, yaw).

        Raises ValueError if either is not finite or the covariance is not valid.
        """
        covariance = np.asarray(covariance, np.float64)
        if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
            raise ValueError(f"covariance: must be 3 x 3 and finite, got {covariance.tolist()}")
        if not all(math.isfinite(value) for value in map_from_base):
            raise ValueError(f"initial pose: must be finite, got {tuple(map_from_base)}")
        values, vectors = portable.eigh((covariance + covariance.T) / 2.0)
        if values[0] < -1e-9:
            raise ValueError(f"covariance: has a negative variance, {float(values[0]):.3g}")
        draws = portable_kernels.standard_normal(self._rng, (self._params.max_particles, 3))
        self._particles = np.ascontiguousarray(
            np.array(map_from_base)
            + portable.product(draws * np.sqrt(np.maximum(values, 0.0)), vectors.T)
        )
        self._particles[:, 2] = _wrapped(self._particles[:, 2])
        self._log_weights = np.zeros(len(self._particles))
        self._map_from_base = SE2(*(float(value) for value in map_from_base))
        self._covariance = covariance
        self._converged = self._is_narrow(covariance)
        self._settled = False
        if self._history:
            self._stamp_ns, self._odom_from_base = self._history[-1]
            # Earlier measurements are from another pose.
            self._history = deque([self._history[-1]], maxlen=_HISTORY)
        self._last_scan = None
        self._last_marker.clear()
        self._match_slow = self._match_fast = 1.0

    def odometry(self, stamp_ns: int, odom_from_base: SE2) -> None:
        """Add odometry; a message that is not later than the last one is ignored."""
        if self._history and stamp_ns <= self._history[-1][0]:
            return
        if not all(math.isfinite(value) for value in odom_from_base):
            return
        self._history.append((stamp_ns, odom_from_base))
        if self._odom_from_base is None and self.initialized:
            self._stamp_ns, self._odom_from_base = stamp_ns, odom_from_base

    def scan(
        self,
        stamp_ns: int,
        ranges_m: NDArray[np.float32],
        angle_min_rad: float,
        angle_increment_rad: float,
        range_min_m: float,
        range_max_m: float,
        base_from_scan: SE2,
    ) -> bool:
        """Correct the pose by a scan (n,), counter-clockwise; True if the scan was used.

        Ranges outside [range_min, range_max) or not finite are no returns. A scan is not used if
        the robot hardly moved since the last one, if it has few returns, or if there is no odometry
        for its stamp.
        """
        odom_from_base = self._odometry_at(stamp_ns)
        if odom_from_base is None or self._odom_from_base is None:
            return False
        if not (math.isfinite(angle_min_rad) and math.isfinite(angle_increment_rad)):
            return False
        points_m = _beam_ends(
            ranges_m, angle_min_rad, angle_increment_rad, range_min_m, range_max_m, base_from_scan
        )
        used = self._is_due(self._last_scan, stamp_ns, odom_from_base)
        if used:
            self._last_scan = (stamp_ns, odom_from_base)
            self._predict(stamp_ns, odom_from_base)
        if len(points_m) < self._params.min_returns:
            # On open floor there is only odometry, and the spread grows step by step.
            return False
        # The scan may be older than the last update, or newer.
        points_m = _transformed(self._odom_from_base.inverse() @ odom_from_base, points_m)
        if used:
            stride = -(-len(points_m) // self._params.max_beams)
            self._weigh(
                pf.scan_log_weights(
                    self._field, self._particles, points_m[::stride], self._params.beam_weight
                )
            )
        self._judge(points_m)
        return used

    def marker(
        self,
        stamp_ns: int,
        map_from_marker: Array,
        candidates: Sequence[MarkerCandidate],
        base_from_camera_optical: Array,
    ) -> bool:
        """Correct the pose by a sighting of a marker whose pose, rigid (4, 4), is known.

        The candidates are the solutions of one sighting, of which at most one is right: the filter
        uses them as a mixture, with a probability that none is right. If the scans have not matched
        the map lately and the marker contradicts the pose too, particles are injected at the poses
        that the marker gives. True if the sighting was used; one of a robot at rest is left out as
        a scan is.
        """
        odom_from_base = self._odometry_at(stamp_ns)
        if odom_from_base is None or self._odom_from_base is None:
            return False
        if not np.isfinite(map_from_marker).all():
            return False
        key = tuple(float(value) for value in map_from_marker[:3, 3])
        if not self._is_due(self._last_marker.get(key), stamp_ns, odom_from_base):
            return False
        p = self._params
        seen = sightings(map_from_marker, candidates, base_from_camera_optical, self._marker_noise)
        if not seen:
            return False
        self._last_marker[key] = (stamp_ns, odom_from_base)
        self._predict(stamp_ns, odom_from_base)
        # The sighting may be older than the last update.
        now_from_then = self._odom_from_base.inverse() @ odom_from_base
        likelihood = mixture_likelihood(self._particles, map_from_marker, seen, now_from_then)
        lost = 1.0 - self._match_fast / max(self._match_slow, 1e-6)
        expected = float(np.sum(pf.normalised(self._log_weights) * likelihood))
        if lost > _INJECT_ABOVE and expected < p.marker_outlier:
            self._inject(seen, now_from_then, min(lost, _INJECT_AT_MOST))
            return True
        self._weigh(portable_kernels.log_each(likelihood + p.marker_outlier))
        return True

    def pose(self) -> tuple[SE2, Array]:
        """map_from_base at the latest odometry and its (3, 3) covariance of (x, y, yaw).

        Raises RuntimeError before `initialize`.
        """
        pose = self.map_from_base()
        if self._odom_from_base is None:
            return pose, self._covariance.copy()
        before_from_now = self._odom_from_base.inverse() @ self._history[-1][1]
        return pose, self._moved_covariance(before_from_now) + self._raster_covariance

    def map_from_base(self) -> SE2:
        """The pose alone. Raises RuntimeError before `initialize`."""
        if self._map_from_base is None:
            raise RuntimeError("the pose is not known: no initial pose was given")
        if self._odom_from_base is None:
            return self._map_from_base
        before_from_now = self._odom_from_base.inverse() @ self._history[-1][1]
        return self._map_from_base @ before_from_now

    def map_from_odom(self) -> SE2:
        """The correction of odometry. Raises RuntimeError before `initialize`."""
        if self._map_from_base is None:
            raise RuntimeError("map from odom is not known: no initial pose was given")
        if self._odom_from_base is None:
            return self._map_from_base
        return self._map_from_base @ self._odom_from_base.inverse()

    def particles(self) -> Array:
        """(n, 3) particles (x, y, yaw) in the map at the last update."""
        return self._particles.copy()

    def _odometry_at(self, stamp_ns: int) -> SE2 | None:
        # Interpolated, or extrapolated shortly after the last sample; None outside.
        if not self._history or stamp_ns < self._history[0][0]:
            return None
        after = bisect_right(self._history, stamp_ns, key=lambda entry: entry[0])
        if after == len(self._history):
            if stamp_ns - self._history[-1][0] > _EXTRAPOLATE_NS:
                return None
            if len(self._history) == 1:
                return self._history[-1][1]
            after -= 1
        (t0, pose0), (t1, pose1) = self._history[after - 1], self._history[after]
        ratio = (stamp_ns - t0) / (t1 - t0)
        return SE2(
            pose0.x_m + ratio * (pose1.x_m - pose0.x_m),
            pose0.y_m + ratio * (pose1.y_m - pose0.y_m),
            wrap_angle(pose0.yaw_rad + ratio * wrap_angle(pose1.yaw_rad - pose0.yaw_rad)),
        )

    def _is_due(self, last: tuple[int, SE2] | None, stamp_ns: int, odom_from_base: SE2) -> bool:
        # At rest the same errors repeat: using each would make the estimate overconfident.
        if last is None:
            return True
        if stamp_ns <= last[0]:
            return False
        turned = abs(wrap_angle(odom_from_base.yaw_rad - last[1].yaw_rad))
        return (
            not self._settled
            or odom_from_base.distance_m(last[1]) >= self._params.update_min_d
            or turned >= self._params.update_min_a
            or stamp_ns - last[0] >= self._params.still_update_period_s * 1e9
        )

    def _predict(self, stamp_ns: int, odom_from_base: SE2) -> None:
        assert self._stamp_ns is not None
        assert self._odom_from_base is not None
        assert self._map_from_base is not None
        if stamp_ns <= self._stamp_ns:
            return
        before_from_now = self._odom_from_base.inverse() @ odom_from_base
        motion = pf.odometry_motion(before_from_now, self._noise)
        pf.move_particles(
            self._particles,
            motion,
            portable_kernels.standard_normal(self._rng, self._particles.shape),
        )
        self._covariance = self._moved_covariance(before_from_now)
        self._map_from_base = self._map_from_base @ before_from_now
        self._stamp_ns, self._odom_from_base = stamp_ns, odom_from_base

    def _moved_covariance(self, before_from_now: SE2) -> Array:
        # First-order propagation of the estimate's covariance through the motion of table 5.6.
        assert self._map_from_base is not None
        motion = pf.odometry_motion(before_from_now, self._noise)
        heading = self._map_from_base.yaw_rad + motion.rotation1_rad
        c, s = portable_kernels.cos_sin(heading)
        x_by_yaw, y_by_yaw = -s * motion.translation_m, c * motion.translation_m
        moved = (
            PlanarCovariance.from_matrix(self._covariance)
            .moved(x_by_yaw, y_by_yaw)
            .spread(portable.square(motion.rotation1_std_rad), x_by_yaw, y_by_yaw, 1.0)
            .spread(portable.square(motion.translation_std_m), c, s, 0.0)
            .spread(portable.square(motion.rotation2_std_rad), 0.0, 0.0, 1.0)
        )
        return moved.matrix()

    def _weigh(self, log_likelihood: Array) -> None:
        # If the particles are too sparse for a sharp measurement, one of them would take all the
        # weight, and others near the true pose would be lost: then the measurement is applied in
        # part only, and later ones do the rest.
        needed = self._params.tempering_share * len(self._particles)
        part = 1.0
        weights = pf.normalised(self._log_weights + log_likelihood)
        while pf.effective_sample_size(weights) < needed and part > _LEAST_PART:
            part *= 0.5
            weights = pf.normalised(self._log_weights + part * log_likelihood)
        self._estimate_and_resample(weights)

    def _estimate_and_resample(self, weights: Array) -> None:
        p = self._params
        mean, covariance = pf.mean_and_covariance(self._particles, weights)
        self._converged = self._is_narrow(covariance)
        if not self._converged:
            cluster = pf.heaviest_cluster(self._particles, weights, _CLUSTER_M, _CLUSTER_RAD)
            share = float(weights[cluster].sum())
            mean, covariance = pf.mean_and_covariance(
                self._particles[cluster], weights[cluster] / share
            )
        self._settled = self._converged and self._is_narrow(
            covariance / portable.square(p.settled_ratio)
        )
        self._covariance = covariance
        self._map_from_base = mean
        if pf.effective_sample_size(weights) < p.resample_share * len(weights):
            self._resample(weights)
        else:
            self._log_weights = portable_kernels.log_each(np.maximum(weights, 1e-300))

    def _resample(self, weights: Array) -> None:
        p = self._params
        offset = float(self._rng.random())
        kept = self._particles[pf.low_variance_resample(weights, offset, len(weights))]
        count = pf.kld_sample_size(kept, _KLD_BIN_M, _KLD_BIN_RAD, p.pf_err, p.pf_z)
        count = min(max(count, p.min_particles), p.max_particles)
        kept = self._particles[pf.low_variance_resample(weights, offset, count)]
        # Copies would stay identical while the robot rests, and few might be near the true pose.
        spread = np.array([p.roughening_m, p.roughening_m, p.roughening_rad])
        spread = np.sqrt(
            portable.square(spread)
            + portable.square(p.roughening_ratio) * np.diag(self._covariance)
        )
        kept += portable_kernels.standard_normal(self._rng, kept.shape) * spread
        kept[:, 2] = _wrapped(kept[:, 2])
        self._particles = kept
        self._log_weights = np.zeros(count)

    def _is_narrow(self, covariance: Array) -> bool:
        x_x, x_y, _, y_y, _, yaw_yaw = PlanarCovariance.from_matrix(covariance)
        largest_m2 = (x_x + y_y) / 2.0 + math.hypot((x_x - y_y) / 2.0, x_y)
        return largest_m2 <= portable.square(
            self._params.converged_std_m
        ) and yaw_yaw <= portable.square(self._params.converged_std_rad)

    def _judge(self, points_m: Array) -> None:
        # Keeps the long and the short mean of augmented MCL (Probabilistic Robotics, table 8.3).
        assert self._map_from_base is not None
        p = self._params
        fraction = pf.fraction_near_walls(
            self._field, self._map_from_base, points_m, p.scan_match_tolerance_m
        )
        self._match_slow += p.recovery_alpha_slow * (fraction - self._match_slow)
        self._match_fast += p.recovery_alpha_fast * (fraction - self._match_fast)

    def _inject(self, seen: Sequence[Sighting], now_from_then: SE2, share: float) -> None:
        # The next scans decide which of the old and the new particles are right.
        weights = pf.normalised(self._log_weights)
        count = self._params.max_particles
        injected = round(share * count)
        offset = float(self._rng.random())
        groups = [self._particles[pf.low_variance_resample(weights, offset, count - injected)]]
        then_from_now = now_from_then.inverse()
        for i, sighting in enumerate(seen):
            part = injected * (i + 1) // len(seen) - injected * i // len(seen)
            here = np.array(sighting.map_from_base @ then_from_now)
            groups.append(
                here
                + portable_kernels.standard_normal(self._rng, (part, 3)) * np.array(_INJECT_STD)
            )
        self._particles = np.ascontiguousarray(np.concatenate(groups))
        self._particles[:, 2] = _wrapped(self._particles[:, 2])
        self._log_weights = np.zeros(len(self._particles))
        self._converged = self._settled = False


def _wrapped(angles_rad: Array) -> Array:
    return np.asarray((angles_rad + math.pi) % (2.0 * math.pi) - math.pi)


def _transformed(a_from_b: SE2, b_points_m: Array) -> Array:
    c, s = portable_kernels.cos_sin(a_from_b.yaw_rad)
    x_m = a_from_b.x_m + c * b_points_m[:, 0] - s * b_points_m[:, 1]
    y_m = a_from_b.y_m + s * b_points_m[:, 0] + c * b_points_m[:, 1]
    return np.ascontiguousarray(np.stack([x_m, y_m], axis=1))


def _beam_ends(
    ranges_m: NDArray[np.float32],
    angle_min_rad: float,
    angle_increment_rad: float,
    range_min_m: float,
    range_max_m: float,
    base_from_scan: SE2,
) -> Array:
    distances_m = np.asarray(ranges_m, np.float64)
    # Infinity is outside the limits, and NaN compares false.
    valid = (distances_m >= range_min_m) & (distances_m < min(range_max_m, _FAR_M))
    angles = angle_min_rad + angle_increment_rad * np.flatnonzero(valid)
    hits_m = distances_m[valid]
    cos, sin = portable_kernels.cos_sin_each(angles)
    return _transformed(base_from_scan, np.stack([hits_m * cos, hits_m * sin], axis=1))

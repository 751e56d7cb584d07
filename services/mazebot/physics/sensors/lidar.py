"""A planar lidar by ray casting against all solids."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SCAN_FRAME, Array, inverse_matrix
from mazebot.common.messages import messages as msg
from mazebot.physics.bodies.bodies import Bodies
from mazebot.physics.bodies.collision import Solid
from mazebot.physics.config import PhysicsConfig
from mazebot.physics.sensors.raycast import (
    RayTargets,
    cast_scan,
    joined,
    ray_directions,
    targets_of,
)


@dataclass(frozen=True)
class LidarFigures:
    """Rate, range and noise of a lidar."""

    samples: int
    rate_hz: float
    range_min_m: float
    range_max_m: float
    noise_m: float
    """Standard deviation of a range, at least"""
    noise_share: float
    """Standard deviation of a range as a share of it, where that is more"""
    resolution_m: float
    """Ranges are whole multiples of it; 0: not rounded"""
    dropout: float = 0.0
    """Share of the rays that are lost"""


def lidar_figures(config: PhysicsConfig) -> LidarFigures:
    """The lidar figures of a configuration."""
    return LidarFigures(
        config.scan_samples,
        config.scan_rate_hz,
        config.scan_range_min_m,
        config.scan_range_max_m,
        config.scan_noise_m,
        config.scan_noise_share,
        config.scan_resolution_m,
        config.scan_dropout,
    )


class Lidar:
    """A full turn at one instant. Ray 0 points straight ahead, the others follow counter-clockwise.

    As in REP 117 a range is inf where there is no echo up to the longest range, and -inf where
    something is nearer than the shortest. All other ranges have Gaussian noise and stay within the
    two limits. Without noise and rounding they are exact to the precision of a float32. Rays hit
    neither the robot nor the floor. A lost ray is inf, since the sensor cannot tell it from one
    without an echo.
    """

    def __init__(
        self,
        bodies: Bodies,
        footprint_from_scan: Array,
        figures: LidarFigures,
        random: np.random.Generator,
    ) -> None:
        self._bodies = bodies
        self._footprint_from_scan = footprint_from_scan
        self._figures = figures
        self._random = random
        self._directions = ray_directions(figures.samples)
        self._increment_rad = 2.0 * math.pi / figures.samples
        self._groups: tuple[tuple[Solid, ...], ...] = ()
        self._targets_of: dict[tuple[Solid, ...], RayTargets] = {}
        self._targets = joined(())

    def read(self, stamp_ns: int) -> msg.LaserScan:
        """The scan now."""
        figures = self._figures
        true_m = self._true_ranges_m()
        echo = true_m < np.inf
        # Noise is drawn for every ray, so that the stream does not depend on what is hit.
        noise = portable_kernels.standard_normal(self._random, len(true_m))
        measured_m = true_m[echo]
        sigma_m = np.maximum(figures.noise_m, figures.noise_share * measured_m)
        near = measured_m < figures.range_min_m
        measured_m += sigma_m * noise[echo]
        if figures.resolution_m > 0.0:
            measured_m = np.round(measured_m / figures.resolution_m) * figures.resolution_m
        measured_m = np.clip(measured_m, figures.range_min_m, figures.range_max_m)
        measured_m[near] = -np.inf
        true_m[echo] = measured_m
        if figures.dropout > 0.0:
            true_m[self._random.random(len(true_m)) < figures.dropout] = np.inf
        return msg.LaserScan(
            header=msg.header(stamp_ns, SCAN_FRAME),
            angle_min=0.0,
            angle_max=msg.float32(self._increment_rad * (figures.samples - 1)),
            angle_increment=msg.float32(self._increment_rad),
            time_increment=0.0,
            scan_time=msg.float32(1.0 / figures.rate_hz),
            range_min=msg.float32(figures.range_min_m),
            range_max=msg.float32(figures.range_max_m),
            ranges=true_m.astype(np.float32),
            intensities=np.zeros(0, np.float32),
        )

    def _true_ranges_m(self) -> Array:
        bodies = self._bodies
        if bodies.solid_groups is not self._groups:
            self._groups = bodies.solid_groups
            made = self._targets_of
            # A group that is still there is not prepared again; it is found by its identity.
            self._targets_of = {
                group: made[group] if group in made else targets_of(group) for group in self._groups
            }
            self._targets = joined(
                (self._targets_of[group], index) for index, group in enumerate(self._groups)
            )
        scan_from_map = inverse_matrix(
            portable.product(bodies.map_from_footprint(), self._footprint_from_scan)
        )
        scan_from_groups = portable.product(scan_from_map, bodies.map_from_groups())
        return cast_scan(
            self._targets, scan_from_groups, self._directions, self._figures.range_max_m
        )

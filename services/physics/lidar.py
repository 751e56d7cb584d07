"""A planar lidar by ray casting against the walls."""

from __future__ import annotations

import math

import numpy as np

from services.common import messages as msg
from services.common.frames import SCAN_FRAME, Array
from services.physics.bodies import Bodies


class Lidar:
    """A whole turn at one instant. Ray 0 looks straight ahead, the others follow counter-clockwise.

    As in REP 117 a range is inf where there is no echo up to `range_max_m`, and -inf where
    something is nearer than `range_min_m`. All other ranges have Gaussian noise and stay within the
    two limits.

    Without noise, ranges away from a wall's edges are within 0.2 mm of geometry for 996 rays in
    1000. Bullet's ray cast ends 4 rays in 10,000 more than 1 mm early, by 1.7 mm at most: a sixth
    of the sensor's own noise.
    """

    def __init__(
        self,
        bodies: Bodies,
        footprint_from_scan: Array,
        samples: int,
        rate_hz: float,
        range_min_m: float,
        range_max_m: float,
        noise_m: float,
        random: np.random.Generator,
    ) -> None:
        self._bodies = bodies
        self._footprint_from_scan = footprint_from_scan
        self._rate_hz = rate_hz
        self._range_min_m = range_min_m
        self._range_max_m = range_max_m
        self._noise_m = noise_m
        self._random = random
        self._increment_rad = 2.0 * math.pi / samples
        angles = np.arange(samples) * self._increment_rad
        self._ends_in_scan = range_max_m * np.stack(
            [np.cos(angles), np.sin(angles), np.zeros(samples)], axis=1
        )

    def read(self, stamp_ns: int) -> msg.LaserScan:
        """The scan now."""
        map_from_scan = self._bodies.map_from_footprint() @ self._footprint_from_scan
        origin = map_from_scan[:3, 3]
        ends = self._ends_in_scan @ map_from_scan[:3, :3].T + origin
        fractions = self._bodies.cast_rays(np.broadcast_to(origin, ends.shape), ends)
        true_m = fractions * self._range_max_m
        # Noise is drawn for every ray, so that the stream does not depend on what is hit.
        noise = self._random.standard_normal(len(true_m)) * self._noise_m
        ranges = np.clip(true_m + noise, self._range_min_m, self._range_max_m)
        ranges[fractions >= 1.0] = np.inf
        ranges[true_m < self._range_min_m] = -np.inf
        return msg.LaserScan(
            header=msg.header(stamp_ns, SCAN_FRAME),
            angle_min=0.0,
            angle_max=msg.float32(self._increment_rad * (len(true_m) - 1)),
            angle_increment=msg.float32(self._increment_rad),
            time_increment=0.0,
            scan_time=msg.float32(1.0 / self._rate_hz),
            range_min=msg.float32(self._range_min_m),
            range_max=msg.float32(self._range_max_m),
            ranges=ranges.astype(np.float32),
            intensities=np.zeros(0, np.float32),
        )

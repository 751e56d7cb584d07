"""Localisation on a log: the pose at each scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mazebot.cli.logs.log import Log
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, Array

if TYPE_CHECKING:
    from mazebot.common.world.map_files import MapFile
    from mazebot.localization.monte_carlo import Localization

HEADER = "time_s,state,quality,x_m,y_m,yaw_rad,std_x_m,std_y_m,std_yaw_rad"
_START_STD = (0.2, 0.2, 0.2)


@dataclass(frozen=True)
class Fix:
    """The pose at one scan."""

    time_s: float
    state: str
    quality: float
    pose: SE2 | None
    covariance: Array | None
    """(3, 3) of x, y, yaw"""

    def row(self) -> str:
        """As CSV."""
        begin = f"{self.time_s:.3f},{self.state},{self.quality:.3f}"
        if self.pose is None or self.covariance is None:
            return f"{begin},,,,,,"
        std = np.sqrt(np.diag(self.covariance))
        values = ",".join(f"{value:.4f}" for value in (*self.pose, *std))
        return f"{begin},{values}"

    def document(self) -> dict[str, Any]:
        """For JSON."""
        known = self.pose is not None and self.covariance is not None
        return {
            "time_s": self.time_s,
            "state": self.state,
            "quality": self.quality,
            "pose": list(self.pose) if known and self.pose else None,
            "covariance": self.covariance.tolist() if self.covariance is not None else None,
        }


@dataclass
class Fixes:
    """The pose at each scan of a log, and the scans of which none can be told."""

    found: list[Fix]
    without_odometry: int = 0
    """Scans with no odometry at their time: before it begins, after it ends, or in a gap."""


def run(
    chart: MapFile, log: Log, start: SE2 | None, base_from_scan: SE2 | None, seed: int
) -> Fixes:
    """Localise on a log. None as `start`: from nothing.

    Raises ConfigError if the map cannot be used.
    """
    from mazebot.localization.monte_carlo import (  # noqa: PLC0415 - loads Numba
        Localization,
        LocalizationParams,
    )

    rng = np.random.default_rng(seed)
    try:
        localization = Localization(
            LocalizationParams(), chart.cells, chart.resolution_m, chart.origin, rng
        )
    except ValueError as error:
        raise ConfigError(f"--map: {error}") from error
    if start is None:
        localization.global_localization()
    else:
        std = np.array(_START_STD)
        localization.initialize(start, np.diag(std * std))
    fixes = Fixes([])
    for step in log.steps():
        if step.odom_from_base is not None:
            localization.odometry(step.stamp_ns, step.odom_from_base)
        if step.scan is None:
            continue
        if not localization.has_odometry(step.stamp_ns):
            fixes.without_odometry += 1
            continue
        localization.scan(step.scan.at(base_from_scan, step.stamp_ns))
        fixes.found.append(_fix(step.stamp_ns, localization))
    return fixes


def _fix(stamp_ns: int, localization: Localization) -> Fix:
    pose, covariance = localization.pose(stamp_ns) if localization.initialized else (None, None)
    return Fix(stamp_ns * 1e-9, localization.state, localization.quality, pose, covariance)

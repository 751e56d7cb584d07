"""Whether odometry's ways are as long as the scans of a log show."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mazebot.cli.logs.log import Log, LoggedScan, interpolated
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, Array

if TYPE_CHECKING:
    from mazebot.mapping.matching.local_map import LocalMap

_LEAST_RATIO, _MOST_RATIO = 0.75, 1.3
"""Of ways by the scans to those by odometry, where nothing is wrong: wheels slip, tyres wear."""
_MOST_STARTS, _LEAST_PAIRS = 60, 5
_LEAST_WAY_M, _MOST_WAY_M = 0.4, 1.5
"""By the scans, between two of them that are compared: far enough to be measured well."""
_MOST_TURN_RAD, _MOST_TIME_S = 0.5, 10.0
_WINDOW_RAD, _STEP_RAD = 0.15, 0.02
"""Around odometry's turn."""
_MOVES = 0.3
"""A step of more than this share of the longest tenth is one of a robot that drives."""
_STOOD = 1e-4
"""Of the way by the scans: odometry of a shorter one stood still."""
_CELL_M, _SMEAR_M, _STD_M = 0.05, 0.07, 0.03
_SPACING_M, _MOST_RETURNS, _MOST_SEARCHED = 0.02, 360, 120
_LEAST_RETURNS = 30
_MOST_RANGE_M = 15.0
"""Beyond it, returns of neighbouring beams lie too far apart."""
_GOOD_FIT = 0.7
_SURE_STD_M = 0.15
"""A way that is less certain than this is none: along a corridor, all fit."""
_CONTRADICTED = 0.15
"""So much less fits where odometry has the robot: else odometry may be right."""
_ALIKE, _MOSTLY = 0.25, 0.7
"""A wrong unit is the same in all pairs: the ratio of most is so near to the median's."""
_UNITS_M = {"centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254, "feet": 0.3048}
_NEAR = 0.08
"""A ratio is that of a unit if it differs by less."""
_LOOSE, _TIGHT = np.diag([1e-3, 1e-3, 1.0]), np.diag([1e12, 1e12, 1e12])
"""Information of a prediction that any scan corrects, and of one that none does."""


def check_scale(
    log_file: object, log: Log, base_from_scan: SE2 | None, odom_scale: float = 1.0
) -> None:
    """Raises ConfigError with one line where the ways by odometry are far longer or shorter than
    neighbouring scans show.

    `base_from_scan` is where the caller says that the lidar is; None: where the log says. The log's
    odometry was multiplied by `odom_scale`.
    """
    ratio = way_ratio(log, base_from_scan)
    if ratio is None:
        return
    metres = ratio * odom_scale
    unit, metres = next(
        (
            (f"is in {name}, ", of_unit)
            for name, of_unit in _UNITS_M.items()
            if abs(metres / of_unit - 1.0) < _NEAR
        ),
        ("", metres),
    )
    raise ConfigError(
        f"--log: {log_file}: odometry's way is {1.0 / ratio:.3g} times as long as the scans show: "
        f"{unit}must be metres: --odom-scale {metres:.3g} makes it so"
    )


def way_ratio(log: Log, base_from_scan: SE2 | None) -> float | None:
    """The way by the scans as a multiple of that by odometry; None: about 1, or the log does not
    tell.
    """
    ratios = np.array(list(_ratios(log, base_from_scan)))
    if len(ratios) < _LEAST_PAIRS:
        return None
    median = float(np.median(ratios))
    is_common = (np.abs(ratios / median - 1.0) < _ALIKE).mean() >= _MOSTLY
    return None if _LEAST_RATIO <= median <= _MOST_RATIO or not is_common else median


def _ratios(log: Log, base_from_scan: SE2 | None) -> Iterator[float]:
    """Of pairs of scans of a lidar: the way by them as a multiple of odometry's; 1 where they fit
    as well by odometry.
    """
    odometry = log.odometry()
    if not len(odometry):
        return
    for scans in log.scans_by_lidar().values():
        times_s = np.array([time_s for time_s, _ in scans])
        poses = interpolated(odometry, times_s)
        # Between two poses of odometry, nothing was measured.
        measured = np.searchsorted(odometry[:, 0], times_s, side="right")
        for first in _starts(poses):
            pair = _pair(scans, poses, first, base_from_scan)
            if pair is not None and measured[pair.second] > measured[first]:
                yield pair.ratio


def _starts(poses: Array) -> list[int]:
    """Indices of poses (n, 3), whatever their unit, at which a robot drives, evenly."""
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    driven = np.flatnonzero(steps > _MOVES * np.quantile(steps, 0.9)) if len(steps) else steps
    return [int(i) for i in driven[:: max(1, len(driven) // _MOST_STARTS)]]


class _Pair(NamedTuple):
    """Two scans that are far enough apart."""

    second: int
    """Index of the later one."""
    ratio: float


def _pair(
    scans: list[tuple[float, LoggedScan]], poses: Array, first: int, base_from_scan: SE2 | None
) -> _Pair | None:
    """This scan and one that is far enough away by the scans; None: there is none, or they do
    not tell.
    """
    from mazebot.mapping.matching.local_map import local_map  # noqa: PLC0415 - loads Numba
    from mazebot.mapping.matching.scan_points import surface_cloud  # noqa: PLC0415

    returns, sensor = _returns(scans[first][1], base_from_scan)
    if len(returns) < _LEAST_RETURNS:
        return None
    local = local_map([SE2(0.0, 0.0, 0.0)], [surface_cloud(returns, sensor)], _CELL_M)
    ahead = 1
    while first + ahead < len(scans) and scans[first + ahead][0] - scans[first][0] < _MOST_TIME_S:
        by_odometry = SE2(*poses[first]).inverse() @ SE2(*poses[first + ahead])
        if abs(by_odometry.yaw_rad) > _MOST_TURN_RAD:
            return None
        way = _way(local, *_returns(scans[first + ahead][1], base_from_scan), by_odometry)
        if way is None:
            return None
        way_m, is_contradicted = way
        if way_m >= _LEAST_WAY_M:
            odometry_m = math.hypot(by_odometry.x_m, by_odometry.y_m)
            if odometry_m < _STOOD * way_m:
                return None
            return _Pair(first + ahead, way_m / odometry_m if is_contradicted else 1.0)
        ahead *= 2
    return None


def _returns(scan: LoggedScan, base_from_scan: SE2 | None) -> tuple[Array, SE2]:
    """(n, 2) in the base's frame, and where the lidar is in it."""
    from mazebot.mapping.matching.scan_points import scan_points, thinned  # noqa: PLC0415

    seen = scan_points(scan.at(base_from_scan, 0), _MOST_RANGE_M)
    return thinned(seen.points_m, _SPACING_M, _MOST_RETURNS), seen.sensor


def _way(
    local: LocalMap, returns: Array, sensor: SE2, by_odometry: SE2
) -> tuple[float, bool] | None:
    """How far the base has moved by the scans, and whether that contradicts odometry; None: the
    scans do not tell.
    """
    from mazebot.mapping.matching.correlative import correlate  # noqa: PLC0415
    from mazebot.mapping.matching.refine import refine  # noqa: PLC0415
    from mazebot.mapping.matching.scan_points import thinned  # noqa: PLC0415

    if len(returns) < _LEAST_RETURNS:
        return None
    found = correlate(
        local, SE2(0.0, 0.0, by_odometry.yaw_rad), thinned(returns, _CELL_M, _MOST_SEARCHED),
        _MOST_WAY_M, _WINDOW_RAD, _STEP_RAD, _SMEAR_M,
    )  # fmt: skip
    spread_m = math.sqrt(float(np.linalg.eigvalsh(found.covariance[:2, :2])[-1]))
    there, by_scans = (
        refine(local, pose, information, returns, sensor, _STD_M)
        for pose, information in ((by_odometry, _TIGHT), (found.map_from_base, _LOOSE))
    )
    if spread_m > _SURE_STD_M or by_scans.open_direction or by_scans.fit < _GOOD_FIT:
        return None
    way_m = math.hypot(by_scans.map_from_base.x_m, by_scans.map_from_base.y_m)
    return way_m, there.fit < by_scans.fit - _CONTRADICTED

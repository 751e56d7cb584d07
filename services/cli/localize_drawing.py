"""A picture of localisation on a log: the map, the trajectory by its state, and 95 % ellipses."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from services.common.config import ConfigError
from services.common.frames import SE2, Array

if TYPE_CHECKING:
    from services.cli.localize_run import Fix
    from services.common.world.map_files import MapFile

_LONGEST_PX = 1600
_COLOURS = {
    "localized": (60, 140, 20),
    "searching": (20, 130, 240),
    "lost": (40, 40, 210),
    "uninitialized": (150, 150, 150),
}
"""Blue, green, red."""
_ELLIPSE = (200, 120, 40)
_CHI2_95 = 5.991
"""95 % of chi squared with two degrees of freedom."""
_ELLIPSES = 40


def draw_fixes(path: Path, chart: MapFile, fixes: Sequence[Fix]) -> None:
    """Write a PNG.

    Raises ConfigError where it cannot be written.
    """
    picture, scale = _floor(chart)
    grid_from_map = chart.origin.inverse()
    rows = chart.cells.shape[0] * scale

    def pixel(x_m: float, y_m: float) -> tuple[int, int]:
        at = grid_from_map @ SE2(x_m, y_m, 0.0)
        per_m = scale / chart.resolution_m
        return round(at.x_m * per_m), round(rows - at.y_m * per_m)

    known = [fix for fix in fixes if fix.pose is not None]
    for before, after in itertools.pairwise(known):
        assert before.pose is not None
        assert after.pose is not None
        # The likeliest of several poses jumps: it is no way that was driven.
        if before.pose.distance_m(after.pose) < 0.5:
            ends = pixel(*before.pose[:2]), pixel(*after.pose[:2])
            cv2.line(picture, *ends, _COLOURS[after.state], 2, cv2.LINE_AA)
        else:
            cv2.circle(picture, pixel(*after.pose[:2]), 3, _COLOURS[after.state], 1, cv2.LINE_AA)
    for fix in known[:: max(1, len(known) // _ELLIPSES)]:
        assert fix.pose is not None
        assert fix.covariance is not None
        outline = np.array([pixel(x, y) for x, y in _ellipse(fix.pose, fix.covariance)])
        cv2.polylines(picture, [outline.astype(np.int32)], True, _ELLIPSE, 1, cv2.LINE_AA)
    if known:
        _mark_end(picture, known[-1], pixel(*(known[-1].pose or (0.0, 0.0))[:2]))
    done, data = cv2.imencode(".png", picture)
    try:
        if not done:
            raise OSError(0, "cannot be drawn")
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise ConfigError(f"--draw: {path}: {error.strerror}") from error


def _floor(chart: MapFile) -> tuple[NDArray[np.uint8], int]:
    """The map in colours, row 0 at the largest y, and its pixels for each cell."""
    scale = max(1, min(8, _LONGEST_PX // max(chart.cells.shape)))
    grey = np.full(chart.cells.shape, 255, np.uint8)
    grey[chart.cells < 0] = 205
    grey[chart.cells >= 50] = 60
    large = np.kron(grey[::-1], np.ones((scale, scale), np.uint8))
    return np.ascontiguousarray(np.repeat(large[:, :, None], 3, axis=2)), scale


def _ellipse(pose: SE2, covariance: Array) -> list[tuple[float, float]]:
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    axes = vectors * np.sqrt(np.maximum(values, 0.0) * _CHI2_95)
    turns = [math.tau * i / 36 for i in range(36)]
    around = np.array([[math.cos(turn), math.sin(turn)] for turn in turns])
    return [(pose.x_m + x, pose.y_m + y) for x, y in (around @ axes.T).tolist()]


def _mark_end(picture: NDArray[np.uint8], fix: Fix, at: tuple[int, int]) -> None:
    assert fix.pose is not None
    tip = (
        round(at[0] + 18 * math.cos(fix.pose.yaw_rad)),
        round(at[1] - 18 * math.sin(fix.pose.yaw_rad)),
    )
    cv2.circle(picture, at, 6, (0, 0, 0), -1, cv2.LINE_AA)
    cv2.arrowedLine(picture, at, tip, (0, 0, 0), 2, cv2.LINE_AA, tipLength=0.4)

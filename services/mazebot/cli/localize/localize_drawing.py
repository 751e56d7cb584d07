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

from mazebot.cli.map_picture import MapPicture
from mazebot.common.maths.frames import SE2, Array

if TYPE_CHECKING:
    from mazebot.cli.localize.localize_run import Fix
    from mazebot.common.world.map_files import MapFile

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
    picture = MapPicture(chart.cells, chart.resolution_m, chart.origin)
    known = [fix for fix in fixes if fix.pose is not None]
    for before, after in itertools.pairwise(known):
        assert before.pose is not None
        assert after.pose is not None
        colour = _COLOURS[after.state]
        # The likeliest of several poses jumps: it is no way that was driven.
        if before.pose.distance_m(after.pose) < 0.5:
            picture.line([before.pose[:2], after.pose[:2]], colour, 2)
        else:
            at = picture.pixel(*after.pose[:2])
            cv2.circle(picture.image, at, 3, colour, 1, cv2.LINE_AA)
    for fix in known[:: max(1, len(known) // _ELLIPSES)]:
        assert fix.pose is not None
        assert fix.covariance is not None
        picture.line(_ellipse(fix.pose, fix.covariance), _ELLIPSE)
    if known:
        assert known[-1].pose is not None
        _mark_end(picture.image, known[-1].pose, picture.pixel(*known[-1].pose[:2]))
    picture.write(path)


def _ellipse(pose: SE2, covariance: Array) -> list[tuple[float, float]]:
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    axes = vectors * np.sqrt(np.maximum(values, 0.0) * _CHI2_95)
    turns = [math.tau * i / 36 for i in range(37)]
    around = np.array([[math.cos(turn), math.sin(turn)] for turn in turns])
    return [(pose.x_m + x, pose.y_m + y) for x, y in (around @ axes.T).tolist()]


def _mark_end(image: NDArray[np.uint8], pose: SE2, at: tuple[int, int]) -> None:
    tip = (
        round(at[0] + 18 * math.cos(pose.yaw_rad)),
        round(at[1] - 18 * math.sin(pose.yaw_rad)),
    )
    cv2.circle(image, at, 6, (0, 0, 0), -1, cv2.LINE_AA)
    cv2.arrowedLine(image, at, tip, (0, 0, 0), 2, cv2.LINE_AA, tipLength=0.4)

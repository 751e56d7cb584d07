"""Checks that a detected marker's modules are truly black and white, against chance finds."""

from __future__ import annotations

import functools
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.perception.corners import Corners
from mazebot.perception.sampling import brightness_at

Bits = NDArray[np.uint8]

_SAMPLES = (0.4, 0.5, 0.6)
"""Where a module is sampled, as shares of its side: its middle, which blur reaches last."""
_RIDGE = 1e-6
"""Keeps the fit solvable for codes whose white modules are too few to show a gradient."""
_DARKEST_SURROUNDINGS = 0.25
"""Share of the way from black to white above which a surrounding module is no part of the black."""
_LIGHT_AROUND = 0.75
"""Share of the surrounding modules in the picture that must be lighter than the black border."""
_ROUNDING = 0.3
"""Standard deviation of the rounding to whole grey levels: the least scatter there is."""


class CodeCheck:
    """Judges detections of one dictionary by how well its code explains the picture."""

    def __init__(self, book: cv2.aruco.Dictionary) -> None:
        """`book` is the dictionary whose detections are judged."""
        self._bytes = np.asarray(book.bytesList)
        self._size = int(book.markerSize)
        self._fit_of = functools.cache(self._make_fit)

    def clarity(self, grey: NDArray[np.uint8], corners: Corners, marker_id: int) -> float:
        """Ratio of the difference between white and black modules to the scatter about them.

        The grey level of a module is modelled as linear in its position, separately for black and
        for white, so that shading and gloss do not count as scatter. A printed code reaches 10 to
        more than 100; random structures that happen to be read as a code stay below 6.

        Args:
            grey: (height, width) picture.
            corners: (4, 2) corners of the black square: top left, top right, bottom right, bottom
                left of the upright marker.
            marker_id: the id that was read.

        Returns:
            The ratio; 0 if the black square has no lighter surroundings, or if the corners are not
            those of a square.
        """
        modules = self._size + 2
        levels = _module_levels(grey, corners, modules)
        if levels is None:
            return 0.0
        inside = levels[1:-1, 1:-1].reshape(-1)
        model, solver = self._fit_of(marker_id)
        fitted = portable.product(solver, inside)
        black, step = float(fitted[0]), float(fitted[3])
        if step <= 0.0:
            return 0.0
        ring = _ring(levels)
        light = ring > black + _DARKEST_SURROUNDINGS * step
        if int(light.sum()) < _LIGHT_AROUND * int(np.isfinite(ring).sum()):
            return 0.0
        residuals = inside - portable.product(model, fitted)
        freedom = max(len(inside) - model.shape[1], 1)
        variance = float(portable.product(residuals, residuals)) / freedom
        return step / math.sqrt(variance + portable.square(_ROUNDING))

    def _make_fit(self, marker_id: int) -> tuple[Array, Array]:
        """(n, 6) model of the modules' grey levels, and the (6, n) matrix that fits it.

        The columns are 1, x, y for black, and the same for what white adds.
        """
        size, modules = self._size, self._size + 2
        rows = self._bytes[marker_id : marker_id + 1]
        white = np.zeros((modules, modules))
        white[1:-1, 1:-1] = cv2.aruco.Dictionary.getBitsFromByteList(rows, size)
        y, x = (place.reshape(-1) - (modules - 1) / 2.0 for place in np.indices(white.shape))
        flat = white.reshape(-1)
        model = np.stack([np.ones_like(flat), x, y, flat, flat * x, flat * y], axis=1)
        normal = portable.product(model.T, model)
        normal[np.diag_indices(6)] += _RIDGE
        return model, portable.product(portable.inverse(normal), model.T)


def _module_levels(grey: NDArray[np.uint8], corners: Corners, modules: int) -> Array | None:
    """(modules + 2, modules + 2) mean grey of the black square's modules and of those around it.

    NaN for modules around it that are not in the picture; None if the corners are no square's.
    """
    places = _sample_places(corners, modules)
    if places is None:
        return None
    x, y = places[..., 0], places[..., 1]
    sampled = brightness_at(grey, x, y)
    height, width = grey.shape
    sampled[(x < -0.5) | (y < -0.5) | (x > width - 0.5) | (y > height - 0.5)] = np.nan
    side, samples = modules + 2, len(_SAMPLES)
    cells = sampled.reshape(side, samples, side, samples)
    # The sum of nine whole numbers is exact in any order.
    levels: Array = cells.sum(axis=(1, 3)) / (samples * samples)
    return levels if np.isfinite(levels[1:-1, 1:-1]).all() else None


def _sample_places(corners: Corners, modules: int) -> Array | None:
    """(3 (modules + 2), 3 (modules + 2), 2) pixels of the modules' samples, by a homography."""
    square = 1.0 + modules * np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    x, y = square.T
    u, v = corners.T
    ones, none = np.ones(4), np.zeros(4)
    equations = np.concatenate(
        [
            np.stack([x, y, ones, none, none, none, -u * x, -u * y], axis=1),
            np.stack([none, none, none, x, y, ones, -v * x, -v * y], axis=1),
        ]
    )
    try:
        entries = portable.solve(equations, np.concatenate([u, v]))
    except np.linalg.LinAlgError:
        return None
    homography = np.append(entries, 1.0).reshape(3, 3)
    along = (np.arange(modules + 2)[:, None] + np.array(_SAMPLES)).reshape(-1)
    rows, columns = np.meshgrid(along, along, indexing="ij")
    points = np.stack([columns, rows, np.ones_like(rows)], axis=2)
    mapped = portable.product(points.reshape(-1, 3), homography.T).reshape(*points.shape)
    if mapped[..., 2].min() <= 1e-9:
        return None
    return np.asarray(mapped[..., :2] / mapped[..., 2:], np.float64)


def _ring(levels: Array) -> Array:
    """The outermost modules; those outside of the picture are NaN."""
    sides = levels[0], levels[-1], levels[1:-1, 0], levels[1:-1, -1]
    return np.concatenate([side.reshape(-1) for side in sides])

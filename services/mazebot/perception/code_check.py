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
_THIN = (0.05, 0.1, 0.15, 0.2, 0.3)
"""Where the surroundings are sampled that may be a thin border, in modules from the black."""
_ROUNDING = 0.3
"""Standard deviation of the rounding to whole grey levels: the least scatter there is."""


class CodeCheck:
    """Judges detections of one dictionary by how well its code explains the picture."""

    def __init__(self, book: cv2.aruco.Dictionary) -> None:
        """`book` is the dictionary whose detections are judged."""
        self._bytes = np.asarray(book.bytesList)
        self._size = int(book.markerSize)
        self._fit_of = functools.cache(self._make_fit)

    def clarity(
        self, grey: NDArray[np.uint8], corners: Corners, marker_id: int, thin: bool = False
    ) -> float:
        """Ratio of the difference between white and black modules to the scatter about them.

        The grey level of a module is modelled as linear in its position, separately for black and
        for white, so that shading and gloss do not count as scatter. A printed code reaches 10 to
        more than 100; random structures that happen to be read as a code stay below 6.

        Args:
            grey: (height, width) picture.
            corners: (4, 2) corners of the black square: top left, top right, bottom right, bottom
                left of the upright marker.
            marker_id: the id that was read.
            thin: whether the light surroundings may be a border thinner than half a module.

        Returns:
            The ratio; 0 if the black square has no lighter surroundings, or if the corners are not
            those of a square.
        """
        modules = self._size + 2
        image_from_modules = _homography(corners, modules)
        if image_from_modules is None:
            return 0.0
        levels = _module_levels(grey, image_from_modules, modules)
        if levels is None:
            return 0.0
        inside = levels[1:-1, 1:-1].reshape(-1)
        model, solver = self._fit_of(marker_id)
        fitted = portable.product(solver, inside)
        black, step = float(fitted[0]), float(fitted[3])
        if step <= 0.0:
            return 0.0
        ring = _thin_ring(grey, image_from_modules, modules) if thin else _ring(levels)
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


def _module_levels(
    grey: NDArray[np.uint8], image_from_modules: Array, modules: int
) -> Array | None:
    """(modules + 2, modules + 2) mean grey of the black square's modules and of those around it.

    NaN for modules around it that are not in the picture; None if the corners are no square's.
    """
    along = (np.arange(modules + 2)[:, None] + np.array(_SAMPLES)).reshape(-1)
    rows, columns = np.meshgrid(along, along, indexing="ij")
    sampled = _brightness(grey, image_from_modules, columns, rows)
    if sampled is None:
        return None
    side, samples = modules + 2, len(_SAMPLES)
    cells = sampled.reshape(side, samples, side, samples)
    # The sum of nine whole numbers is exact in any order.
    levels: Array = cells.sum(axis=(1, 3)) / (samples * samples)
    return levels if np.isfinite(levels[1:-1, 1:-1]).all() else None


def _thin_ring(grey: NDArray[np.uint8], image_from_modules: Array, modules: int) -> Array:
    """The lightest of what lies close around the black square, beside each of its modules."""
    middles = 1.5 + np.arange(modules)
    along, out = np.meshgrid(middles, np.array(_THIN), indexing="ij")
    low, high = 1.0 - out, 1.0 + modules + out
    sides = [
        _brightness(grey, image_from_modules, x, y)
        for x, y in ((along, low), (along, high), (low, along), (high, along))
    ]
    return np.concatenate(
        [np.full(modules, np.nan) if one is None else one.max(1) for one in sides]
    )


def _brightness(
    grey: NDArray[np.uint8], image_from_modules: Array, x: Array, y: Array
) -> Array | None:
    """Grey levels at (n, m) places in modules; NaN outside the picture, None where there is no
    place in any picture.
    """
    points = np.stack([x, y, np.ones_like(x)], axis=2)
    mapped = portable.product(points.reshape(-1, 3), image_from_modules.T).reshape(*points.shape)
    if mapped[..., 2].min() <= 1e-9:
        return None
    u, v = mapped[..., 0] / mapped[..., 2], mapped[..., 1] / mapped[..., 2]
    sampled = brightness_at(grey, u, v)
    height, width = grey.shape
    sampled[(u < -0.5) | (v < -0.5) | (u > width - 0.5) | (v > height - 0.5)] = np.nan
    return sampled


def _homography(corners: Corners, modules: int) -> Array | None:
    """(3, 3) pixels from modules, of which one surrounds the black square; None: there is none."""
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
    return np.append(entries, 1.0).reshape(3, 3)


def _ring(levels: Array) -> Array:
    """The outermost modules; those outside of the picture are NaN."""
    sides = levels[0], levels[-1], levels[1:-1, 0], levels[1:-1, -1]
    return np.concatenate([side.reshape(-1) for side in sides])

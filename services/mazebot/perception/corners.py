"""Subpixel corners of a marker's black square, from the edges between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.perception.sampling import brightness_at

Corners = NDArray[np.float64]

MODULES = 6
"""Modules along a side of a 4x4 marker's black square, border included."""

_SAMPLES = 16
_STEP_PX = 0.25
_PASSES = 2
_STEPS = 12
"""Steps on each side of an edge, at the least: wide profiles have longer steps than _STEP_PX."""
_MIN_HALF_WIDTH_PX = 1.25
_BESIDE_PX = 1.5
"""So near to an edge there is nothing else."""

HALF_WIDTH_PX = 3.0
"""How far from a side an edge may lie and reach, in a sharp picture."""
_ALONG = np.linspace(0.12, 0.88, _SAMPLES)


# A line of offsets a + b u across the side, from the samples' offsets, by least squares.
def _least_squares(design: Corners) -> Corners:
    """(k, n) matrix that gives the coefficients from n values, for an (n, k) design matrix."""
    return portable.product(portable.inverse(portable.product(design.T, design)), design.T)


_LINE_FROM_OFFSETS = _least_squares(np.stack([np.ones(_SAMPLES), _ALONG], axis=1))


def refine_corners(
    grey: NDArray[np.uint8],
    corners: Corners,
    modules: int = MODULES,
    half_width_px: float = HALF_WIDTH_PX,
) -> Corners:
    """Corners of a marker to about a twentieth of a pixel.

    A straight line is fitted through the black-to-white transitions across each side, and the
    corners are the intersections of the lines. OpenCV's corner refinement, whose result this
    starts from, puts the corners of a convex square about 0.2 px inside the true ones, which is
    3 cm of distance at 4 m.

    Args:
        grey: (height, width) picture.
        corners: (4, 2) corners (x, y) in pixels, within 2 px of the true ones, clockwise in the
            picture.
        modules: modules along a side, border included.
        half_width_px: how far an edge may lie from the given side, and be blurred; the corners move
            no farther than this.

    Returns:
        (4, 2) corners in the same order; the given ones if the edges are not clear.
    """
    refined = corners
    for _ in range(_PASSES):
        lines = _edge_lines(grey, refined, modules, half_width_px)
        if lines is None:
            return corners
        refined = np.array([_meet(lines[side - 1], lines[side]) for side in range(4)])
        if not np.abs(refined - corners).max() <= half_width_px:
            return corners
    return refined


def corners_of_black(
    grey: NDArray[np.uint8],
    corners: Corners,
    modules: int = MODULES,
    half_width_px: float = HALF_WIDTH_PX,
) -> Corners:
    """As `refine_corners`, also from the corners of a thin white border around the black square,
    which OpenCV finds where the border is lighter than what is behind it.
    """
    refined = refine_corners(grey, corners, modules, half_width_px)
    if _is_black_within(grey, refined):
        return refined
    moved = refine_corners(grey, corners, modules, np.inf)
    moved = refine_corners(grey, moved, modules, half_width_px)
    return moved if _is_black_within(grey, moved) else refined


def _is_black_within(grey: NDArray[np.uint8], corners: Corners) -> bool:
    """Whether it is darker on the inside than on the outside of each side."""
    along = np.roll(corners, -1, axis=0) - corners
    lengths_px = portable.hypot_each(along[:, 0], along[:, 1])
    if not lengths_px.min() >= 1.0:
        return False
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / lengths_px[:, None]
    places = corners[:, None] + _ALONG[None, :, None] * along[:, None]
    aside = _BESIDE_PX * outward[:, None]
    (within, outside) = (
        brightness_at(grey, at[..., 0], at[..., 1]) for at in (places - aside, places + aside)
    )
    return bool((np.median(outside - within, axis=1) > 0.0).all())


def _edge_lines(
    grey: NDArray[np.uint8], corners: Corners, modules: int, max_half_width_px: float
) -> NDArray[np.float64] | None:
    """(4, 2, 2) two points on the edge of each side; None if an edge has no contrast."""
    starts, ends = corners, np.roll(corners, -1, axis=0)
    along = ends - starts
    lengths_px = portable.hypot_each(along[:, 0], along[:, 1])
    if lengths_px.min() < 1.0:
        return None
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / lengths_px[:, None]
    # Black and white extend one module inside and outside the edge, and no farther.
    depth_px = np.abs(((np.roll(corners, -2, axis=0) - starts) * outward).sum(axis=1)) / modules
    half_width_px = float(np.clip(0.6 * depth_px.min(), _MIN_HALF_WIDTH_PX, max_half_width_px))
    step_px = max(_STEP_PX, half_width_px / _STEPS)
    across = np.arange(-half_width_px, half_width_px + step_px / 2, step_px)
    base = starts[:, None] + _ALONG[None, :, None] * along[:, None]
    places = base[:, :, None] + across[None, None, :, None] * outward[:, None, None]
    places = places.reshape(4 * _SAMPLES, len(across), 2)
    profile = brightness_at(grey, places[..., 0], places[..., 1])
    rise = np.diff(profile.reshape(4, _SAMPLES, len(across)), axis=2).clip(0.0)
    contrast = rise.sum(axis=2)
    if contrast.min() < 1.0:
        return None
    middle = (across[1:] + across[:-1]) / 2
    offsets = (rise * middle).sum(axis=2) / contrast
    line = portable.product(offsets, _LINE_FROM_OFFSETS.T)
    first = starts + line[:, :1] * outward
    last = ends + line.sum(axis=1, keepdims=True) * outward
    return np.stack([first, last], axis=1)


def _meet(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Intersection of two lines, each through two points; not finite if they are parallel."""
    (p, p_end), (q, q_end) = first, second
    d, e = p_end - p, q_end - q
    cross = d[0] * e[1] - d[1] * e[0]
    if abs(cross) < 1e-9:
        return np.full(2, np.inf)
    meeting: NDArray[np.float64] = p + d * (((q - p)[0] * e[1] - (q - p)[1] * e[0]) / cross)
    return meeting

"""The three wall textures, drawn from noise: `python -m services.worldgen.textures OUT_DIR`.

A tile is about one metre of wall and repeats without a seam: all noise is periodic, and every
distance is measured around the tile's edges. Coordinates run from 0 to 1 over the tile, x to the
right, y down. Pictures are (side, side, 3) float64 RGB in 0..255 until they are written.
"""

from __future__ import annotations

import functools
import logging
import math
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

Picture = NDArray[np.float64]
Field = NDArray[np.float64]

SIDE_PX = 1024
SEED = 7

_log = logging.getLogger("worldgen")


def bricks(side_px: int = SIDE_PX) -> Picture:
    """Running bond of 12 courses of 4 bricks, 240 x 71 mm with joints of 12 mm, in clay red."""
    rng = np.random.default_rng([SEED, 1])
    courses, across = 12, 4
    x, y = _coordinates(side_px)
    # Hand-laid: edges wander by a millimetre or two.
    x = x + 0.0012 * noise(rng, side_px, 24, 24)
    y = y + 0.0012 * noise(rng, side_px, 24, 24)
    row = np.floor(y * courses).astype(int) % courses
    shifted = x * across + 0.5 * (row % 2)
    column = np.floor(shifted).astype(int) % across
    from_left, from_top = shifted % 1.0 / across, (y * courses) % 1.0 / courses
    # Distance in metres to the brick's edge, positive inside it; corners are rounded.
    half_w, half_h, joint, radius = 0.5 / across, 0.5 / courses, 0.006, 0.008
    qx = np.abs(from_left - half_w) - (half_w - joint - radius)
    qy = np.abs(from_top - half_h) - (half_h - joint - radius)
    outside = np.hypot(np.maximum(qx, 0.0), np.maximum(qy, 0.0))
    inside_m = radius - outside - np.minimum(np.maximum(qx, qy), 0.0)
    inside_m += 0.0012 * noise(rng, side_px, 64, 64)
    brick = _step(inside_m, 0.0, 0.0022)

    tones = np.array([[156, 92, 86], [138, 80, 78], [166, 106, 96], [120, 74, 78], [150, 100, 98]])
    kind = rng.choice(len(tones), (courses, across), p=[0.34, 0.26, 0.18, 0.12, 0.10])
    light = rng.normal(1.0, 0.08, (courses, across))
    clay = tones[kind[row, column]] * light[row, column][..., None]
    clouds = 0.09 * noise(rng, side_px, 14, 22, octaves=3)
    grain = 0.045 * noise(rng, side_px, 256, 256, octaves=2)
    pits = _step(noise(rng, side_px, 110, 110), 1.7, 2.6)
    bloom = _step(noise(rng, side_px, 6, 9, octaves=4), 1.0, 2.6)[..., None]
    clay = clay * (1.0 + clouds + grain - 0.35 * pits)[..., None]
    clay = clay + 0.22 * bloom * (np.array([200, 186, 172]) - clay)

    sand = 1.0 + 0.07 * noise(rng, side_px, 200, 200, octaves=2) + 0.05 * noise(rng, side_px, 8, 8)
    mortar = np.array([172, 160, 144]) * sand[..., None]
    # Bricks stand a few millimetres proud of the joints and are lit from above and the left.
    height = _blur(brick, side_px, 0.0016)
    relief = _slope(height, 1, side_px) + 0.7 * _slope(height, 0, side_px)
    shadow = np.clip(np.roll(height, _px(side_px, 0.004), 0) - height, 0.0, 1.0)
    picture = mortar + brick[..., None] * (clay - mortar)
    shade = 1.0 + 0.0022 * np.clip(relief, -90, 90) - 0.38 * shadow
    return _with_mean(picture * shade[..., None], (143, 96, 94))


def concrete(side_px: int = SIDE_PX) -> Picture:
    """Cast concrete: cloudy grey, fine speckle, pores of 1 to 5 mm, stains that have run down."""
    rng = np.random.default_rng([SEED, 2])
    clouds = 7.0 * noise(rng, side_px, 3, 4, octaves=5)
    mottle = 3.6 * noise(rng, side_px, 40, 40, octaves=3)
    speckle = 4.6 * noise(rng, side_px, 300, 300, octaves=2)
    dark_sand = _step(noise(rng, side_px, 240, 240), 1.9, 2.8)
    light_sand = _step(noise(rng, side_px, 240, 240), 1.9, 2.8)
    grey = 161.0 + clouds + mottle + speckle - 30.0 * dark_sand + 20.0 * light_sand

    # Water that ran down leaves long streaks; damp leaves blots.
    runs = _step(noise(rng, side_px, 26, 2, octaves=3) + 0.6 * noise(rng, side_px, 3, 3), 1.0, 3.2)
    blots = _step(noise(rng, side_px, 4, 4, octaves=5), 1.0, 1.9)
    rim = blots * (1.0 - blots) * 4.0
    grey -= 24.0 * runs + 10.0 * blots + 6.0 * rim

    depth = np.zeros((side_px, side_px))
    for _ in range(260):
        at = rng.random(2)
        radius = 0.0009 + 0.0011 * rng.exponential()
        squash = rng.uniform(0.75, 1.3)
        _stamp(depth, at, min(radius, 0.006), squash)
    # A pore is dark under its upper rim and catches the light on its lower one.
    rim_light = np.clip(depth - np.roll(depth, _px(side_px, 0.0016), 0), -1.0, 1.0)
    grey -= 62.0 * depth + 26.0 * np.clip(rim_light, 0.0, 1.0)
    grey += 20.0 * np.clip(-rim_light, 0.0, 1.0) * (1.0 - depth)

    warm = 1.5 * noise(rng, side_px, 5, 5, octaves=3) + 5.0 * runs
    tint = np.stack([warm, 0.55 * warm, -0.8 * warm], axis=-1)
    return _with_mean(grey[..., None] + tint, (161, 159, 156))


def wood(side_px: int = SIDE_PX) -> Picture:
    """Eight upright pine boards of 125 mm, each with its own tone, grain and perhaps a knot."""
    rng = np.random.default_rng([SEED, 3])
    boards = 8
    x, y = _coordinates(side_px)
    board = np.floor(x * boards).astype(int) % boards
    across = (x * boards) % 1.0 - 0.5

    # Rings of a trunk cut lengthwise: wavy lines along y, closer towards one edge of the board.
    sway = noise(rng, side_px, boards, 2, octaves=2)
    warp = noise(rng, side_px, 24, 4, octaves=2)
    heart = rng.uniform(-0.9, 0.9, boards)[board]
    pitch = rng.uniform(5.0, 8.0, boards)[board]
    start = rng.random(boards)[board]
    rings = start + pitch * np.sqrt((across - heart) ** 2 + 0.05) + 0.42 * sway + 0.10 * warp
    # Along a board the pattern of some swells into long arches.
    lift = rng.uniform(0.0, 1.1, boards)[board]
    rings += lift * np.sin(2.0 * math.pi * (y + rng.random(boards)[board]))

    knots = np.zeros_like(x)
    for index in rng.permutation(boards)[:4]:
        at_x, at_y = (index + rng.uniform(0.3, 0.7)) / boards, rng.random()
        radius = rng.uniform(0.008, 0.014)
        dx = _around(x - at_x)
        dy = _around(y - at_y)
        near = np.hypot(dx, dy * 0.62) + 0.0012 * warp
        inside = board == index
        # The grain flows around a knot, which has rings of its own.
        rings += inside * 3.2 * np.exp(-((dx / 0.022) ** 2) - (dy / 0.07) ** 2)
        own = _step(radius - near, -0.002, 0.003) * inside
        rings = rings * (1.0 - own) + own * near * 420.0
        knots = np.maximum(knots, own * (0.55 + 0.45 * _step(near, radius * 0.55, radius)))

    phase = rings % 1.0
    late = _step(phase, 0.25, 0.86) * (1.0 - _step(phase, 0.90, 1.0))
    fibre = noise(rng, side_px, 330, 7, octaves=2)
    streaks = noise(rng, side_px, 90, 3, octaves=2)
    vessels = _step(noise(rng, side_px, 300, 14), 1.7, 2.8)

    tone = rng.normal(0.0, 1.0, boards)[board]
    light = 1.0 + 0.055 * tone + 0.020 * fibre + 0.022 * streaks + 0.02 * noise(rng, side_px, 3, 3)
    early_colour, late_colour = np.array([236, 184, 108]), np.array([196, 126, 52])
    strength = rng.uniform(0.5, 0.95, boards)[board]
    mixed = early_colour + (strength * late)[..., None] * (late_colour - early_colour)
    mixed = mixed * (light - 0.09 * vessels)[..., None]
    mixed = mixed + (0.78 * knots)[..., None] * (np.array([118, 66, 28]) - mixed)

    # Boards meet in a groove with a rounded edge on both sides.
    edge_m = (0.5 - np.abs(across)) / boards + 0.0004 * noise(rng, side_px, 8, 40)
    groove = 1.0 - _step(edge_m, 0.0008, 0.0032)
    bevel = (1.0 - _step(edge_m, 0.002, 0.008)) * np.sign(across)
    shade = (1.0 - 0.72 * groove) * (1.0 - 0.10 * bevel)
    return _with_mean(mixed * shade[..., None], (220, 162, 84))


TEXTURES: dict[str, Callable[[int], Picture]] = {
    "bricks.png": bricks,
    "concrete.png": concrete,
    "wood_.png": wood,
}


def noise(
    rng: np.random.Generator, side_px: int, cells_x: int, cells_y: int, octaves: int = 1
) -> Field:
    """(side, side) smooth noise that repeats at the tile's edges, of mean 0 and deviation 1.

    The coarsest octave has `cells_x` by `cells_y` random values over the tile; each further one has
    twice as many a side and half the strength.
    """
    total = np.zeros((side_px, side_px))
    for octave in range(octaves):
        # Drawn at full size whatever the picture's, so that a smaller picture is of the same tile.
        rows, columns = cells_y * 2**octave, cells_x * 2**octave
        values = rng.standard_normal((rows, columns))
        total += _upsample(values, side_px) / 2**octave
    total -= total.mean()
    return np.asarray(total / total.std(), np.float64)


def _upsample(values: Field, side_px: int) -> Field:
    """(side, side) pixels of (rows, columns) values by periodic Catmull-Rom interpolation."""
    rows, columns = (_interpolation(count, side_px) for count in values.shape)
    return np.asarray((columns @ (rows @ values).T).T, np.float64)


@functools.cache
def _interpolation(count: int, side_px: int) -> sparse.csr_array:
    """(side, count) weights that make pixels along one axis from `count` values around it."""
    at = (np.arange(side_px) + 0.5) / side_px * count
    first = np.floor(at).astype(int)
    t = at - first
    weights = (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )
    columns = np.stack([(first + shift) % count for shift in (-1, 0, 1, 2)], axis=1)
    rows = np.repeat(np.arange(side_px), 4)
    entries = (np.stack(weights, axis=1).ravel(), (rows, columns.ravel()))
    return sparse.csr_array(sparse.coo_array(entries, shape=(side_px, count)))


def _coordinates(side_px: int) -> tuple[Field, Field]:
    at = (np.arange(side_px) + 0.5) / side_px
    x, y = np.meshgrid(at, at)
    return x, y


def _around(distance: Field) -> Field:
    """The shorter way around the tile, in -0.5..0.5."""
    return (distance + 0.5) % 1.0 - 0.5


def _px(side_px: int, length: float) -> int:
    return max(1, round(length * side_px))


def _step(value: Field, low: Field | float, high: Field | float) -> Field:
    """0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t), np.float64)


def _blur(value: Field, side_px: int, sigma: float) -> Field:
    return np.asarray(ndimage.gaussian_filter(value, sigma * side_px, mode="wrap"), np.float64)


def _slope(height: Field, axis: int, side_px: int) -> Field:
    """Rise along an axis over the whole tile's side."""
    return (np.roll(height, -1, axis) - np.roll(height, 1, axis)) * 0.5 * side_px


def _stamp(depth: Field, at: NDArray[np.float64], radius: float, squash: float) -> None:
    """Put a round hole into `depth`, around the tile's edges where it lies across them."""
    side = depth.shape[0]
    reach = math.ceil((radius * 1.5 + 2.0 / side) * side)
    centre = np.floor(at * side).astype(int)
    columns = np.arange(centre[0] - reach, centre[0] + reach + 1)
    rows = np.arange(centre[1] - reach, centre[1] + reach + 1)
    dx = (columns + 0.5) / side - at[0]
    dy = ((rows + 0.5) / side - at[1])[:, None]
    hole = _step(radius - np.hypot(dx * squash, dy / squash), -0.6 / side, 0.9 / side)
    index = np.ix_(rows % side, columns % side)
    depth[index] = np.maximum(depth[index], hole)


def _with_mean(picture: Picture, mean_rgb: tuple[int, int, int]) -> Picture:
    """The picture, each channel scaled until its mean after clipping to 0..255 is the given one."""
    picture = np.clip(picture, 0.0, None)
    for _ in range(4):
        mean = np.clip(picture, 0.0, 255.0).mean((0, 1))
        picture = picture * (np.array(mean_rgb) / mean)
    return np.clip(picture, 0.0, 255.0)


def png_bytes(picture: Picture) -> bytes:
    """The picture as PNG of 8 bits a channel."""
    rgb = np.rint(picture).astype(np.uint8)
    options = [cv2.IMWRITE_PNG_COMPRESSION, 9]
    done, data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), options)
    if not done:
        raise RuntimeError("OpenCV cannot write PNG")
    return bytes(data.tobytes())


def write(folder: Path) -> None:
    """Draw every texture into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in TEXTURES.items():
        data = png_bytes(draw(SIDE_PX))
        (folder / name).write_bytes(data)
        _log.info("%s: %d bytes", folder / name, len(data))


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    if len(sys.argv) != 2:
        sys.exit("usage: python -m services.worldgen.textures OUT_DIR")
    write(Path(sys.argv[1]))

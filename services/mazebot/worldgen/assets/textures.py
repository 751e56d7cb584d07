"""The textures of walls, floors and ceilings, drawn from noise.

`python -m mazebot.worldgen.assets.textures OUT_DIR` writes them. A tile is about one metre of
wall and repeats without a seam: all noise is periodic, and every distance is measured around the
edges. Coordinates run from 0 to 1 over the tile, x to the
right, y down. Images are (side, side, 3) float64 RGB in 0..255 until they are written.
"""

from __future__ import annotations

import functools
import logging
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse, spatial

Picture = NDArray[np.float64]
Field = NDArray[np.float64]

SIDE_PX = 1024
SMALL_SIDE_PX = 512
COARSE_STEP = 4.0
SEED = 7

_log = logging.getLogger("worldgen")


def bricks(side_px: int = SIDE_PX) -> Picture:
    """Running bond of 12 courses of 4 bricks, 240 x 71 mm with joints of 12 mm, in clay red."""
    rng = np.random.default_rng([SEED, 1])
    courses, across = 12, 4
    x, y = _coordinates(side_px)
    # Hand-laid: edges vary by a millimetre or two.
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


def plaster(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Lime plaster in a pale rose, put on with a trowel: broad arcs and soft clouds."""
    rng = np.random.default_rng([SEED, 4])
    x, y = _coordinates(side_px)
    strokes = np.zeros((side_px, side_px))
    for _ in range(40):
        at, radius = rng.random(2), rng.uniform(0.08, 0.22)
        turn, width = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.006, 0.02)
        dx, dy = _around(x - at[0]), _around(y - at[1])
        # A crescent: bright on one side of a ring, and only along a third of it.
        ring = np.exp(-(((np.hypot(dx, dy) - radius) / width) ** 2))
        strokes += ring * _step(np.cos(np.arctan2(dy, dx) - turn), 0.35, 1.0)
    clouds = noise(rng, side_px, 4, 4, octaves=3)
    light = 1.0 + 0.05 * strokes + 0.03 * clouds
    return _coarse(_with_mean(light[..., None] * np.array([236.0, 200.0, 190.0]), (226, 192, 184)))


def stone(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Rubble: rounded blue-grey stones of 10 to 25 cm in dark joints."""
    rng = np.random.default_rng([SEED, 5])
    nearest, second, index = _cells(_scatter(rng, 30, 1.5), side_px, 1.5)
    tones = np.array([[92, 104, 120], [108, 118, 132], [78, 90, 108], [120, 124, 130]], np.float64)
    colour = tones[rng.integers(0, len(tones), 30)[index]]
    colour = colour * (1.0 + 0.07 * rng.standard_normal(30))[index][..., None]
    inside = _step(second - nearest + 0.004 * noise(rng, side_px, 40, 40), 0.012, 0.035)
    rounded = _step(second - nearest, 0.0, 0.09)
    rough = 0.06 * noise(rng, side_px, 24, 24, octaves=3)
    face = colour * (0.72 + 0.36 * rounded + rough)[..., None]
    joint = np.array([62.0, 62.0, 64.0])
    return _coarse(_with_mean(joint + inside[..., None] * (face - joint), (98, 107, 120)))


def wallpaper(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Upright stripes in two greens, 12.5 cm wide, with a leaf on every other one."""
    rng = np.random.default_rng([SEED, 6])
    x, y = _coordinates(side_px)
    dark = _step(np.abs(_around(x * 4.0) / 4.0), 0.061, 0.064)
    line = 1.0 - _step(np.abs(np.abs(_around(x * 4.0) / 4.0) - 0.052), 0.0015, 0.004)
    base = np.array([176.0, 206.0, 150.0])
    picture = base + dark[..., None] * (np.array([98.0, 146.0, 88.0]) - base)
    picture += line[..., None] * (np.array([150.0, 150.0, 80.0]) - picture)
    # Two blades that lean away from each other, half a tile's quarter lower on every other stripe.
    column = np.floor(x * 4.0 + 0.5).astype(int) % 4
    dx = _around(x * 4.0) / 4.0
    dy = -_around(y * 4.0 + 0.5 * (column % 2)) / 4.0
    for sign in (-1.0, 1.0):
        u = 0.8 * dx * sign + 0.6 * dy
        v = -0.6 * dx * sign + 0.8 * dy
        blade = 1.0 - _step(np.hypot((u - 0.024) / 0.026, v / 0.0085), 0.85, 1.05)
        picture += blade[..., None] * (np.array([58.0, 112.0, 72.0]) - picture)
    weave = 1.0 + 0.012 * noise(rng, side_px, 100, 20)
    return _coarse(_with_mean(picture * weave[..., None], (138, 174, 118)))


def glazed_tiles(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Glazed turquoise tiles of 20 by 10 cm in running bond, with pale joints."""
    rng = np.random.default_rng([SEED, 7])
    edge_m, row, column, high = _bond(side_px, rows=10, columns=5, shift=0.5)
    tone = rng.normal(1.0, 0.09, (10, 5))[row, column]
    green = rng.normal(0.0, 9.0, (10, 5))[row, column]
    glaze = np.stack([52.0 * tone, 140.0 * tone + green, 150.0 * tone - green], axis=-1)
    # The glaze is thin, and so paler, towards the edges; light from above lies on the upper part.
    shine = 0.10 * _step(high, 0.55, 0.95) + 0.05 * noise(rng, side_px, 8, 16, octaves=2)
    pale = 0.25 * (1.0 - _step(edge_m, 0.004, 0.014))
    glaze = glaze * (1.0 + shine)[..., None]
    glaze += pale[..., None] * (np.array([190.0, 225.0, 225.0]) - glaze)
    joint = np.array([206.0, 208.0, 202.0])
    inside = _step(edge_m, 0.0, 0.003)[..., None]
    return _coarse(_with_mean(joint + inside * (glaze - joint), (66, 146, 154)))


def panelling(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Boards painted navy, 1/6 m wide, with a bead between them."""
    rng = np.random.default_rng([SEED, 8])
    x, _ = _coordinates(side_px)
    across = np.abs(_around(x * 6.0) / 6.0)
    groove = np.exp(-(((across - 0.080) / 0.0022) ** 2))
    bead = np.exp(-(((across - 0.073) / 0.0030) ** 2))
    board = np.floor(x * 6.0 + 0.5).astype(int) % 6
    tone = 1.0 + 0.06 * rng.standard_normal(6)[board]
    brush = 0.03 * noise(rng, side_px, 60, 3) + 0.02 * noise(rng, side_px, 3, 3)
    light = tone + brush - 0.55 * groove + 0.35 * bead
    return _coarse(_with_mean(light[..., None] * np.array([58.0, 82.0, 146.0]), (58, 82, 146)))


def shingles(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Rows of round-ended shingles in plum, each in the shadow of the row above."""
    rng = np.random.default_rng([SEED, 9])
    x, y = _coordinates(side_px)
    rows, columns = 10, 8
    tones = rng.normal(1.0, 0.10, (rows, columns))
    # Each row lies over the upper part of the one below it: that one first.
    below = np.floor(y * rows).astype(int)
    picture = np.zeros((side_px, side_px, 3))
    for row in (below, below - 1):
        shifted = x * columns + 0.5 * (row % 2)
        dx = np.abs(shifted % 1.0 - 0.5) / columns
        down = y - row / rows
        reach = 0.1 + 0.045 * np.sqrt(np.maximum(1.0 - (2.0 * columns * dx) ** 2, 0.0)) - down
        tone = tones[row % rows, np.floor(shifted).astype(int) % columns]
        light = tone * (0.80 + 2.0 * np.clip(down, 0.0, 0.14))
        light -= 0.30 * (1.0 - _step(reach, 0.001, 0.006))
        light -= 0.30 * (1.0 - _step(0.5 / columns - dx, 0.0005, 0.003))
        on = 1.0 if row is below else _step(reach, 0.0, 0.003)[..., None]
        picture += on * (light[..., None] * np.array([140.0, 62.0, 104.0]) - picture)
    grain = 1.0 + 0.03 * noise(rng, side_px, 60, 16, octaves=2)
    return _coarse(_with_mean(picture * grain[..., None], (128, 58, 96)))


def floor_tiles(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Square tiles of 25 cm, cream and sand in turn, with grey joints."""
    rng = np.random.default_rng([SEED, 10])
    edge_m, row, column, _ = _bond(side_px, rows=4, columns=4, shift=0.0)
    odd = ((row + column) % 2)[..., None]
    tone = rng.normal(1.0, 0.02, (4, 4))[row, column]
    clouds = 0.03 * noise(rng, side_px, 10, 10, octaves=3)
    face = np.array([228.0, 220.0, 200.0]) - odd * np.array([44.0, 52.0, 62.0])
    face = face * (tone + clouds)[..., None]
    joint = np.array([150.0, 146.0, 138.0])
    inside = _step(edge_m, 0.0, 0.004)[..., None]
    return _coarse(_with_mean(joint + inside * (face - joint), (202, 190, 166)))


def herringbone(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Oak parquet, blocks of 25 by 6.25 cm laid in herringbone."""
    rng = np.random.default_rng([SEED, 11])
    x, y = _coordinates(side_px)
    cells, longer = 16, 4
    i, j = np.floor(x * cells).astype(int), np.floor(y * cells).astype(int)
    step = (i - j) % (2 * longer)
    flat = step < longer
    # The first cell of the block that a cell belongs to, and where in the block a point lies.
    first_i = np.where(flat, i - step, i) % cells
    first_j = np.where(flat, j, j - (2 * longer - 1 - step)) % cells
    along = np.where(flat, x * cells - i + step, y * cells - j + (2 * longer - 1 - step))
    across = np.where(flat, y * cells - j, x * cells - i)
    edge_m = np.minimum(np.minimum(along, longer - along), np.minimum(across, 1.0 - across)) / cells
    tone = rng.normal(1.0, 0.11, (cells, cells))[first_j, first_i]
    lengthwise = noise(rng, side_px, 6, 120), noise(rng, side_px, 120, 6)
    grain = 0.05 * np.where(flat, *lengthwise)
    light = (tone + grain) * (1.0 - 0.45 * (1.0 - _step(edge_m, 0.0004, 0.003)))
    return _coarse(_with_mean(light[..., None] * np.array([186.0, 132.0, 78.0]), (174, 124, 74)))


def floorboards(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Walnut boards 12.5 cm wide and half a metre long, their ends staggered."""
    rng = np.random.default_rng([SEED, 12])
    edge_m, row, column, _ = _bond(side_px, rows=8, columns=2, shift=0.5)
    tone = rng.normal(1.0, 0.14, (8, 2))[row, column]
    grain = 0.08 * noise(rng, side_px, 5, 110, octaves=2) + 0.05 * noise(rng, side_px, 3, 24)
    light = (tone + grain) * (1.0 - 0.6 * (1.0 - _step(edge_m, 0.0004, 0.003)))
    return _coarse(_with_mean(light[..., None] * np.array([112.0, 74.0, 50.0]), (106, 70, 48)))


def terracotta(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Six-sided tiles of 14 cm in terracotta with pale joints."""
    rng = np.random.default_rng([SEED, 13])
    # Seven columns by eight rows are within one part in a hundred of regular.
    columns, rows = 7, 8
    row, column = np.divmod(np.arange(rows * columns), columns)
    centres = np.stack([(column + 0.5 * (row % 2)) / columns, row / rows], axis=1)
    nearest, second, index = _cells(centres, side_px)
    tone = rng.normal(1.0, 0.10, rows * columns)[index]
    clouds = 0.05 * noise(rng, side_px, 12, 12, octaves=3)
    face = (tone + clouds)[..., None] * np.array([196.0, 100.0, 62.0])
    joint = np.array([206.0, 190.0, 172.0])
    inside = _step(second - nearest, 0.006, 0.014)[..., None]
    return _coarse(_with_mean(joint + inside * (face - joint), (190, 106, 72)))


def terrazzo(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Chips of 1 to 4 cm in five colours, ground flat in pale cement."""
    rng = np.random.default_rng([SEED, 14])
    count = 420
    nearest, second, index = _cells(_scatter(rng, count), side_px)
    chips = np.array(
        [[150, 150, 156], [92, 100, 110], [196, 150, 120], [120, 140, 124], [232, 228, 220]],
        np.float64,
    )
    colour = chips[rng.integers(0, len(chips), count)[index]]
    size = rng.uniform(0.004, 0.022, count)[index]
    inside = _step(second - nearest, size, size + 0.004)[..., None]
    cement = np.array([214.0, 212.0, 206.0])
    return _coarse(_with_mean(cement + inside * (colour - cement), (196, 194, 188)))


def carpet(side_px: int = SMALL_SIDE_PX) -> Picture:
    """Violet carpet with a woven lattice of lozenges."""
    rng = np.random.default_rng([SEED, 15])
    x, y = _coordinates(side_px)
    lattice = np.abs(_around(4.0 * (x + y))), np.abs(_around(4.0 * (x - y)))
    line = 1.0 - _step(np.minimum(*lattice), 0.03, 0.07)
    dot = 1.0 - _step(np.hypot(*(0.5 - value for value in lattice)), 0.09, 0.13)
    pile = 1.0 + 0.10 * noise(rng, side_px, 90, 90) + 0.03 * noise(rng, side_px, 4, 4)
    base = np.array([92.0, 70.0, 118.0])
    picture = base + line[..., None] * (np.array([132.0, 112.0, 152.0]) - base)
    picture += dot[..., None] * (np.array([176.0, 150.0, 96.0]) - picture)
    return _coarse(_with_mean(picture * pile[..., None], (104, 82, 126)))


def ceiling_panels(side_px: int = SMALL_SIDE_PX) -> Picture:
    """White panels of half a metre in a grey grid, with rows of small holes."""
    rng = np.random.default_rng([SEED, 16])
    x, y = _coordinates(side_px)
    edge_m, _, _, _ = _bond(side_px, rows=2, columns=2, shift=0.0)
    holes = np.hypot(_around(x * 24.0), _around(y * 24.0)) / 24.0
    hole = (1.0 - _step(holes, 0.004, 0.0065)) * _step(edge_m, 0.03, 0.035)
    light = 1.0 + 0.012 * noise(rng, side_px, 6, 6, octaves=2) - 0.22 * hole
    rail = 1.0 - _step(edge_m, 0.008, 0.011)
    picture = light[..., None] * np.array([238.0, 238.0, 234.0])
    picture += rail[..., None] * (np.array([196.0, 198.0, 200.0]) - picture)
    return _coarse(_with_mean(picture, (230, 230, 226)))


@dataclass(frozen=True)
class Texture:
    """How a texture is drawn, and the size of the shipped one."""

    draw: Callable[[int], Picture]
    side_px: int


TEXTURES: dict[str, Texture] = {
    "bricks.png": Texture(bricks, SIDE_PX),
    "concrete.png": Texture(concrete, SIDE_PX),
    "wood_.png": Texture(wood, SIDE_PX),
} | {
    f"{draw.__name__}.png": Texture(draw, SMALL_SIDE_PX)
    for draw in (
        plaster, stone, wallpaper, glazed_tiles, panelling, shingles, floor_tiles, herringbone,
        floorboards, terracotta, terrazzo, carpet, ceiling_panels,
    )
}  # fmt: skip


def _bond(
    side_px: int, rows: int, columns: int, shift: float
) -> tuple[Field, NDArray[np.int64], NDArray[np.int64], Field]:
    """Courses of equal blocks, each odd course moved by `shift` of a block.

    The distance to the block's edge over the tile's side, the block's row and column, and the
    height in the block, 0 at its bottom to 1 at its top.
    """
    x, y = _coordinates(side_px)
    row = np.floor(y * rows).astype(int) % rows
    shifted = x * columns + shift * (row % 2)
    column = np.floor(shifted).astype(int) % columns
    across, down = shifted % 1.0, (y * rows) % 1.0
    edge = np.minimum(
        np.minimum(across, 1.0 - across) / columns, np.minimum(down, 1.0 - down) / rows
    )
    return edge, row, column, 1.0 - down


def _scatter(rng: np.random.Generator, count: int, stretch: float = 1.0) -> Field:
    """(count, 2) random points of a tile with distance between them (best candidate)."""
    points = rng.random((1, 2))
    while len(points) < count:
        candidates = rng.random((12, 2))
        apart = np.abs(_around(candidates[:, None] - points[None])) / [stretch, 1.0]
        far = np.hypot(apart[..., 0], apart[..., 1]).min(1)
        points = np.vstack([points, candidates[int(far.argmax())]])
    return points


def _cells(
    points: Field, side_px: int, stretch: float = 1.0
) -> tuple[Field, Field, NDArray[np.int64]]:
    """Distances of each pixel to the nearest and the second of (n, 2) points, and the nearest one.

    Distances along x are divided by `stretch`.
    """
    # Copies around the tile make the distances periodic.
    shifts = np.array([(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)])
    copies = (points[None] + shifts[:, None]).reshape(-1, 2) / [stretch, 1.0]
    x, y = _coordinates(side_px)
    distances, indices = spatial.KDTree(copies).query(
        np.stack([x.ravel() / stretch, y.ravel()], axis=1), k=2
    )
    shape = (side_px, side_px)
    nearest, second = distances[:, 0].reshape(shape), distances[:, 1].reshape(shape)
    return nearest, second, (indices[:, 0] % len(points)).reshape(shape)


def _coarse(picture: Picture) -> Picture:
    """In steps of `COARSE_STEP` grey levels, which halves the file."""
    return np.clip(np.rint(picture / COARSE_STEP) * COARSE_STEP, 0.0, 255.0)


def noise(
    rng: np.random.Generator, side_px: int, cells_x: int, cells_y: int, octaves: int = 1
) -> Field:
    """(side, side) smooth noise that repeats at the tile's edges, of mean 0 and deviation 1.

    The coarsest octave has `cells_x` by `cells_y` random values over the tile; each further one has
    twice as many a side and half the strength.
    """
    total = np.zeros((side_px, side_px))
    for octave in range(octaves):
        # Drawn at full size for any image size, so that a smaller image shows the same tile.
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
    """(side, count) weights that interpolate pixels along one axis from `count` values."""
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
    """The shorter distance around the tile, in -0.5..0.5."""
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
    """Add a round hole to `depth`, wrapped around the tile's edges."""
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
    """The image, each channel scaled until its mean after clipping to 0..255 is the given one."""
    picture = np.clip(picture, 0.0, None)
    for _ in range(4):
        mean = np.clip(picture, 0.0, 255.0).mean((0, 1))
        picture = picture * (np.array(mean_rgb) / mean)
    return np.clip(picture, 0.0, 255.0)


def png_bytes(picture: Picture) -> bytes:
    """The image as PNG with 8 bits per channel."""
    rgb = np.rint(picture).astype(np.uint8)
    options = [cv2.IMWRITE_PNG_COMPRESSION, 9]
    done, data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), options)
    if not done:
        raise RuntimeError("OpenCV cannot write PNG")
    return bytes(data.tobytes())


def write(folder: Path) -> None:
    """Draw every texture into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, texture in TEXTURES.items():
        data = png_bytes(texture.draw(texture.side_px))
        (folder / name).write_bytes(data)
        _log.info("%s: %d bytes", folder / name, len(data))


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    if len(sys.argv) != 2:
        sys.exit("usage: python -m mazebot.worldgen.assets.textures OUT_DIR")
    write(Path(sys.argv[1]))

"""Draws triangles on a CPU, a strip of the picture's rows at a time: the visible triangle, the
depth and the colour of each pixel.

A pixel's ray is (x, y, 1) in the optical frame, linear in the pixel's column u and row v. Whether
it passes inside a triangle's edges, the nearness 1 / depth of the point that it hits, and any
property of that point divided by the depth are linear in the ray (Olano and Greer, Triangle Scan
Conversion using 2D Homogeneous Coordinates, 1997): a triangle is a few planes over the picture, and
needs no clipping. First the nearest triangle of each pixel is found, then each pixel is shaded
once.

Only sums, products, quotients and square roots are used, each rounded according to IEEE 754: a
picture is the same on every processor, and with any number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel, shared_kernel
from mazebot.physics.camera.mipmaps import smaller_levels
from mazebot.physics.camera.scene import Texture

Floats = NDArray[np.float32]
Words = NDArray[np.uint32]
Counts = NDArray[np.int64]

_f32, _i32, _u32, _at = np.float32, np.int32, np.uint32, np.uintp
_ZERO: int = np.int64(0)  # type: ignore[assignment]
"""Where a count starts that is handed on: given a constant, Numba would compile all that is called
once more.
"""

EDGE, NEARNESS, UV, TINT, NORMAL, ALBEDO = 0, 3, 4, 6, 9, 12
PLANES = 15
"""Rows of a triangle's planes, by the first of each: three edges, then what is interpolated."""
FIRST_ROW, END_ROW, TEXTURE, VARIES, RED, GREEN, BLUE = range(7)
FACTS = 7
"""Columns of a triangle's other data: its rows, its texture, whether its tint differs from pixel to
pixel, and if not the tint, of 65536.
"""
_ONE = 65536
_NO_OWNER = -1

_CHUNK = 64
"""Pixels of one triangle that are shaded together, so that loops over them can be vectorised."""
_LANES = 15
_S, _T, _SCALE, _LIGHT_R, _LIGHT_G, _LIGHT_B, _SHADE_R, _SHADE_G, _SHADE_B = (
    _CHUNK * lane for lane in range(9)
)
_X, _Y, _Z, _FACING_X, _FACING_Y, _FACING_Z = (_CHUNK * lane for lane in range(9, _LANES))
_TOP_LEFT, _TOP_RIGHT, _LOW_LEFT, _LOW_RIGHT, _ACROSS, _DOWN, _SMALLER = (
    _CHUNK * lane for lane in range(7)
)
_WORD_LANES = 7
_SLACK_PX = 1e-6
"""Bound on how far rounding moves a corner: only for leaving out pixels; the edges decide."""


class Surfaces(NamedTuple):
    """A scene's triangles."""

    corners: NDArray[np.int32]
    """(m, 3)"""
    places_m: Array
    """(n, 3), in the frame of the triangle's mover"""
    normals: Array
    """(n, 3)"""
    uvs: Array
    """(n, 2)"""
    tints: Array
    """(n, 3)"""
    albedos: Array
    """(n, 3)"""
    textures: Counts
    """(m,): index into `Textures.sizes`, or -1"""
    movers: Counts
    """(m,): index into the movers' poses, or -1"""
    smooth: NDArray[np.bool_]
    """(m,): its corners' normals and tints differ"""


class Textures(NamedTuple):
    """All levels of all textures, one after the other."""

    texels: Words
    """R, G, B from the lowest byte up; each level has a border that repeats the texture"""
    sizes: NDArray[np.int32]
    """(t, levels, 4): index of a level's first texel, texels from row to row, width, height"""
    counts: Counts
    """(t,): levels of each"""


class View(NamedTuple):
    """A camera: focal lengths and centre in pixels, size, depth limits in metres."""

    focal_px: Array
    centre_px: Array
    size_px: Counts
    limits_m: Array
    """Nearest and farthest depth that is drawn, then that is measured"""


class Lamps(NamedTuple):
    """Lamps, and the camera's pose."""

    rows: Array
    """(l, 10): position in the map, colour, constant, linear and quadratic fade, range"""
    map_from_optical: Array
    """(4, 4)"""


class Scratch(NamedTuple):
    """Working memory of one thread for one strip."""

    nearness: Floats
    """(rows x width,); depths once the strip's triangles are known"""
    owners: NDArray[np.int32]
    rgba: Words
    lanes: Floats
    bits: NDArray[np.int32]
    """The same memory as `lanes`"""
    words: Words
    levels: NDArray[np.int32]

    @classmethod
    def of(cls, pixels: int) -> Scratch:
        """For a strip of so many pixels."""
        fours = -(-pixels // 4) * 4
        lanes = np.empty(_LANES * _CHUNK, np.float32)
        return cls(
            np.empty(pixels, np.float32),
            np.empty(pixels, np.int32),
            np.zeros(fours, np.uint32),
            lanes,
            lanes.view(np.int32),
            np.empty(_WORD_LANES * _CHUNK, np.uint32),
            np.empty(_CHUNK, np.int32),
        )


def textures_of(textures: Sequence[Texture], known: Mapping[str, Sequence[Words]]) -> Textures:
    """Textures ready to be drawn. `known` are bordered levels by sha256, as from `levels_of`."""
    each = [
        known[texture.sha256] if texture.sha256 in known else list(bordered_levels(texture))
        for texture in textures
    ]
    most = max((len(levels) for levels in each), default=1)
    sizes = np.zeros((len(each), most, 4), np.int32)
    first = 0
    for index, levels in enumerate(each):
        for level, texels in enumerate(levels):
            height, width = texels.shape
            sizes[index, level] = first, width, width - 2, height - 2
            first += texels.size
    flat = [texels.ravel() for levels in each for texels in levels]
    return Textures(
        np.concatenate(flat) if flat else np.zeros(1, np.uint32),
        sizes,
        np.array([len(levels) for levels in each], np.int64),
    )


def levels_of(textures: Textures, index: int) -> list[Words]:
    """The levels of one texture with their borders, largest first: views."""
    levels = []
    for first, row, _, height in textures.sizes[index, : textures.counts[index]].tolist():
        levels.append(textures.texels[first : first + row * (height + 2)].reshape(-1, row))
    return levels


def bordered_levels(texture: Texture) -> Iterator[Words]:
    """A texture's levels, largest first, each with a border of one texel that repeats it."""
    rgba = np.asarray(cv2.cvtColor(texture.pixels, cv2.COLOR_RGB2RGBA), np.uint8)
    for level in (rgba, *smaller_levels(rgba)):
        yield np.pad(np.ascontiguousarray(level).view("<u4")[:, :, 0], 1, mode="wrap")


@kernel()
def triangles_of_parts(order: Counts, first: Counts, count: Counts) -> Counts:
    """Indices of the triangles of some parts, one part after the other."""
    total = 0
    for part in order:
        total += count[part]
    triangles = np.empty(total, np.int64)
    at = 0
    for part in order:
        for triangle in range(first[part], first[part] + count[part]):
            triangles[at] = triangle
            at += 1
    return triangles


@kernel()
def project(
    chosen: Counts,
    surfaces: Surfaces,
    view: View,
    optical_from_map: Array,
    map_from_movers: Array,
    sun: Array,
    lit_by_lamps: bool,
) -> tuple[Array, Counts]:
    """Planes, (k, PLANES, 3), and facts, (k, FACTS), of those of the chosen triangles that are
    front-facing and may be visible.

    A plane (a, b, c) has the value a u + b v + c at the pixel in column u and row v. It is positive
    on the inner side of an edge; NEARNESS is 1 / depth; all others are properties over the depth.
    """
    fx, fy = view.focal_px
    cx, cy = view.centre_px
    width, height = view.size_px
    near_m = view.limits_m[0]
    places_m, normals = surfaces.places_m, surfaces.normals
    planes = np.empty((len(chosen), PLANES, 3))
    facts = np.empty((len(chosen), FACTS), np.int64)
    corner = np.empty((3, 3))
    edge = np.empty((3, 3))
    normal = np.empty((3, 3))
    tint = np.empty((3, 3))
    albedo = np.empty((3, 3))
    kept = _ZERO
    for triangle in chosen:
        mover = surfaces.movers[triangle]
        for index in range(3):
            vertex = surfaces.corners[triangle, index]
            x, y, z = places_m[vertex, 0], places_m[vertex, 1], places_m[vertex, 2]
            if mover >= 0:
                pose = map_from_movers[mover]
                x, y, z = (
                    pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
                    pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
                    pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
                )
            for axis in range(3):
                corner[index, axis] = (
                    optical_from_map[axis, 0] * x
                    + optical_from_map[axis, 1] * y
                    + optical_from_map[axis, 2] * z
                    + optical_from_map[axis, 3]
                )
        # The normal of the plane through the eye and an edge points inwards if the triangle is
        # front-facing.
        _set_edge(edge, 0, corner)
        volume = corner[0, 0] * edge[0, 0] + corner[0, 1] * edge[0, 1] + corner[0, 2] * edge[0, 2]
        if not volume > 0.0:
            continue
        nearer = 0
        left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
        for index in range(3):
            if corner[index, 2] < near_m:
                nearer += 1
            else:
                u = fx * corner[index, 0] / corner[index, 2] + cx
                v = fy * corner[index, 1] / corner[index, 2] + cy
                left, right = min(left, u), max(right, u)
                top, bottom = min(top, v), max(bottom, v)
        if nearer == 3:
            continue
        first_row, end_row = 0, height
        if nearer == 0:
            # In a fine mesh most triangles lie between the centres of pixels.
            first, end = _pixels(left, right, width)
            first_row, end_row = _pixels(top, bottom, height)
            if first >= end:
                continue
        if first_row >= end_row:
            continue

        _set_edge(edge, 1, corner)
        _set_edge(edge, 2, corner)
        plane = planes[kept]
        for index in range(3):
            plane[index, 0] = edge[index, 0] / fx
            plane[index, 1] = edge[index, 1] / fy
            plane[index, 2] = edge[index, 2] - plane[index, 0] * cx - plane[index, 1] * cy
        ones = (1.0, 1.0, 1.0)
        _interpolate(planes, kept, NEARNESS, volume, ones)
        a, b, c = surfaces.corners[triangle]
        texture = surfaces.textures[triangle]
        if texture >= 0:
            for axis in range(2):
                of = (surfaces.uvs[a, axis], surfaces.uvs[b, axis], surfaces.uvs[c, axis])
                _interpolate(planes, kept, UV + axis, volume, of)

        # A flat triangle has the values of its last corner everywhere, as in OpenGL.
        smooth = surfaces.smooth[triangle]
        for index in range(3):
            vertex = surfaces.corners[triangle, index if smooth else 2]
            x, y, z = normals[vertex, 0], normals[vertex, 1], normals[vertex, 2]
            light = 0.0
            if mover >= 0:
                pose = map_from_movers[mover]
                x, y, z = (
                    pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z,
                    pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z,
                    pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z,
                )
                light = max(x * sun[0] + y * sun[1] + z * sun[2], 0.0)
            normal[index, 0], normal[index, 1], normal[index, 2] = x, y, z
            for axis in range(3):
                albedo[index, axis] = surfaces.albedos[vertex, axis]
                lit = surfaces.tints[vertex, axis] + albedo[index, axis] * light
                tint[index, axis] = min(max(lit, 0.0), 1.0)
        if smooth or lit_by_lamps:
            for axis in range(3):
                of = (tint[0, axis], tint[1, axis], tint[2, axis])
                _interpolate(planes, kept, TINT + axis, volume, of)
        if lit_by_lamps:
            for axis in range(3):
                of = (normal[0, axis], normal[1, axis], normal[2, axis])
                _interpolate(planes, kept, NORMAL + axis, volume, of)
                of = (albedo[0, axis], albedo[1, axis], albedo[2, axis])
                _interpolate(planes, kept, ALBEDO + axis, volume, of)
        fact = facts[kept]
        fact[FIRST_ROW], fact[END_ROW], fact[TEXTURE] = first_row, end_row, texture
        fact[VARIES] = 1 if smooth or lit_by_lamps else 0
        for axis in range(3):
            fact[RED + axis] = int(tint[2, axis] * _ONE + 0.5)
        kept += 1
    return planes[:kept], facts[:kept]


@kernel("void(float64[:, ::1], int64, float64[:, ::1])")
def _set_edge(edge: Array, index: int, corner: Array) -> None:
    """The cross product of the two corners other than this one, the later one first."""
    a, b = (index + 2) % 3, (index + 1) % 3
    edge[index, 0] = corner[a, 1] * corner[b, 2] - corner[a, 2] * corner[b, 1]
    edge[index, 1] = corner[a, 2] * corner[b, 0] - corner[a, 0] * corner[b, 2]
    edge[index, 2] = corner[a, 0] * corner[b, 1] - corner[a, 1] * corner[b, 0]


@kernel()
def _pixels(least: float, most: float, count: int) -> tuple[int, int]:
    """The first of so many pixels whose centre may lie between two coordinates, and the one after
    the last.
    """
    first, end = 0, count
    if least > 0.0:
        first = math.ceil(min(least, float(count)) - _SLACK_PX)
    if most < count - 1.0:
        end = math.floor(max(most, -1.0) + _SLACK_PX) + 1
    return first, end


@kernel("void(float64[:, :, ::1], int64, int64, float64, UniTuple(float64, 3))")
def _interpolate(
    planes: Array, triangle: int, row: int, volume: float, values: tuple[float, float, float]
) -> None:
    """The plane of a property over the depth, from its values at the corners."""
    for axis in range(3):
        planes[triangle, row, axis] = (
            planes[triangle, EDGE, axis] * values[0]
            + planes[triangle, EDGE + 1, axis] * values[1]
            + planes[triangle, EDGE + 2, axis] * values[2]
        ) / volume


@shared_kernel()
def draw_strip(
    first_row: int,
    end_row: int,
    planes: Array,
    facts: Counts,
    textures: Textures,
    lamps: Lamps,
    view: View,
    sky: int,
    scratch: Scratch,
    rgb: Words,
    depth_m: Floats,
) -> None:
    """Draw rows of the picture.

    `rgb` holds its colours, three bytes a pixel, row after row; the first row's number times the
    width must be a multiple of four. `depth_m`, (height x width,), has NaN where nothing is
    within the limits; if it is empty, none is computed. `sky` is the background colour.
    """
    width = view.size_px[0]
    pixels = (end_row - first_row) * width
    near_m, far_m, least_m, most_m = view.limits_m
    nearness, owners, rgba = scratch.nearness, scratch.owners, scratch.rgba
    for at in range(pixels):
        nearness[at] = _f32(1.0 / far_m)
        owners[at] = _i32(_NO_OWNER)
    for triangle in range(len(planes)):
        if facts[triangle, FIRST_ROW] < end_row and facts[triangle, END_ROW] > first_row:
            _cover(
                triangle, planes, facts, first_row, end_row, width, 1.0 / near_m, nearness, owners
            )
    for at in range(pixels):
        nearness[at] = _f32(1.0) / nearness[at]
    if len(depth_m):
        least, most = _f32(least_m), _f32(most_m)
        start = _at(first_row * width)
        for at in range(pixels):
            depth = nearness[at]
            seen = (depth >= least) & (depth <= most) & (owners[at] >= _i32(0))
            depth_m[start + _at(at)] = depth if seen else _f32(np.nan)

    at = _ZERO
    for v in range(first_row, end_row):
        row_end = at + width
        row_start = at
        while at < row_end:
            owner = owners[_at(at)]
            end = at + 1
            while end < row_end and owners[_at(end)] == owner:
                end += 1
            if owner < 0:
                _fill(rgba, at, end, sky)
            elif facts[owner, TEXTURE] < 0 and facts[owner, VARIES] == 0:
                _fill(rgba, at, end, _flat_colour(facts, owner))
            else:
                while at < end:
                    count = min(end - at, _CHUNK)
                    u = at - row_start
                    _shade(owner, at, count, u, v, planes, facts, textures, lamps, view, scratch)
                    at += count
            at = end
    _pack(rgba, pixels, rgb, first_row * width // 4 * 3)


@shared_kernel()
def draw_strips(
    first_strip: int,
    every: int,
    strip_rows: int,
    planes: Array,
    facts: Counts,
    textures: Textures,
    lamps: Lamps,
    view: View,
    sky: int,
    scratch: Scratch,
    rgb: Words,
    depth_m: Floats,
) -> None:
    """Draw one strip of rows after the other, beginning with the first and leaving out those that
    other threads draw; see `draw_strip`. One call, since a thread that comes back to Python waits
    for the others.
    """
    height = view.size_px[1]
    first = first_strip * strip_rows
    while first < height:
        draw_strip(
            first, min(first + strip_rows, height), planes, facts, textures, lamps, view, sky,
            scratch, rgb, depth_m,
        )  # fmt: skip
        first += every * strip_rows


@shared_kernel()
def _pack(rgba: Words, pixels: int, rgb: Words, to: int) -> None:
    """Pack each four colours into three words: the bytes are in a word from the lowest up."""
    for four in range((pixels + 3) // 4):
        first = _at(4 * four)
        a, b, c, d = rgba[first], rgba[first + _at(1)], rgba[first + _at(2)], rgba[first + _at(3)]
        word = _at(to) + _at(3 * four)
        rgb[word] = _u32(a | _u32(b << _u32(24)))
        rgb[word + _at(1)] = _u32(_u32(b >> _u32(8)) | _u32(c << _u32(16)))
        rgb[word + _at(2)] = _u32(_u32(c >> _u32(16)) | _u32(d << _u32(8)))


@shared_kernel()
def _cover(
    triangle: int,
    planes: Array,
    facts: Counts,
    first_row: int,
    end_row: int,
    width: int,
    most_nearness: float,
    nearness: Floats,
    owners: NDArray[np.int32],
) -> None:
    """Assign to a triangle the pixels where it is nearer than those drawn before."""
    plane = planes[triangle]
    near = _f32(most_nearness)
    own = _i32(triangle)
    across = _f32(plane[NEARNESS, 0])
    top = max(facts[triangle, FIRST_ROW], first_row)
    bottom = min(facts[triangle, END_ROW], end_row)
    for v in range(top, bottom):
        left, right = 0.0, float(width)
        for edge in range(3):
            slope = plane[edge, 0]
            value = plane[edge, 1] * v + plane[edge, 2]
            # For two triangles with a common edge the same numbers decide, with opposite signs: a
            # pixel on it belongs to the one on its right, or else below.
            if slope > 0.0:
                left = max(left, -value / slope)
            elif slope < 0.0:
                right = min(right, -value / slope)
            elif value < 0.0 or (value == 0.0 and plane[edge, 1] <= 0.0):
                right = 0.0
        if not left < right:
            continue
        first, end = math.ceil(left), math.ceil(right)
        start = _at((v - first_row) * width + first)
        base = _f32(plane[NEARNESS, 0] * first + plane[NEARNESS, 1] * v + plane[NEARNESS, 2])
        for step in range(end - first):
            at = start + _at(step)
            here = base + across * _f32(_i32(step))
            here = here if here <= near else _f32(0.0)
            before, owner = nearness[at], owners[at]
            # A product, so that every number is written: masked writes are slow on processors.
            nearer = _f32(here > before)
            nearness[at] = here * nearer + before * (_f32(1.0) - nearer)
            owners[at] = own if here > before else owner


@shared_kernel(inline=True)
def _fill(rgba: Words, start: int, end: int, colour: int) -> None:
    for at in range(end - start):
        rgba[_at(start) + _at(at)] = _u32(colour)


@shared_kernel()
def _flat_colour(facts: Counts, owner: int) -> int:
    colour = 0
    for axis in range(3):
        colour |= ((255 * facts[owner, RED + axis] + _ONE // 2) // _ONE) << (8 * axis)
    return colour


@shared_kernel(inline=True)
def _shade(
    owner: int,
    at: int,
    count: int,
    u: int,
    v: int,
    planes: Array,
    facts: Counts,
    textures: Textures,
    lamps: Lamps,
    view: View,
    scratch: Scratch,
) -> None:
    """Colour some pixels of one triangle, from column u on."""
    texture = facts[owner, TEXTURE]
    if texture < 0:
        _fill(scratch.rgba, at, at + count, 0xFFFFFF)
    else:
        _place_texels(owner, texture, at, count, u, v, planes, textures, scratch)
        start = _ZERO
        while start < count:
            # The two levels between which a pixel lies are mostly those of its neighbour.
            level = scratch.levels[_at(start)] >> 8
            end = start + 1
            while end < count and scratch.levels[_at(end)] >> 8 == level:
                end += 1
            _filter(texture, level, at, start, end, textures, scratch)
            start = end
    if facts[owner, VARIES]:
        _vary(owner, at, count, u, v, planes, lamps, view, scratch)
        return
    red, green, blue = facts[owner, RED], facts[owner, GREEN], facts[owner, BLUE]
    if min(red, green, blue) < _ONE:
        rgba = scratch.rgba
        r, g, b, half = _u32(red), _u32(green), _u32(blue), _u32(_ONE // 2)
        for step in range(count):
            here = _at(at) + _at(step)
            colour = rgba[here]
            lit_r = _u32(_u32(_u32(_u32(colour & _u32(255)) * r) + half) >> _u32(16))
            lit_g = _u32(
                _u32(_u32(_u32(_u32(colour >> _u32(8)) & _u32(255)) * g) + half) >> _u32(16)
            )
            lit_b = _u32(
                _u32(_u32(_u32(_u32(colour >> _u32(16)) & _u32(255)) * b) + half) >> _u32(16)
            )
            rgba[here] = _u32(lit_r | _u32(lit_g << _u32(8))) | _u32(lit_b << _u32(16))


@shared_kernel(inline=True)
def _place_texels(
    owner: int,
    texture: int,
    at: int,
    count: int,
    u: int,
    v: int,
    planes: Array,
    textures: Textures,
    scratch: Scratch,
) -> None:
    """Texture coordinates of pixels, 0 to 1, and their mipmap level, in 256ths of a level: half the
    binary logarithm of the squared number of texels, at most, in a step to the next pixel.
    """
    lanes, levels, depth = scratch.lanes, scratch.levels, scratch.nearness
    a, b, c = planes[owner, UV, 0], planes[owner, UV, 1], planes[owner, UV, 2]
    first_s, s_u, s_v = _f32(a * u + b * v + c), _f32(a), _f32(b)
    a, b, c = planes[owner, UV + 1, 0], planes[owner, UV + 1, 1], planes[owner, UV + 1, 2]
    first_t, t_u, t_v = _f32(a * u + b * v + c), _f32(a), _f32(b)
    near_u, near_v = _f32(planes[owner, NEARNESS, 0]), _f32(planes[owner, NEARNESS, 1])
    wide, high = _f32(textures.sizes[texture, 0, 2]), _f32(textures.sizes[texture, 0, 3])
    zero, one = _f32(0.0), _f32(1.0)
    for step in range(count):
        z = depth[_at(at) + _at(step)]
        across = _f32(_i32(step))
        s = (first_s + s_u * across) * z
        t = (first_t + t_u * across) * z
        # Derivatives of a quotient: of s over its nearness.
        right_s, right_t = (s_u - s * near_u) * z * wide, (t_u - t * near_u) * z * high
        down_s, down_t = (s_v - s * near_v) * z * wide, (t_v - t * near_v) * z * high
        lanes[_SCALE + step] = max(
            right_s * right_s + right_t * right_t, down_s * down_s + down_t * down_t
        )
        s -= np.floor(s)
        t -= np.floor(t)
        # Zero also for NaN.
        lanes[_S + step] = s if (s >= zero) & (s <= one) else zero
        lanes[_T + step] = t if (t >= zero) & (t <= one) else zero
    bits = scratch.bits
    last = _f32((textures.counts[texture] - 1) * 256)
    for step in range(count):
        # A float's exponent is its logarithm's whole part; a parabola gives the rest, to 0.01.
        bit = bits[_SCALE + step]
        exponent = _f32(_i32(_i32(bit >> _i32(23)) - _i32(127)))
        mantissa = _f32(_i32(bit & _i32(0x7FFFFF))) * _f32(1.0 / 0x800000)
        log = exponent + mantissa + _f32(0.34) * mantissa * (one - mantissa)
        level = log * _f32(128.0)
        level = level if level > zero else zero
        levels[step] = _i32(level if level < last else last)


@shared_kernel(inline=True)
def _filter(
    texture: int,
    level: int,
    at: int,
    start: int,
    end: int,
    textures: Textures,
    scratch: Scratch,
) -> None:
    """Blend the colours of two levels, and in each of the four texels around a position."""
    words, levels, rgba = scratch.words, scratch.levels, scratch.rgba
    _fetch(texture, level, start, end, textures, scratch)
    between = 0
    for step in range(start, end):
        between |= levels[step] & _i32(255)
    count = end - start
    to = _at(at) + _at(start)
    for step in range(count):
        rgba[to + _at(step)] = _bilinear(words, step)
    if between:
        _fetch(texture, level + 1, start, end, textures, scratch)
        for step in range(count):
            words[_SMALLER + step] = _bilinear(words, step)
        for step in range(count):
            share = _u32(levels[_at(start) + _at(step)] & _i32(255))
            here = to + _at(step)
            rgba[here] = _mixed(rgba[here], words[_SMALLER + step], share)


@shared_kernel(inline=True)
def _fetch(
    texture: int, level: int, start: int, end: int, textures: Textures, scratch: Scratch
) -> None:
    """Four texels of one level around each position, and its fraction between them, of 256."""
    words, lanes, texels = scratch.words, scratch.lanes, textures.texels
    sizes = textures.sizes
    row = sizes[texture, level, 1]
    # A texel's centre is half a texel from its corner; the border is one texel wide.
    origin = _i32(sizes[texture, level, 0] + row + 1)
    wide, high = _f32(sizes[texture, level, 2] * 256), _f32(sizes[texture, level, 3] * 256)
    half = _i32(128)
    for step in range(end - start):
        here = _at(start) + _at(step)
        x = _i32(_i32(lanes[_at(_S) + here] * wide) - half)
        y = _i32(_i32(lanes[_at(_T) + here] * high) - half)
        words[_ACROSS + step] = _u32(x & _i32(255))
        words[_DOWN + step] = _u32(y & _i32(255))
        down = _i32(_i32(y >> _i32(8)) * _i32(row))
        words[_TOP_LEFT + step] = _u32(_i32(origin + down) + _i32(x >> _i32(8)))
    for step in range(end - start):
        place = _at(words[_TOP_LEFT + step])
        words[_TOP_LEFT + step] = texels[place]
        words[_TOP_RIGHT + step] = texels[place + _at(1)]
        words[_LOW_LEFT + step] = texels[place + _at(row)]
        words[_LOW_RIGHT + step] = texels[place + _at(row + 1)]


@shared_kernel(inline=True)
def _bilinear(words: Words, step: int) -> np.uint32:
    across = words[_ACROSS + step]
    top = _mixed(words[_TOP_LEFT + step], words[_TOP_RIGHT + step], across)
    low = _mixed(words[_LOW_LEFT + step], words[_LOW_RIGHT + step], across)
    return _mixed(top, low, words[_DOWN + step])


@shared_kernel(inline=True)
def _mixed(a: np.uint32, b: np.uint32, share: np.uint32) -> np.uint32:
    """Blend of two colours, with the share of b, of 256: red and blue in one product."""
    rest = _u32(_u32(256) - share)
    ends = _u32(0xFF00FF)
    red_blue = _u32(
        _u32(_u32(_u32(a & ends) * rest) + _u32(_u32(b & ends) * share)) + _u32(0x800080)
    )
    byte = _u32(255)
    green = _u32(
        _u32(
            _u32(_u32(_u32(a >> _u32(8)) & byte) * rest)
            + _u32(_u32(_u32(b >> _u32(8)) & byte) * share)
        )
        + _u32(128)
    )
    return _u32(_u32(_u32(red_blue >> _u32(8)) & ends) | _u32(green & _u32(0xFF00)))


@shared_kernel()
def _vary(
    owner: int,
    at: int,
    count: int,
    u: int,
    v: int,
    planes: Array,
    lamps: Lamps,
    view: View,
    scratch: Scratch,
) -> None:
    """Shade pixels with a tint that varies between them, and with the lamps."""
    plane, lanes, depth, rgba = planes[owner], scratch.lanes, scratch.nearness, scratch.rgba
    zero, one = _f32(0.0), _f32(1.0)
    for axis in range(3):
        first = _f32(plane[TINT + axis, 0] * u + plane[TINT + axis, 1] * v + plane[TINT + axis, 2])
        across = _f32(plane[TINT + axis, 0])
        lane = _SHADE_R + axis * _CHUNK
        for step in range(count):
            shade = (first + across * _f32(_i32(step))) * depth[_at(at) + _at(step)]
            lanes[lane + step] = shade
    if len(lamps.rows):
        _add_lamps(plane, at, count, u, v, lamps, view, scratch)
    for step in range(count):
        here = _at(at) + _at(step)
        colour = rgba[here]
        r = _f32(_i32(colour & _u32(255)))
        g = _f32(_i32(_u32(colour >> _u32(8)) & _u32(255)))
        b = _f32(_i32(_u32(colour >> _u32(16)) & _u32(255)))
        r *= min(max(lanes[_SHADE_R + step], zero), one)
        g *= min(max(lanes[_SHADE_G + step], zero), one)
        b *= min(max(lanes[_SHADE_B + step], zero), one)
        half = _f32(0.5)
        lit = _i32(r + half) | _i32(_i32(g + half) << _i32(8)) | _i32(_i32(b + half) << _i32(16))
        rgba[here] = _u32(lit)


@shared_kernel()
def _add_lamps(
    plane: Array,
    at: int,
    count: int,
    u: int,
    v: int,
    lamps: Lamps,
    view: View,
    scratch: Scratch,
) -> None:
    """Add the lamps' light to the shades, after Lambert."""
    lanes, depth = scratch.lanes, scratch.nearness
    zero, least = _f32(0.0), _f32(1e-6)
    for axis in range(3):
        # Position in the map: the eye's plus depth times the ray; the normal's length cancels.
        pose = lamps.map_from_optical[axis]
        slope_x, slope_y = pose[0] / view.focal_px[0], pose[1] / view.focal_px[1]
        ray_u, ray_v = u - view.centre_px[0], v - view.centre_px[1]
        ray, along = _f32(slope_x * ray_u + slope_y * ray_v + pose[2]), _f32(slope_x)
        eye = _f32(pose[3])
        row = plane[NORMAL + axis]
        facing, turn = _f32(row[0] * u + row[1] * v + row[2]), _f32(row[0])
        for step in range(count):
            here = _f32(_i32(step))
            z = depth[_at(at) + _at(step)]
            lanes[_X + axis * _CHUNK + step] = eye + (ray + along * here) * z
            lanes[_FACING_X + axis * _CHUNK + step] = (facing + turn * here) * z
            lanes[_LIGHT_R + axis * _CHUNK + step] = zero
    for lamp in range(len(lamps.rows)):
        row = lamps.rows[lamp]
        lamp_x, lamp_y, lamp_z = _f32(row[0]), _f32(row[1]), _f32(row[2])
        red, green, blue = _f32(row[3]), _f32(row[4]), _f32(row[5])
        constant, linear, quadratic = _f32(row[6]), _f32(row[7]), _f32(row[8])
        reach = _f32(row[9])
        for step in range(count):
            x, y, z = lanes[_FACING_X + step], lanes[_FACING_Y + step], lanes[_FACING_Z + step]
            to_x = lamp_x - lanes[_X + step]
            to_y = lamp_y - lanes[_Y + step]
            to_z = lamp_z - lanes[_Z + step]
            distance = np.sqrt(to_x * to_x + to_y * to_y + to_z * to_z)
            facing = x * to_x + y * to_y + z * to_z
            scale = max(np.sqrt(x * x + y * y + z * z) * distance, least)
            fade = max(constant + linear * distance + quadratic * distance * distance, least)
            strength = max(facing, zero) / scale / fade
            strength = strength if distance <= reach else zero
            lanes[_LIGHT_R + step] += strength * red
            lanes[_LIGHT_G + step] += strength * green
            lanes[_LIGHT_B + step] += strength * blue
    for axis in range(3):
        row = plane[ALBEDO + axis]
        first, across = _f32(row[0] * u + row[1] * v + row[2]), _f32(row[0])
        for step in range(count):
            albedo = (first + across * _f32(_i32(step))) * depth[_at(at) + _at(step)]
            lanes[_SHADE_R + axis * _CHUNK + step] += (
                albedo * lanes[_LIGHT_R + axis * _CHUNK + step]
            )

"""What a camera sees: a world and the entities in it, as lit, textured quads for any renderer."""

from __future__ import annotations

import functools
import hashlib
import math
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from services.common.documents import Entity, Material, Rgba, Wall, World
from services.common.frames import Array, rotation_from_quaternion, transform_matrix

FLOOR_SIDE_M = 100.0
MAX_TEXTURE_SIDE_PX = 2048
PLAIN = -1
"""Texture index of a quad that has none."""

PANEL_BACK: Rgba = (0.45, 0.45, 0.45, 1.0)
"""Colour of a panel's back, and of a front without its texture: nothing a detector could read."""

_UNKNOWN_MATERIAL = Material(name="")
_WHITE: Rgba = (1.0, 1.0, 1.0, 1.0)
_PARALLEL = 1e-8
"""One less the cosine of 0.14 mrad: over 5 m, 0.7 mm."""
_SAME_PLANE_M = 1e-3
"""Faces nearer each other count as one: from some 15 m on, a depth buffer cannot part them."""
_SLIVER_M = 1e-6
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture to lay on quads."""

    sha256: str
    """Of the PNG file's bytes: two textures with the same one are the same."""
    pixels: NDArray[np.uint8]
    """(h, w, 3), RGB, top row first, read-only."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Flat quads in the map frame, seen from their front only.

    A pixel's colour is the quad's tint times the texture there: light is in the tint already,
    since a flat face under a directional light has one shade. So every renderer shows the same
    colours.
    """

    corners_m: Array
    """(n, 4, 3): counter-clockwise from the bottom left, as one looks at the front."""
    uvs: Array
    """(n, 4, 2), none negative: (0, 0) is a texture's top left, (1, 1) its bottom right.

    Beyond that it repeats.
    """
    tints: Array
    """(n, 3), RGB in [0, 1]."""
    texture_of_quad: NDArray[np.int64]
    """(n,): index into `textures`, or PLAIN."""
    textures: tuple[Texture, ...]
    sky: Array
    """(3,), RGB in [0, 1]: where there is no quad."""
    problems: tuple[str, ...]
    """One line for each texture that is shown as a plain colour, with the reason."""


def build_scene(
    world: World, assets: Mapping[str, bytes], entities: Iterable[Entity] = ()
) -> Scene:
    """The scene of a world's walls and floor and of the panels in it.

    `assets` are PNG files by their sha256. A surface whose texture is missing or damaged gets its
    plain colour, and a line in `problems`.
    """
    builder = _Builder(world, assets)
    materials = {material.name: material for material in world.materials}
    for wall in world.walls:
        material = materials.get(wall.material)
        if material is None:
            builder.problem(f"wall {wall.name}: material {wall.material!r} is not in the world")
        builder.add_wall(wall, material or _UNKNOWN_MATERIAL)
    for entity in entities:
        builder.add_panel(entity)
    builder.add_floor(materials.get(world.floor_material, _UNKNOWN_MATERIAL).diffuse)
    return builder.scene()


def decode_png(data: bytes) -> NDArray[np.uint8]:
    """The picture in a PNG file: (h, w, 3) uint8 RGB, read-only.

    Raises ValueError, with a phrase that says what is wrong, where it is no whole PNG of at most
    2048 x 2048. Decoders fill in for a damaged file silently: so every chunk's checksum is looked
    at first.
    """
    _check_png(data)
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if bgr is None:
        raise ValueError("cannot be decoded")
    rgb = np.ascontiguousarray(bgr[:, :, ::-1], np.uint8)
    rgb.setflags(write=False)
    return rgb


def _check_png(data: bytes) -> None:
    if not data.startswith(_PNG_SIGNATURE):
        raise ValueError("is no PNG")
    at, kind = len(_PNG_SIGNATURE), b""
    while kind != b"IEND":
        if at + 12 > len(data):
            raise ValueError("is cut short")
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            raise ValueError("is cut short")
        if zlib.crc32(data[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            raise ValueError("is damaged")
        if at == len(_PNG_SIGNATURE):
            if kind != b"IHDR" or length != 13:
                raise ValueError("is no PNG")
            width, height = struct.unpack_from(">II", data, at + 8)
            if not (0 < width <= MAX_TEXTURE_SIDE_PX and 0 < height <= MAX_TEXTURE_SIDE_PX):
                limit = MAX_TEXTURE_SIDE_PX
                raise ValueError(f"is {width} x {height}: at most {limit} x {limit}")
        at = end + 4


@functools.lru_cache(maxsize=64)
def _decoded(sha256: str, data: bytes) -> NDArray[np.uint8] | str:
    """The picture, or what is wrong. Cached: each entity that comes or goes makes a new scene."""
    if hashlib.sha256(data).hexdigest() != sha256:
        return "does not have that sha256"
    try:
        return decode_png(data)
    except ValueError as error:
        return str(error)


_UP: Array = np.array([0.0, 0.0, 1.0])
_UNIT_UVS: Array = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])


@dataclass(frozen=True, eq=False)
class _Side:
    """An upright face of a wall. Places along it are metres to the right of its middle."""

    bottom_centre_m: Array
    normal: Array
    right: Array
    width_m: float
    height_m: float
    tint: Array
    texture: str
    tile_side_m: float

    def corners_m(self, left_m: float, right_m: float) -> Array:
        half_up = self.height_m / 2.0 * _UP
        centre = self.bottom_centre_m + (left_m + right_m) / 2.0 * self.right + half_up
        return _rectangle(centre, (right_m - left_m) / 2.0 * self.right, half_up)

    def uvs(self, left_m: float, right_m: float) -> Array:
        """Tiles from the bottom left; v counts down from a whole number, to stay positive."""
        left, right = (
            max(place + self.width_m / 2.0, 0.0) / self.tile_side_m for place in (left_m, right_m)
        )
        bottom = math.ceil(self.height_m / self.tile_side_m)
        top = bottom - self.height_m / self.tile_side_m
        return np.array([[left, bottom], [right, bottom], [right, top], [left, top]])


def _uncovered(sides: list[_Side]) -> Iterator[tuple[_Side, float, float]]:
    """The stretches of each face, from left to right, that no other face lies upon.

    Walls overlap where they meet, and faces in one plane would both be drawn there, in a mix of
    stripes. The higher face wins, and the earlier among equals.
    """
    if not sides:
        return
    ranked = sorted(sides, key=lambda side: -side.height_m)
    normals = np.array([side.normal for side in ranked])
    rights = np.array([side.right for side in ranked])
    centres = np.array([side.bottom_centre_m for side in ranked])
    halves = np.array([side.width_m for side in ranked]) / 2.0
    for rank, side in enumerate(ranked):
        to_others = centres[:rank] - side.bottom_centre_m
        in_plane = (normals[:rank] @ side.normal > 1.0 - _PARALLEL) & (
            np.abs(to_others @ side.normal) < _SAME_PLANE_M
        )
        pieces = [(-side.width_m / 2.0, side.width_m / 2.0)]
        for other in np.flatnonzero(in_plane):
            middle = float(to_others[other] @ rights[other])
            low, high = middle - float(halves[other]), middle + float(halves[other])
            pieces = [
                piece
                for left, right in pieces
                for piece in ((left, min(right, low)), (max(left, high), right))
                if piece[1] - piece[0] > _SLIVER_M
            ]
        for left, right in pieces:
            yield side, left, right


class _Builder:
    def __init__(self, world: World, assets: Mapping[str, bytes]) -> None:
        self._assets = assets
        self._world = world
        self._textures: dict[str, Texture] = {}
        self._problems: dict[str, None] = {}
        self._sides: list[_Side] = []
        self._corners: list[Array] = []
        self._uvs: list[Array] = []
        self._tints: list[Array] = []
        self._quad_textures: list[str] = []
        norm = math.hypot(*world.light_direction)
        self._towards_light = -np.array(world.light_direction) / (norm or 1.0)

    def problem(self, line: str) -> None:
        self._problems[line] = None

    def add_wall(self, wall: Wall, material: Material) -> None:
        """The four sides and the top of a wall's box; nobody sees its bottom."""
        map_from_wall = wall.map_from_wall().matrix()
        half = np.array([wall.length_m, wall.thickness_m]) / 2.0
        texture = self._texture(material.texture_sha256, f"material {material.name}")
        ambient, diffuse = (_WHITE, _WHITE) if texture else (material.ambient, material.diffuse)
        for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
            normal = sign * map_from_wall[:3, axis]
            self._sides.append(
                _Side(
                    bottom_centre_m=map_from_wall[:3, 3] + half[axis] * normal,
                    normal=normal,
                    right=np.cross(_UP, normal),
                    width_m=2.0 * float(half[1 - axis]),
                    height_m=wall.height_m,
                    tint=self._lit(normal, ambient, diffuse),
                    texture=texture,
                    tile_side_m=material.texture_side_m,
                )
            )
        top = _rectangle(
            map_from_wall[:3, 3] + wall.height_m * _UP,
            half[0] * map_from_wall[:3, 0],
            half[1] * map_from_wall[:3, 1],
        )
        self._add(top, _UNIT_UVS, self._lit(_UP, material.ambient, material.diffuse), "")

    def add_panel(self, entity: Entity) -> None:
        """A panel's front, not lit, so that its black stays black, and its plain back."""
        map_from_panel = transform_matrix(
            rotation_from_quaternion(*entity.orientation_xyzw), entity.position_m
        )
        half = entity.panel_side_m / 2.0
        up = np.array([0.0, half, 0.0])
        front = _moved(map_from_panel, _rectangle(np.zeros(3), np.array([half, 0.0, 0.0]), up))
        back = _moved(map_from_panel, _rectangle(np.zeros(3), np.array([-half, 0.0, 0.0]), up))
        textured = self._texture(entity.texture_sha256, f"entity {entity.name}")
        self._add(front, _UNIT_UVS, np.array((_WHITE if textured else PANEL_BACK)[:3]), textured)
        self._add(back, _UNIT_UVS, np.array(PANEL_BACK[:3]), "")

    def add_floor(self, diffuse: Rgba) -> None:
        half = FLOOR_SIDE_M / 2.0
        floor = _rectangle(np.zeros(3), np.array([half, 0.0, 0.0]), np.array([0.0, half, 0.0]))
        self._add(floor, _UNIT_UVS, self._lit(_UP, diffuse, diffuse), "")

    def scene(self) -> Scene:
        for side, left_m, right_m in _uncovered(self._sides):
            self._add(
                side.corners_m(left_m, right_m), side.uvs(left_m, right_m), side.tint, side.texture
            )
        index_of = {sha256: index for index, sha256 in enumerate(self._textures)}
        return Scene(
            corners_m=np.array(self._corners),
            uvs=np.array(self._uvs),
            tints=np.array(self._tints),
            texture_of_quad=np.array([index_of.get(sha, PLAIN) for sha in self._quad_textures]),
            textures=tuple(self._textures.values()),
            sky=np.clip(np.array(self._world.sky[:3]), 0.0, 1.0),
            problems=tuple(self._problems),
        )

    def _add(self, corners_m: Array, uvs: Array, tint: Array, texture: str) -> None:
        self._corners.append(corners_m)
        self._uvs.append(uvs)
        self._tints.append(tint)
        self._quad_textures.append(texture)

    def _texture(self, sha256: str, owner: str) -> str:
        """The texture's sha256 where it can be shown, else the empty string."""
        if not sha256 or sha256 in self._textures:
            return sha256
        data = self._assets.get(sha256)
        picture = _decoded(sha256, data) if data is not None else "is not there"
        if isinstance(picture, str):
            self.problem(f"{owner}: texture {sha256:.12} {picture}; shown as a plain colour")
            return ""
        self._textures[sha256] = Texture(sha256, picture)
        return sha256

    def _lit(self, normal: Array, ambient: Rgba, diffuse: Rgba) -> Array:
        """Colour of a face under the world's ambient and directional light (Lambert).

        Exposed so that an upright white face towards the light is just white: no wall's colours
        are cut off.
        """
        light_ambient = max(self._world.light_ambient, 0.0)
        light_diffuse = max(self._world.light_diffuse, 0.0)
        facing = max(float(normal @ self._towards_light), 0.0)
        colour = light_ambient * np.array(ambient[:3])
        colour = colour + light_diffuse * facing * np.array(diffuse[:3])
        sideways = math.hypot(self._towards_light[0], self._towards_light[1])
        brightest = light_ambient + light_diffuse * sideways
        return np.clip(colour / (brightest or 1.0), 0.0, 1.0)


def _rectangle(centre: Array, half_right: Array, half_up: Array) -> Array:
    """(4, 3) corners, counter-clockwise from the bottom left."""
    return np.array(
        [
            centre - half_right - half_up,
            centre + half_right - half_up,
            centre + half_right + half_up,
            centre - half_right + half_up,
        ]
    )


def _moved(a_from_b: Array, points: Array) -> Array:
    return points @ a_from_b[:3, :3].T + a_from_b[:3, 3]

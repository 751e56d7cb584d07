"""The scene for the camera: a world and its entities as lit, textured triangles for any renderer.

Sun and ambient light are already in the vertices' tints, so that every renderer shows the same
colours; lamps are left to the renderer, since a lamp's light changes across a wall. There are no
shadows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array, pose_matrix
from mazebot.common.messages.documents import (
    BodyEntity,
    Entity,
    MarkerEntity,
    Material,
    PointLight,
    Rgba,
    Thing,
    World,
)
from mazebot.common.world.assets import mesh_sha256s
from mazebot.common.world.geometry import TriangleMesh, joined, quad_triangles
from mazebot.common.world.surfaces import PLAIN as PLAIN_MATERIAL
from mazebot.common.world.surfaces import Surface, body_surfaces, surfaces
from mazebot.physics.assets import decoded_mesh, decoded_png

MAX_LAMPS = 8
PLAIN = -1
"""Texture index of a part that has none."""
STATIC = -1
"""Mover index of a static part."""

PANEL_BACK: Rgba = (0.45, 0.45, 0.45, 1.0)
"""Colour of a panel's back, and of a front without its texture: nothing a detector could read."""

_UNKNOWN_MATERIAL = Material(name="")
_WHITE: Rgba = (1.0, 1.0, 1.0, 1.0)
_PANEL_UVS: Array = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Texture:
    """An image to map on triangles."""

    sha256: str
    """Of the PNG file's bytes: two textures with the same one are the same."""
    pixels: NDArray[np.uint8]
    """(h, w, 3), RGB, top row first, read-only."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Runs of triangles with one look, (p,) each."""

    first: NDArray[np.int64]
    """Index of its first triangle."""
    count: NDArray[np.int64]
    texture: NDArray[np.int64]
    """Index into `textures`, or PLAIN."""
    mover: NDArray[np.int64]
    """Index into `movers`, or STATIC."""
    smooth: NDArray[np.bool_]
    """Normals, and with them tints, differ within a triangle."""
    quad: NDArray[np.bool_]
    """Two triangles of a static, flat rectangle."""
    background: NDArray[np.bool_]
    """Floor or ceiling: wide, and behind most else."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Triangles seen from their front only, in the map frame or in that of a moving body.

    A pixel's colour is its tint times the texture there. The tint of static parts is in `tints`; to
    that of moving parts albedo times the sun's light on them is added, and to both the light of the
    lamps.
    """

    vertices_m: Array
    """(n, 3)"""
    normals: Array
    """(n, 3), of unit length"""
    uvs: Array
    """(n, 2): (0, 0) is a texture's top left, (1, 1) its bottom right. Beyond that it repeats."""
    tints: Array
    """(n, 3), RGB in [0, 1]"""
    albedos: Array
    """(n, 3), RGB: reflected share of a light's strength; zero for unlit triangles."""
    triangles: NDArray[np.int32]
    """(m, 3), counter-clockwise from the front"""
    parts: Parts
    textures: tuple[Texture, ...]
    movers: tuple[str, ...]
    """Names of the moving bodies."""
    map_from_movers: Array
    """(k, 4, 4): their poses at the start."""
    sun: Array
    """(3,): towards the sun; its length is the sun's strength."""
    lamps: tuple[PointLight, ...]
    sky: Array
    """(3,), RGB in [0, 1]: where there is no triangle."""
    problems: tuple[str, ...]
    """One line for each part that is not shown as it should be, with the reason."""


def build_scene(
    world: World,
    assets: Mapping[str, bytes],
    entities: Iterable[Entity] = (),
    seen: Sequence[Surface] | None = None,
) -> Scene:
    """The scene of a world and its entities; moving entities come after the world's moving bodies.

    `assets` are PNG files and meshes by their sha256. A surface whose texture is missing or damaged
    gets its plain colour, and a line in `problems`; a missing mesh is not shown. `seen` are the
    world's surfaces, if they are already computed.
    """
    builder = _Builder(world, assets)
    for surface in seen if seen is not None else builder.surfaces():
        builder.add_surface(surface)
    for entity in entities:
        if isinstance(entity, MarkerEntity):
            builder.add_panel(entity)
        else:
            builder.add_body(entity)
    return builder.scene()


def lamp_light(scene: Scene, places_m: Array, normals: Array) -> Array:
    """(n, 3): strength of the lamps' light at positions in the map, after Lambert."""
    light = np.zeros((len(places_m), 3))
    for lamp in scene.lamps:
        to_lamp = np.array(lamp.position_m) - places_m
        distance = portable.lengths(to_lamp)
        facing = np.einsum("ij,ij->i", to_lamp, normals) / np.maximum(distance, 1e-6)
        fade = lamp.constant + lamp.linear * distance + lamp.quadratic * portable.square(distance)
        strength = np.maximum(facing, 0.0) / np.maximum(fade, 1e-6)
        strength[distance > lamp.range_m] = 0.0
        light += strength[:, None] * np.array(lamp.diffuse[:3])
    return light


@dataclass(frozen=True)
class _Look:
    """Appearance of one mesh of the scene."""

    ambient: Rgba
    diffuse: Rgba
    lit: bool
    texture: str
    mover: int
    in_quads: bool
    background: bool


def _by_name(materials: Iterable[Material]) -> dict[str, Material]:
    return {material.name: material for material in materials}


class _Builder:
    def __init__(self, world: World, assets: Mapping[str, bytes]) -> None:
        self._assets = assets
        self._world = world
        self._textures: dict[str, Texture] = {}
        self._problems: dict[str, None] = {}
        self._materials = _by_name(world.materials)
        self._meshes: list[TriangleMesh] = []
        self._looks: list[_Look] = []
        self._movers: dict[str, int] = {}
        """Indices of the moving bodies, by name"""
        self._map_from_movers: list[Array] = []
        """Their poses at the start"""
        for body in world.bodies:
            self._add_mover(body)
        norm = math.hypot(*world.light_direction)
        self._towards_light = -np.array(world.light_direction) / (norm or 1.0)

    def surfaces(self) -> tuple[Surface, ...]:
        return surfaces(self._world, self._meshes_of(self._world.bodies))

    def _add_mover(self, body: Thing) -> None:
        if body.moves:
            self._movers[body.name] = len(self._movers)
            self._map_from_movers.append(pose_matrix(body))

    def _meshes_of(self, bodies: Iterable[Thing]) -> dict[str, TriangleMesh]:
        return {
            sha256: self._mesh(sha256, body.name)
            for body in bodies
            for sha256 in mesh_sha256s([body])
        }

    def _mesh(self, sha256: str, body: str) -> TriangleMesh:
        try:
            return decoded_mesh(sha256, self._assets[sha256])
        except KeyError:
            reason = "is missing"
        except ValueError as error:
            reason = str(error)
        self._problems[f"body {body}: mesh {sha256:.12} {reason}; not shown"] = None
        return joined(())

    def add_body(self, entity: BodyEntity) -> None:
        """Add a body with its own materials."""
        self._add_mover(entity)
        tiles = {material.name: material.texture_side_m for material in entity.materials}
        meshes = self._meshes_of([entity])
        for surface in body_surfaces(entity, meshes, tiles, moves=entity.moves):
            self.add_surface(surface, _by_name(entity.materials))

    def add_surface(
        self, surface: Surface, materials: Mapping[str, Material] | None = None
    ) -> None:
        """Add triangles of the world, or of an entity with its own materials."""
        material = (self._materials if materials is None else materials).get(surface.material)
        if material is None:
            material = _UNKNOWN_MATERIAL if surface.material else PLAIN_MATERIAL
            if surface.material:
                owner = f"{surface.kind} {surface.name}".rstrip()
                line = f"{owner}: material {surface.material!r} is not in the world"
                self._problems[line] = None
        owner = f"material {material.name}"
        texture = self._texture(material.texture_sha256, owner) if surface.textured else ""
        self._meshes.append(surface.mesh)
        self._looks.append(
            _Look(
                ambient=_WHITE if texture else material.ambient,
                diffuse=_WHITE if texture else material.diffuse,
                lit=True,
                texture=texture,
                mover=self._movers[surface.name] if surface.moves else STATIC,
                in_quads=surface.kind == "wall",
                background=surface.kind in ("floor", "ceiling"),
            )
        )

    def add_panel(self, entity: MarkerEntity) -> None:
        """Add a panel's front, unlit, so that its black stays black, and its plain back."""
        map_from_panel = pose_matrix(entity)
        texture = self._texture(entity.texture_sha256, f"entity {entity.name}")
        half = entity.panel_side_m / 2.0
        for sign, picture in ((1.0, texture), (-1.0, "")):
            corners = half * np.array(
                [[-sign, -1.0, 0.0], [sign, -1.0, 0.0], [sign, 1.0, 0.0], [-sign, 1.0, 0.0]]
            )
            normals = np.tile((0.0, 0.0, sign), (4, 1))
            side = TriangleMesh(corners, normals, _PANEL_UVS, quad_triangles(1))
            colour = _WHITE if picture else PANEL_BACK
            self._meshes.append(side.moved(map_from_panel))
            self._looks.append(_Look(colour, colour, False, picture, STATIC, True, False))

    def scene(self) -> Scene:
        whole = joined(self._meshes)
        looks = self._looks
        sizes = np.array([len(mesh.vertices_m) for mesh in self._meshes], np.int64)
        ambient = np.repeat(np.array([look.ambient[:3] for look in looks]), sizes, axis=0)
        diffuse = np.repeat(np.array([look.diffuse[:3] for look in looks]), sizes, axis=0)
        lit = np.repeat([look.lit for look in looks], sizes)
        moving = np.repeat([look.mover != STATIC for look in looks], sizes)
        world = self._world
        light_ambient = max(world.light_ambient, 0.0)
        light_diffuse = max(world.light_diffuse, 0.0)
        exposure = self._exposure(light_ambient, light_diffuse)
        facing = np.where(
            moving, 0.0, np.maximum(portable.product(whole.normals, self._towards_light), 0.0)
        )
        tints = (light_ambient * ambient + light_diffuse * facing[:, None] * diffuse) / exposure
        tints[~lit] = ambient[~lit]
        if len(world.lights) > MAX_LAMPS:
            self._problems[f"lights: {len(world.lights)}: only the first {MAX_LAMPS} are used"] = (
                None
            )
        return Scene(
            vertices_m=whole.vertices_m,
            normals=whole.normals,
            uvs=whole.uvs,
            tints=np.clip(tints, 0.0, 1.0),
            albedos=np.where(lit[:, None], diffuse / exposure, 0.0),
            triangles=whole.triangles,
            parts=self._parts(whole),
            textures=tuple(self._textures.values()),
            movers=tuple(self._movers),
            map_from_movers=np.array(self._map_from_movers).reshape(-1, 4, 4),
            sun=light_diffuse * self._towards_light,
            lamps=world.lights[:MAX_LAMPS],
            sky=np.clip(np.array(world.sky[:3]), 0.0, 1.0),
            problems=tuple(self._problems),
        )

    def _exposure(self, light_ambient: float, light_diffuse: float) -> float:
        """Divisor of the light, so that an upright white face towards the sun is just white: no
        wall's colours are clipped.

        With lamps it is at least 1: parts that they do not reach may be dark.
        """
        sideways = math.hypot(self._towards_light[0], self._towards_light[1])
        brightest = light_ambient + light_diffuse * sideways
        return max(brightest, 1.0) if self._world.lights else brightest or 1.0

    def _parts(self, whole: TriangleMesh) -> Parts:
        corners = whole.normals[whole.triangles]
        bent = (corners != corners[:, :1]).any(axis=(1, 2))
        index_of = {sha256: index for index, sha256 in enumerate(self._textures)}
        rows: list[tuple[int, int, int, int, bool, bool, bool]] = []
        first = 0
        for mesh, look in zip(self._meshes, self._looks, strict=True):
            count = len(mesh.triangles)
            texture = index_of.get(look.texture, PLAIN)
            if look.in_quads:
                rows += [
                    (at, 2, texture, STATIC, False, True, False)
                    for at in range(first, first + count, 2)
                ]
            elif count:
                smooth = bool(bent[first : first + count].any())
                rows.append((first, count, texture, look.mover, smooth, False, look.background))
            first += count
        table = np.array(rows, np.int64).reshape(-1, 7)
        return Parts(*table[:, :4].T, *(table[:, 4:].T > 0))

    def _texture(self, sha256: str, owner: str) -> str:
        """The texture's sha256 if it can be shown, else the empty string."""
        if not sha256 or sha256 in self._textures:
            return sha256
        data = self._assets.get(sha256)
        picture = decoded_png(sha256, data) if data is not None else "is missing"
        if isinstance(picture, str):
            line = f"{owner}: texture {sha256:.12} {picture}; shown as a plain colour"
            self._problems[line] = None
            return ""
        self._textures[sha256] = Texture(sha256, picture)
        return sha256

"""The drawn parts of a world; parts that users hide are separate from the rest."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths.frames import MAP_FRAME, Array
from mazebot.common.messages.documents import (
    BodyEntity,
    Material,
    Mesh,
    Thing,
    World,
)
from mazebot.common.world.geometry import (
    TriangleMesh,
    clipped,
    flat_triangles,
    joined,
    quad_triangles,
)
from mazebot.common.world.surfaces import Surface, body_surfaces, surfaces, wall_corners
from mazebot.recorder.judging.obstacles import read_meshes

CUT_M = 1.0
"""Walls and bodies are drawn in two parts, so that the upper one can be hidden to look inside."""
_FLOOR_MARGIN_M = 0.8
_FLOOR_Z_M = -0.01
"""Below the map, the costmap and the paths, which are drawn on it."""
_TOP_SHADE = 0.85
_FLAT_M = 0.05
"""Surfaces that end this low are ground, and do not extend the view."""
_NEXT_AXES = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""Turns (x, y, z) to (y, z, x)."""

Heights = tuple[float, float]
"""Lower and upper bound, metres above the floor."""
_WHOLE: Heights = (-np.inf, np.inf)
_LOWER: Heights = (-np.inf, CUT_M)
_UPPER: Heights = (CUT_M, np.inf)

Extent = tuple[Array, Array]
"""The least and the greatest (x, y), metres."""


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles of one material on one entity."""

    path: tuple[str, ...]
    """Of the entity path, below `world`."""
    material: str
    """Its name; empty: `surfaces.PLAIN`."""
    textured: bool
    frame: str
    """Frame of the triangles: the map, or that of a moving body."""
    mesh: TriangleMesh


def extent_of(world: World, meshes: Mapping[str, TriangleMesh]) -> Extent:
    """Bounds of everything that `parts` draws."""
    return _extent(world, _seen(world, meshes))


def parts(world: World, meshes: Mapping[str, TriangleMesh]) -> list[Part]:
    """Everything to draw. `meshes` are by sha256; bodies that lack one are left out."""
    seen = _seen(world, meshes)
    extent = _extent(world, seen)
    groups: dict[tuple[tuple[str, ...], str], tuple[Surface, Heights, list[TriangleMesh]]] = {}
    for surface, path, heights, mesh in _placed(world, seen, extent):
        groups.setdefault((path, surface.material), (surface, heights, []))[2].append(mesh)
    found = []
    for (path, material), (surface, heights, of_one) in groups.items():
        mesh = _between(of_one, heights)
        if len(mesh.triangles):
            frame = surface.name if surface.moves else MAP_FRAME
            found.append(Part(path, material, surface.textured, frame, mesh))
    return found


def _seen(world: World, meshes: Mapping[str, TriangleMesh]) -> tuple[Surface, ...]:
    bodies = tuple(body for body in world.bodies if seen_meshes(body) <= meshes.keys())
    return surfaces(world.model_copy(update={"bodies": bodies}), meshes)


def seen_meshes(body: Thing) -> set[str]:
    """The meshes, by sha256, that are needed to draw a body."""
    return {
        shape.geometry.sha256
        for shape in body.shapes
        if shape.material and isinstance(shape.geometry, Mesh)
    }


def entity_parts(entity: BodyEntity, frame: str, assets: Mapping[str, bytes]) -> list[Part]:
    """The drawn parts of an entity, below its name; empty while a mesh is missing."""
    meshes = read_meshes([entity], assets)
    if not seen_meshes(entity) <= meshes.keys():
        return []
    tile_of = {material.name: material.texture_side_m for material in entity.materials}
    return [
        Part((surface.material,), surface.material, surface.textured, frame, surface.mesh)
        for surface in body_surfaces(entity, meshes, tile_of, moves=True)
    ]


def _placed(
    world: World, seen: tuple[Surface, ...], extent: Extent
) -> Iterator[tuple[Surface, tuple[str, ...], Heights, TriangleMesh]]:
    """Each surface with its entity path and its height range; surfaces cut at CUT_M come twice."""
    for surface in (*seen, *_lids(world, seen)):
        material = surface.material or "plain"
        if surface.moves:
            yield surface, ("moving", surface.name, material), _WHOLE, surface.mesh
        elif surface.kind == "floor":
            where = ("rooms", surface.name, "floor") if surface.name else ("floor",)
            yield surface, where, _WHOLE, _cropped(surface.mesh, extent)
        elif surface.kind == "ceiling":
            yield surface, ("ceiling",), _WHOLE, surface.mesh
        else:
            kind = "walls" if surface.kind == "wall" else "bodies"
            name = (material,) if surface.textured else (material, "top")
            yield surface, (kind, *name), _LOWER, surface.mesh
            if surface.mesh.vertices_m[:, 2].max(initial=0.0) > CUT_M:
                yield surface, (f"{kind}_above", *name), _UPPER, surface.mesh


def _between(meshes: Iterable[TriangleMesh], heights: Heights) -> TriangleMesh:
    """Everything between two heights as one mesh; only what crosses one is clipped, all at once."""
    whole: list[TriangleMesh] = []
    cut: list[TriangleMesh] = []
    for mesh in meshes:
        z_m = mesh.vertices_m[:, 2]
        within = not len(z_m) or (heights[0] <= z_m.min() and z_m.max() <= heights[1])
        (whole if within else cut).append(mesh)
    return joined([*whole, clipped(joined(cut), *heights)] if cut else whole)


def _lids(world: World, seen: tuple[Surface, ...]) -> Iterator[Surface]:
    """Caps of cut walls and bodies, so that they do not look hollow."""
    high = [wall for wall in world.walls if wall.height_m > CUT_M]
    for material in dict.fromkeys(wall.material for wall in high):
        corners = wall_corners([wall for wall in high if wall.material == material]).reshape(-1, 2)
        yield _lid("wall", material, corners, quad_triangles(len(corners) // 4))
    for surface in seen:
        if surface.kind == "body" and not surface.moves:
            corners, triangles = flat_triangles(_section(surface.mesh))
            yield _lid("body", surface.material, corners, triangles)


def _lid(
    kind: Literal["wall", "body"], material: str, corners: Array, triangles: NDArray[np.int32]
) -> Surface:
    count = len(corners)
    positions = np.column_stack([corners, np.full(count, CUT_M)])
    normals = np.tile((0.0, 0.0, 1.0), (count, 1))
    mesh = TriangleMesh(positions, normals, np.zeros((count, 2)), triangles)
    return Surface(kind, "", material, False, False, mesh)


def _section(mesh: TriangleMesh) -> shapely.MultiPolygon:
    """The cross-section of a closed surface at the cut; empty if the surface is open."""
    z = mesh.vertices_m[mesh.triangles][..., 2]
    crossing = (z.min(axis=1) <= CUT_M) & (z.max(axis=1) > CUT_M)
    corners = mesh.vertices_m[mesh.triangles[crossing]]
    above = corners[..., 2] > CUT_M
    if not len(corners):
        return shapely.MultiPolygon()
    # Two sides of each such triangle cross: the vertex between them is alone on its side.
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    rows = np.arange(len(corners))
    tip = corners[rows, alone]
    ends = []
    for step in (1, 2):
        other = corners[rows, (alone + step) % 3]
        share = (CUT_M - tip[:, 2]) / (other[:, 2] - tip[:, 2])
        ends.append(tip[:, :2] + share[:, None] * (other - tip)[:, :2])
    # Neighbours compute the same point, up to rounding.
    segments = np.round(np.stack(ends, axis=1), 6)
    segments = segments[(segments[:, 0] != segments[:, 1]).any(axis=1)]
    area = shapely.build_area(shapely.multilinestrings(shapely.linestrings(segments)))
    parts_of_area = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
    return shapely.MultiPolygon(parts_of_area)


def _extent(world: World, seen: tuple[Surface, ...]) -> Extent:
    """From the least to the greatest (x, y) of all entities, and of the named locations."""
    places = (world.start, *world.locations)
    points = [np.array([(place.x_m, place.y_m) for place in places])]
    points.append(wall_corners(world.walls).reshape(-1, 2))
    for surface in seen:
        if surface.kind == "body" and not surface.moves and len(surface.mesh.vertices_m):
            vertices = surface.mesh.vertices_m
            if float(vertices[:, 2].max()) > _FLAT_M:
                points.append(vertices[:, :2])
    corners = np.concatenate(points)
    return corners.min(axis=0), corners.max(axis=0)


def _cropped(mesh: TriangleMesh, extent: Extent) -> TriangleMesh:
    """The floor around the walls and bodies, slightly lowered."""
    lowered = np.eye(4)
    lowered[2, 3] = _FLOOR_Z_M
    mesh = mesh.moved(lowered)
    for low, high in zip(*extent, strict=True):
        # Rotate the axes: surfaces can only be clipped along z.
        turned = mesh.moved(_NEXT_AXES)
        mesh = clipped(turned, low - _FLOOR_MARGIN_M, high + _FLOOR_MARGIN_M)
    return mesh.moved(_NEXT_AXES)


def plain_rgba(material: Material, part: Part) -> tuple[int, int, int, int]:
    """The colour of an untextured part, 0 to 255; tops are darkened."""
    shade = 1.0 if part.textured else _TOP_SHADE
    red, green, blue, alpha = material.diffuse
    colour = np.array([red * shade, green * shade, blue * shade, alpha])
    r, g, b, a = np.clip(np.round(255.0 * colour), 0, 255).astype(int).tolist()
    return r, g, b, a

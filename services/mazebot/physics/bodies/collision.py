"""The solids of a body for PyBullet's collisions, and the body's inertia."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array, pose_matrix, transform_matrix
from mazebot.common.messages.documents import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Mesh,
    Plane,
    Polyline,
    Shape,
    Sphere,
    Thing,
)
from mazebot.common.world.convex.convex_parts import convex_parts, most_parts
from mazebot.common.world.convex.loose_triangles import hull_of
from mazebot.common.world.geometry import TriangleMesh, flat_triangles, polygons_of, triangles_of
from mazebot.common.world.surfaces import is_floor

MAX_HULL_POINTS = 256
"""Of a convex body; of more points, the farthest in each of so many directions is kept."""
MAX_PART_POINTS = 64
"""The same of one of several convex parts: of 20 tori, steps take half as long."""
_MAX_PRISMS = 64
_MAX_TRIANGLES = 20_000
"""Of one PyBullet shape: it fails silently from 131,072 vertices on."""
_PLANE_THICKNESS_M = 0.02


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex piece of a body, or a surface that never moves."""

    kind: Literal["box", "cylinder", "sphere", "capsule", "ellipsoid", "hull", "triangles"]
    body_from_solid: Array
    half_extents_m: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Of a box; of an ellipsoid its radii"""
    radius_m: float = 1.0
    length_m: float = 1.0
    """Along z; of a capsule without its ends."""
    vertices_m: Array | None = None
    """(n, 3), of hull and triangles; of an ellipsoid the corners of the hull that collides"""
    triangles: NDArray[np.int32] | None = None


@dataclass(frozen=True, eq=False)
class Inertia:
    """Of a body of uniform density."""

    body_from_com: Array
    """Origin at the centre of mass, along the principal axes."""
    diagonal_kg_m2: tuple[float, float, float]


def solids_of(body: Thing, meshes: Mapping[str, TriangleMesh]) -> list[Solid]:
    """The solid pieces of a body, as they collide.

    Each piece of a moving body is convex: a mesh becomes its convex parts. A static body may be
    hollow: its meshes and polylines are surfaces. A level plane on the floor is the floor, and no
    solid itself. Raises ValueError, in a phrase, for a shape that has no extent.
    """
    most = most_parts(body) if body.moves else 0
    return [piece for shape in _solid(body) for piece in _solids(shape, meshes, most)]


def seen_solids_of(
    body: Thing, meshes: Mapping[str, TriangleMesh], solids: Sequence[Solid]
) -> Sequence[Solid]:
    """The same as the lidar sees them: meshes, polylines and planes are surfaces, also if they
    move. The very `solids`, as they collide, where those are all that.
    """
    shapes = _solid(body)
    if not body.moves and not any(isinstance(shape.geometry, Plane) for shape in shapes):
        return solids
    seen: list[Solid] = []
    for shape in shapes:
        if isinstance(shape.geometry, Plane):
            seen += _surface(pose_matrix(shape), triangles_of(shape.geometry, {}))
        else:
            seen += _solids(shape, meshes, 0)
    return seen


def _solid(body: Thing) -> list[Shape]:
    return [shape for shape in body.shapes if shape.solid and not is_floor(body, shape)]


def extent_of(solids: Iterable[Solid], a_from_body: Array) -> tuple[Array, Array]:
    """Lowest and highest coordinates, (3,) each, in a frame a; both zero where there is nothing.

    A round solid counts as its bounding box.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for solid in solids:
        points = solid.vertices_m if solid.vertices_m is not None else _box_corners(solid)
        pose = portable.product(a_from_body, solid.body_from_solid)
        moved = portable.product(points, pose[:3, :3].T) + pose[:3, 3]
        low, high = np.minimum(low, moved.min(0)), np.maximum(high, moved.max(0))
    return (low, high) if (low <= high).all() else (np.zeros(3), np.zeros(3))


def _box_corners(solid: Solid) -> Array:
    """(8, 3) corners of its bounding box, in its own frame."""
    radius_m, half_m = solid.radius_m, solid.length_m / 2.0
    half = {
        "sphere": (radius_m, radius_m, radius_m),
        "cylinder": (radius_m, radius_m, half_m),
        "capsule": (radius_m, radius_m, half_m + radius_m),
    }.get(solid.kind, solid.half_extents_m)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    return signs * half


def inertia_of(body: Thing, meshes: Mapping[str, TriangleMesh]) -> Inertia:
    """Centre of mass and moments of inertia of a moving body's solid shapes.

    By the integrals over the tetrahedra from the origin to each triangle (Blow and Binstock, 2004).
    Raises ValueError, in a phrase, if they have no volume.
    """
    volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for shape in body.shapes:
        if shape.solid:
            corners = _closed(shape, meshes, most_parts(body))
            six_volumes = portable.determinants(corners)
            sums = corners.sum(axis=1)
            volume += float(six_volumes.sum()) / 6.0
            first += portable.product(six_volumes, sums) / 24.0
            second += np.einsum("i,ija,ijb->ab", six_volumes, corners, corners) / 120.0
            second += np.einsum("i,ia,ib->ab", six_volumes, sums, sums) / 120.0
    if not volume > 1e-12:
        raise ValueError("has no volume")
    centre = first / volume
    spread = body.mass_kg * (second / volume - np.outer(centre, centre))
    moments, axes = portable.eigh(np.trace(spread) * np.eye(3) - spread)
    if portable.determinants(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    x, y, z = (max(float(moment), 1e-9) for moment in moments)
    cx, cy, cz = centre.tolist()
    return Inertia(transform_matrix(axes, (cx, cy, cz)), (x, y, z))


def _solids(shape: Shape, meshes: Mapping[str, TriangleMesh], most: int) -> Iterator[Solid]:
    """A mesh in at most so many convex parts; as a surface, if 0."""
    pose, geometry = pose_matrix(shape), shape.geometry
    match geometry:
        case Box():
            x, y, z = geometry.size_m
            yield Solid("box", pose, half_extents_m=(x / 2.0, y / 2.0, z / 2.0))
        case Sphere():
            yield Solid("sphere", pose, radius_m=geometry.radius_m)
        case Cylinder():
            yield Solid("cylinder", pose, radius_m=geometry.radius_m, length_m=geometry.length_m)
        case Capsule():
            yield Solid("capsule", pose, radius_m=geometry.radius_m, length_m=geometry.length_m)
        case Plane():
            x, y = geometry.size_m
            lower = transform_matrix(np.eye(3), (0.0, 0.0, -_PLANE_THICKNESS_M / 2.0))
            size = (x / 2.0, y / 2.0, _PLANE_THICKNESS_M / 2.0)
            yield Solid("box", portable.product(pose, lower), half_extents_m=size)
        case Ellipsoid():
            radii_m = np.array(geometry.radii_m)[:, None]
            towards = radii_m * _spiral(MAX_HULL_POINTS)
            # The farthest point of an ellipsoid in each direction.
            corners = (radii_m * towards / _lengths(towards)).T
            yield Solid("ellipsoid", pose, geometry.radii_m, vertices_m=corners)
        case Cone():
            yield _hull(pose, triangles_of(geometry, {}).vertices_m)
        case Polyline():
            if most:
                yield from _raised(pose, geometry)
            else:
                yield from _surface(pose, triangles_of(geometry, {}))
        case Mesh():
            if most:
                yield from _hulls(pose, convex_parts(meshes[geometry.sha256], geometry.scale, most))
            else:
                yield from _surface(pose, triangles_of(geometry, meshes))


def _raised(pose: Array, polyline: Polyline) -> Iterator[Solid]:
    points, triangles = flat_triangles(polygons_of(polyline.polygons_m))
    if len(triangles) > _MAX_PRISMS:
        yield from _hulls(pose, convex_parts(_raised_mesh(polyline)))
        return
    for outline in points[triangles]:
        ends = [
            np.column_stack((outline, np.full(len(outline), z))) for z in (0, polyline.height_m)
        ]
        yield _hull(pose, np.concatenate(ends))


@functools.lru_cache(maxsize=128)
def _raised_mesh(polyline: Polyline) -> TriangleMesh:
    """The very same object each time, for which `convex_parts` looks."""
    return triangles_of(polyline, {})


def _surface(pose: Array, mesh: TriangleMesh) -> Iterator[Solid]:
    if not len(mesh.triangles):
        raise ValueError("has no triangles")
    for first in range(0, len(mesh.triangles), _MAX_TRIANGLES):
        used, corners = np.unique(
            mesh.triangles[first : first + _MAX_TRIANGLES], return_inverse=True
        )
        yield Solid(
            "triangles",
            pose,
            vertices_m=mesh.vertices_m[used],
            triangles=corners.reshape(-1, 3).astype(np.int32),
        )


def _hulls(pose: Array, parts: Sequence[Array]) -> Iterator[Solid]:
    for points in parts:
        yield _hull(pose, points, MAX_HULL_POINTS if len(parts) == 1 else MAX_PART_POINTS)


def _hull(pose: Array, points: Array, most: int = MAX_HULL_POINTS) -> Solid:
    corners = points[hull_of(points).vertices]
    if len(corners) > most:
        corners = corners[
            np.unique((portable.product(corners - corners.mean(0), _spiral(most))).argmax(0))
        ]
    return Solid("hull", pose, vertices_m=corners)


def _spiral(count: int) -> Array:
    """(3, count) directions spread evenly over a sphere, turning by the golden angle."""
    turns = np.arange(count)
    z = 1.0 - (2.0 * turns + 1.0) / count
    out, angle = np.sqrt(1.0 - z * z), turns * np.pi * (3.0 - np.sqrt(5.0))
    cos, sin = portable.cos_sin_each(angle)
    return np.stack((out * cos, out * sin, z))


def _lengths(vectors: Array) -> Array:
    """(n,) of (3, n), the same on every machine."""
    x, y, z = vectors
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _closed(shape: Shape, meshes: Mapping[str, TriangleMesh], most: int) -> Array:
    """(m, 3, 3) corners, in the body's frame, of triangles around a shape."""
    pose, geometry = pose_matrix(shape), shape.geometry
    if isinstance(geometry, Mesh):
        parts = convex_parts(meshes[geometry.sha256], geometry.scale, most)
        corners = np.concatenate([_hull_around(part) for part in parts])
    else:
        mesh = triangles_of(geometry, meshes)
        corners = mesh.vertices_m[mesh.triangles]
    return np.asarray(portable.product(corners, pose[:3, :3].T) + pose[:3, 3])


def _hull_around(points: Array) -> Array:
    """(m, 3, 3) triangles around points, counter-clockwise from outside."""
    hull = hull_of(points)
    corners = points[hull.simplices]
    inwards = portable.determinants(corners - points[hull.vertices].mean(0)) < 0.0
    corners[inwards] = corners[inwards][:, ::-1]
    return np.asarray(corners)


def hull_triangles(points: Array) -> NDArray[np.int32]:
    """(m, 3) triangles around a convex body, by the indices of its corners."""
    return np.asarray(hull_of(points).simplices, np.int32)


def as_obj(points: Iterable[Iterable[float]]) -> str:
    """A convex body's corners as a Wavefront file with the faces that PyBullet requires."""
    corners = np.array([list(point) for point in points])
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners.tolist()]
    faces = hull_triangles(corners) + 1
    return "\n".join((*lines, *(f"f {a} {b} {c}" for a, b, c in faces.tolist()), ""))

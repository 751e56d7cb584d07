"""Checks for worlds and bodies that PyBullet would accept silently, and then simulate wrongly."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array, pose_matrix
from mazebot.common.messages.documents import (
    Body,
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
    World,
)
from mazebot.common.world.entity_problems import MAX_DISTANCE_M, pose_problems
from mazebot.common.world.geometry import MAX_TRIANGLES, TriangleMesh, triangles_of

MAX_WALLS = 5_000
MAX_SHAPES = 20_000
MAX_MOVERS = 400
"""At rest beside each other they take 2 ms a step, in one wall 30 ms."""
MAX_OVERLAPS = 10
"""Of one moving body with others at the start: 100 at one position are never pushed apart."""
MAX_CORNERS = 20_000
"""Of all polylines."""
MAX_LENGTH_M = MAX_DISTANCE_M
MAX_MASS_KG = 1e6
MIN_MASS_KG = 1e-3
_THIN_M = 0.002
"""Bullet's collision margin is 1 mm and more: a thinner body would have no collisions."""
_THIN_MOVER_M = 0.005
PENETRATION_M = 0.01


def check(world: World, meshes: Mapping[str, TriangleMesh], frames: Collection[str] = ()) -> None:
    """Raises ValueError, in one line, for the first problem that prevents a simulation.

    `frames` are the robot's: a moving body may not have such a name.
    """
    if len(world.walls) > MAX_WALLS:
        raise ValueError(f"walls: {len(world.walls)} of them: at most {MAX_WALLS}")
    seen: set[str] = set()
    for kind, things in (("walls", world.walls), ("bodies", world.bodies)):
        for thing in things:
            if thing.name in seen:
                raise ValueError(f"{kind}: {thing.name!r:.60} is not unique")
            seen.add(thing.name)
    for wall in world.walls:
        sizes = {"length_m": wall.length_m, "thickness_m": wall.thickness_m}
        sizes |= {"height_m": wall.height_m, "x_m": wall.x_m, "y_m": wall.y_m}
        for field, value in sizes.items():
            low = -MAX_LENGTH_M if field in ("x_m", "y_m") else _THIN_M
            if not low <= value <= MAX_LENGTH_M:
                raise ValueError(f"wall {wall.name!r}: {field}: {value} is out of range")
    for field, value in {"x_m": world.start.x_m, "y_m": world.start.y_m}.items():
        if not abs(value) <= MAX_LENGTH_M:
            raise ValueError(f"start: {field}: {value} is out of range")
    _check_bodies(world.bodies, meshes, frames)


def _check_bodies(
    bodies: Sequence[Body], meshes: Mapping[str, TriangleMesh], frames: Collection[str]
) -> None:
    shapes = [shape for body in bodies for shape in body.shapes]
    if len(shapes) > MAX_SHAPES:
        raise ValueError(f"bodies: {len(shapes)} shapes: at most {MAX_SHAPES}")
    for body in bodies:
        for problem in body_problems(body, meshes, frames):
            raise ValueError(f"body {body.name!r:.60}: {problem}")
    triangles = sum(
        len(meshes[shape.geometry.sha256].triangles)
        for shape in shapes
        if isinstance(shape.geometry, Mesh)
    )
    if triangles > MAX_TRIANGLES:
        raise ValueError(f"bodies: {triangles} triangles of meshes: at most {MAX_TRIANGLES}")
    corners = sum(
        len(polygon)
        for shape in shapes
        if isinstance(shape.geometry, Polyline)
        for polygon in shape.geometry.polygons_m
    )
    if corners > MAX_CORNERS:
        raise ValueError(f"bodies: {corners} corners of polylines: at most {MAX_CORNERS}")
    movers = [body for body in bodies if body.mass_kg > 0.0]
    if len(movers) > MAX_MOVERS:
        raise ValueError(f"bodies: {len(movers)} that move: at most {MAX_MOVERS}")
    if movers:
        _check_heaps(movers, meshes)


def body_problems(
    body: Thing, meshes: Mapping[str, TriangleMesh], frames: Collection[str]
) -> Iterator[str]:
    """The problems that prevent simulating a body, a phrase each. `frames` are the robot's."""
    moves = body.moves
    yield from pose_problems(body)
    if not 0.0 <= body.mass_kg <= MAX_MASS_KG or 0.0 < body.mass_kg < MIN_MASS_KG:
        yield f"mass_kg: {body.mass_kg}: must be 0, or {MIN_MASS_KG:g} to {MAX_MASS_KG:g}"
    if moves and body.name in frames:
        yield "name: is a frame of the robot: must be another name for a body that moves"
    if body.mass_kg > 0.0 and not any(shape.solid for shape in body.shapes):
        yield f"mass_kg: {body.mass_kg}: must be 0: none of its shapes is solid"
    for shape in body.shapes:
        for problem in (*pose_problems(shape), *_shape_problems(shape, meshes, moves)):
            yield f"shape {shape.name!r:.60}: {problem}"


def _shape_problems(shape: Shape, meshes: Mapping[str, TriangleMesh], moves: bool) -> Iterator[str]:
    geometry = shape.geometry
    thin = 1e-6 if not shape.solid else _THIN_MOVER_M if moves else _THIN_M
    for field, value in _sizes(shape).items():
        if not thin <= value <= MAX_LENGTH_M:
            yield f"{field}: {value}: must be {thin:g} to {MAX_LENGTH_M:g} m"
    if isinstance(geometry, Plane) and shape.solid and moves:
        yield "geometry: plane: must not be solid in a body that moves"
    if isinstance(geometry, Polyline):
        # A comparison with NaN is False.
        for polygon in geometry.polygons_m:
            if not all(abs(value) <= MAX_LENGTH_M for point in polygon for value in point):
                yield f"polygons_m: must be within {MAX_LENGTH_M:g} m"
    if isinstance(geometry, Mesh):
        mesh = meshes.get(geometry.sha256)
        if mesh is None:
            yield f"mesh {geometry.sha256:.12} is missing"
        elif not all(1e-6 <= abs(factor) <= 1e6 for factor in geometry.scale):
            yield f"scale: {geometry.scale}: must be nonzero and at most 1000000"
        elif not len(mesh.triangles):
            yield f"mesh {geometry.sha256:.12} has no triangles"
        elif not (np.abs(mesh.vertices_m * geometry.scale) <= MAX_LENGTH_M).all():
            yield f"scale: {geometry.scale}: makes it extend beyond {MAX_LENGTH_M:g} m"


def _sizes(shape: Shape) -> dict[str, float]:
    match shape.geometry:
        case Box(size_m=sides):
            return {f"size_m[{axis}]": side for axis, side in enumerate(sides)}
        case Plane(size_m=lengths):
            return {f"size_m[{axis}]": side for axis, side in enumerate(lengths)}
        case Ellipsoid(radii_m=radii):
            return {f"radii_m[{axis}]": radius for axis, radius in enumerate(radii)}
        case Cylinder() | Cone() | Capsule() as round_one:
            return {"radius_m": round_one.radius_m, "length_m": round_one.length_m}
        case Sphere(radius_m=radius):
            return {"radius_m": radius}
        case Polyline(height_m=height):
            return {"height_m": height}
        case _:
            return {}


def _check_heaps(movers: Sequence[Body], meshes: Mapping[str, TriangleMesh]) -> None:
    low, high = (np.array(ends) for ends in zip(*(_bounds(b, meshes) for b in movers), strict=True))
    for index, body in enumerate(movers):
        shared = np.minimum(high, high[index]) - np.maximum(low, low[index])
        others = int((shared > PENETRATION_M).all(axis=1).sum()) - 1
        if others > MAX_OVERLAPS:
            raise ValueError(
                f"body {body.name!r:.60}: position_m: overlaps {others} others that move: "
                f"at most {MAX_OVERLAPS}"
            )


def _bounds(body: Body, meshes: Mapping[str, TriangleMesh]) -> tuple[Array, Array]:
    """Lowest and highest coordinates of a body's solid shapes, in the map frame."""
    points = np.concatenate(
        [
            triangles_of(shape.geometry, meshes)
            .moved(portable.product(pose_matrix(body), pose_matrix(shape)))
            .vertices_m
            for shape in body.shapes
            if shape.solid
        ]
    )
    if not len(points):
        raise ValueError(f"body {body.name!r:.60}: shapes: have no volume")
    return points.min(0), points.max(0)

"""Finds the floor of an SDF world: its ground plane, or the slabs on which everything stands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import shapely

from mazebot.common.maths.frames import Array, transform_matrix
from mazebot.common.messages import documents as doc
from mazebot.common.world.geometry import triangles_of
from mazebot.worldgen.recipe_model import MeshGeometry
from mazebot.worldgen.sdf.model import SdfWorld
from mazebot.worldgen.sdf.notes import number
from mazebot.worldgen.sdf.parts import Group, Part, product

FLOOR_M = 0.001
"""Shapes no farther from the floor's height count as on the floor."""
ALIGNED = 1e-6
"""Sine of the maximum tilt of what is upright or level."""

_SIDE_M = 1.0
"""A slab is at least as wide, and at least twice as wide as it is thick."""
_AREA_M2 = 4.0
"""A slab is a floor without anything on it from this area on."""
_STEP_M = 0.3
"""A slab that is higher above a ground plane is a podium, not a floor."""
_GAP_M = 0.02
"""What hovers by less stands."""
_BESIDE_M = 0.5
"""Walls stand up to here beside their slab."""


@dataclass(frozen=True)
class Floor:
    """The floor of a world."""

    level_m: float = 0.0
    """z of its top in the file."""
    slabs: tuple[str, ...] = ()
    """Part.where of the boxes that it is made of, the largest first; none: it is a plane."""
    told: tuple[str, ...] = ()
    """What to know about it, a line each."""


class _Solid(NamedTuple):
    where: str
    low_m: float
    top_m: float
    area: shapely.Geometry
    slab: bool


def floor_of(groups: Sequence[Group], start_xy: tuple[float, float]) -> Floor:
    """The floor on which Gazebo would put a robot at `start_xy`.

    It is the ground plane at z = 0 or else the highest, or the static level boxes of one height
    under most of what stands in the world: of several storeys the one nearest to z = 0. Where there
    is a ground plane, too, boxes are the floor only if they lie on it and the start is on them.
    What an export has noted is left out.
    """
    planes, parts = _planes_and_solids(groups)
    ground_m = next((0.0 for z in planes if abs(z) <= FLOOR_M), max(planes, default=None))
    under_m = ground_m or 0.0
    if not any(_is_slab(*one) for one in parts):
        return Floor(under_m)
    solids = [_solid(*one) for one in parts]
    centres = shapely.centroid([one.area for one in solids])
    lows_m = np.array([one.low_m for one in solids])
    tops_m = np.array([one.top_m for one in solids])
    best, told = Floor(under_m), []
    for level in _levels(solids):
        top_m = solids[level[0]].top_m
        lying = lows_m[level].min() <= under_m + _GAP_M
        if ground_m is not None and not (lying and -FLOOR_M <= top_m - under_m <= _STEP_M):
            continue
        slabs = [solids[index] for index in level]
        area = shapely.union_all([one.area for one in slabs])
        starts_on_it = bool(area.intersects(shapely.Point(start_xy)))
        beside = lows_m <= top_m + _GAP_M
        beside[level] = False
        risen = beside & (tops_m > top_m + FLOOR_M)
        count = int(shapely.intersects(area.buffer(_BESIDE_M), centres[risen]).sum())
        large = area.area >= _AREA_M2
        is_floor = 2 * count > beside.sum() if beside.any() else large and starts_on_it
        if ground_m is not None and top_m > under_m + FLOOR_M and is_floor != starts_on_it:
            if large:
                told.append(_step(slabs, area.area, top_m - under_m, start_xy, starts_on_it))
        elif is_floor and not (best.slabs and abs(best.level_m) <= abs(top_m)):
            slabs.sort(key=lambda one: -one.area.area)
            best = Floor(top_m, tuple(one.where for one in slabs))
    return replace(best, told=tuple(told))


def _planes_and_solids(
    groups: Sequence[Group],
) -> tuple[list[float], list[tuple[Group, Part, Array]]]:
    """The heights of level static planes, and everything else that is solid, with its pose in the
    world, without what an export has noted.
    """
    planes, solids = [], []
    for group in groups:
        if "kind" in group.links[0].attributes:
            continue
        for part in group.parts:
            if part.solid and part.has_end:
                pose = product(group.world_from_body, part.body_from_part)
                solids.append((group, part, pose))
            elif part.solid and group.static:
                height_m = level_height(group, part)
                planes += [] if height_m is None else [height_m]
    return planes, solids


def lowered(sdf: SdfWorld, by_m: float) -> SdfWorld:
    """The same world with everything in it lower by that."""
    down = transform_matrix(np.eye(3), (0.0, 0.0, -by_m))

    def moved(world_from_thing: Array) -> Array:
        pose = down @ world_from_thing
        pose[2, 3] = number(pose[2, 3])
        return pose

    return replace(
        sdf,
        models=tuple(
            replace(one, world_from_model=moved(one.world_from_model)) for one in sdf.models
        ),
        links=tuple(replace(one, world_from_link=moved(one.world_from_link)) for one in sdf.links),
        lights=tuple(
            replace(one, world_from_light=moved(one.world_from_light)) for one in sdf.lights
        ),
    )


def level_height(group: Group, part: Part) -> float | None:
    """Height of a level plane in the world; None if it is not level."""
    pose = product(group.world_from_body, part.body_from_part)
    return float(pose[2, 3]) if pose[2, 2] > 1.0 - ALIGNED else None


def _solid(group: Group, part: Part, pose: Array) -> _Solid:
    geometry = part.geometry
    if isinstance(geometry, MeshGeometry):
        # Files of meshes are not read yet. The origin of most is in their middle, on the floor.
        low_m = float(pose[2, 3])
        return _Solid(part.where, low_m, np.inf, shapely.Point(pose[:2, 3]), slab=False)
    if isinstance(geometry, doc.Polyline):
        heights_m = (0.0, geometry.height_m)
        points = [(*xy, z) for ring in geometry.polygons_m for xy in ring for z in heights_m]
        corners = np.array(points)
    else:
        corners = triangles_of(geometry, {}).vertices_m
    corners = corners @ pose[:3, :3].T + pose[:3, 3]
    return _Solid(
        part.where,
        float(corners[:, 2].min()),
        number(corners[:, 2].max()),
        shapely.MultiPoint(corners[:, :2]).convex_hull,
        _is_slab(group, part, pose),
    )


def _is_slab(group: Group, part: Part, pose: Array) -> bool:
    """Whether a part is a static box that lies flat in the world, wide enough to be a floor."""
    box = part.geometry
    if not (group.static and isinstance(box, doc.Box)):
        return False
    up = np.abs(pose[2, :3])
    axis = int(up.argmax())
    sides = [side for one, side in enumerate(box.size_m) if one != axis]
    level = np.delete(up, axis).max() <= ALIGNED
    return bool(level and min(sides) >= max(_SIDE_M, 2.0 * box.size_m[axis]))


def _levels(solids: Sequence[_Solid]) -> Iterator[list[int]]:
    """Indices of the slabs whose tops are at one height, from below."""
    level: list[int] = []
    slabs = [index for index, one in enumerate(solids) if one.slab]
    for index in sorted(slabs, key=lambda index: solids[index].top_m):
        if level and solids[index].top_m > solids[level[0]].top_m + FLOOR_M:
            yield level
            level = []
        level.append(index)
    if level:
        yield level


def _step(
    slabs: Sequence[_Solid], area_m2: float, step_m: float, start_xy: tuple[float, float], on: bool
) -> str:
    names = ", ".join(one.where for one in slabs[:3]) + ("..." if len(slabs) > 3 else "")
    x_m, y_m = start_xy
    why = (
        "fewer than half of the things in the world stand on it, so that the robot drives beside it"
        if on
        else f"the start at ({x_m:g}, {y_m:g}) is beside it"
    )
    return (
        f"{names} covers {area_m2:.1f} m2 like a floor, and is a step of {step_m:g} m here: {why}"
    )

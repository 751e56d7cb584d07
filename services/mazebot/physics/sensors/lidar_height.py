"""What a lidar at another height than that of the maps sees otherwise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from mazebot.common.maths import portable
from mazebot.common.maths.frames import pose_matrix
from mazebot.common.messages.documents import World
from mazebot.common.robot.waffle import LIDAR_HEIGHT_M
from mazebot.common.world.footprint import footprint
from mazebot.common.world.geometry import TriangleMesh

_SAME_M: Final = 0.02
"""Heights that differ by no more meet the same."""
_NAMED: Final = 5


def seen_otherwise(world: World, meshes: Mapping[str, TriangleMesh], lidar_m: float) -> str:
    """Which walls and bodies only one of two planes meets, the lidar's or that for which worlds'
    maps are made, in one line; empty: none, or the robot makes its map itself.

    Args:
        world: its bodies are taken where they are at first, without those that move.
        meshes: by sha256. Raises KeyError where one is missing.
        lidar_m: the lidar's height above the floor.
    """
    if world.slam or abs(lidar_m - LIDAR_HEIGHT_M) <= _SAME_M:
        return ""
    mapped, met = (list(_met(world, meshes, height_m)) for height_m in (LIDAR_HEIGHT_M, lidar_m))
    told = [
        f"only {which} one meets {', '.join(names[:_NAMED])}"
        + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
        for which, names in (
            ("that", [name for name in mapped if name not in met]),
            ("this", [name for name in met if name not in mapped]),
        )
        if names
    ]
    if not told:
        return ""
    return (
        f"the lidar is {lidar_m:.3f} m above the floor, maps of worlds are made for one at "
        f"{LIDAR_HEIGHT_M:g} m: {'; '.join(told)}; localization may go wrong there"
    )


def _met(world: World, meshes: Mapping[str, TriangleMesh], height_m: float) -> Iterator[str]:
    """The names of what a level plane meets."""
    for wall in world.walls:
        if wall.height_m > height_m:
            yield wall.name
    for body in world.bodies:
        if not body.moves and any(
            footprint(
                shape.geometry,
                portable.product(pose_matrix(body), pose_matrix(shape)),
                meshes,
                (height_m, height_m),
            ).polygons_m
            for shape in body.shapes
            if shape.solid
        ):
            yield body.name

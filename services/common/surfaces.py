"""A world as textured triangles: the one list that camera, viewer and preview draw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from services.common.documents import World
from services.common.geometry import TriangleMesh


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles of one material."""

    kind: Literal["wall", "floor", "ceiling", "body"]
    name: str
    """Of the wall, room or body it belongs to."""
    material: str
    """Name of a material of the world."""
    moves: bool
    """It belongs to a body that moves: the triangles are in that body's frame, else in the map's.
    """
    textured: bool
    """False for the tops of walls, which show their material's plain colour."""
    mesh: TriangleMesh


def surfaces(world: World, meshes: Mapping[str, TriangleMesh]) -> tuple[Surface, ...]:
    """Everything in a world that is seen, but markers and robot.

    Where faces of walls lie upon each other the higher one is drawn, and the first of equals.
    Coverings replace their stretch of a face. Rooms' floors replace theirs of the world's floor.
    """
    raise NotImplementedError

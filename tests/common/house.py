"""Walls, markers and worlds to hang markers in."""

from __future__ import annotations

from collections.abc import Sequence

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import Marker, Material, Planar, Wall, World

ORIGIN = SE2(0.0, 0.0, 0.0)
IN_FRONT = SE2(0.0, 3.0, 0.0)
"""Of the left face of a wall at the origin."""


def wall(
    name: str = "wall", pose: SE2 = ORIGIN, length_m: float = 2.0, height_m: float = 1.0
) -> Wall:
    return Wall(
        name=name, length_m=length_m, thickness_m=0.2, height_m=height_m, x_m=pose.x_m,
        y_m=pose.y_m, yaw_rad=pose.yaw_rad, material="plain",
    )  # fmt: skip


def marker(**changes: object) -> Marker:
    values = {"id": 7, "wall": "wall", "side": "left", "offset_m": 0.0, "height_m": 0.4}
    return Marker.model_validate(values | changes)


def world(walls: Sequence[Wall], markers: Sequence[Marker], start: SE2 = IN_FRONT) -> World:
    one = World(
        name="test", recipe="test.yaml", hash="", walls=tuple(walls), markers=tuple(markers),
        materials=(Material(name="plain"),),
        start=Planar(x_m=start.x_m, y_m=start.y_m, yaw_rad=start.yaw_rad),
    )  # fmt: skip
    return one.model_copy(update={"hash": one.content_hash()})

"""The floor's rooms and zones, the ceiling and its lamps."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from mazebot.common.messages.documents.document import Document, Point2, Positive, Rgba, Vector


class Room(Document):
    """A named part of the floor."""

    name: str
    polygon_m: tuple[Point2, ...] = Field(description="its corners, in order")
    floor_material: str = Field("", description="empty: the world's")


class KeepoutZone(Document):
    """A part of the floor where the robot must not drive."""

    name: str
    polygon_m: tuple[Point2, ...] = Field(min_length=3, description="its corners, in order")


class SpeedZone(Document):
    """A part of the floor where the robot must be slow: one of the two limits is given."""

    name: str
    polygon_m: tuple[Point2, ...] = Field(min_length=3, description="its corners, in order")
    speed_limit_m_s: Positive | None = None
    percent: Positive | None = Field(None, description="of the controller's highest speed")


class UnseenArea(Document):
    """A rectangle of the floor, along x and y, in which what is occupied is below or above the
    lidar's plane.
    """

    low_m: Point2 = Field(description="least x and y")
    high_m: Point2 = Field(description="greatest x and y")


class Ceiling(Document):
    """A flat ceiling over all walls."""

    height_m: Positive
    material: str


class PointLight(Document):
    """A lamp. At distance d within `range_m` its light is diffuse / (constant + linear d +
    quadratic d^2), as in SDF; beyond it is 0.
    """

    name: str
    position_m: Vector
    diffuse: Rgba = (1.0, 1.0, 1.0, 1.0)
    range_m: Positive = 10.0
    constant: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 1.0
    linear: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0
    quadratic: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0

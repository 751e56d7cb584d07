"""Planar poses, and places to drive to."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents.document import Document, Finite


class Planar(Document):
    """A planar pose in the map frame."""

    x_m: Finite = Field(description="m")
    y_m: Finite = Field(description="m")
    yaw_rad: Finite = Field(description="counter-clockwise from x, rad")

    @classmethod
    def of(cls, pose: SE2) -> Planar:
        """Of a transform, map_from_self."""
        return Planar(x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad)

    def se2(self) -> SE2:
        """The same pose as a transform, map_from_self."""
        return SE2(self.x_m, self.y_m, self.yaw_rad)


class Location(Planar):
    """A named place to drive to."""

    name: str = Field(description="unique in its world")

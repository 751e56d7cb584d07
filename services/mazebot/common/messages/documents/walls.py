"""Walls, and how their surfaces look."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents.document import Document, Finite, Positive, Rgba


class Material(Document):
    """How a surface looks: a texture by content hash, and the colours used where there is none."""

    name: str
    texture_sha256: str = Field("", description="asset of the texture; empty: plain colour")
    texture_name: str = Field("", description="file name of the texture, for display")
    texture_side_m: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        1.0,
        description="length on a surface of one tile's side; 0: stretched once over each face, as "
        "Gazebo does. Meshes have texture coordinates of their own.",
    )
    ambient: Rgba = (1.0, 1.0, 1.0, 1.0)
    diffuse: Rgba = (1.0, 1.0, 1.0, 1.0)


class Covering(Document):
    """A section of a wall's face, from the floor to the top, with its own material."""

    side: Literal["left", "right"] = Field(description="as a marker's")
    from_m: Finite = Field(description="along the wall's x axis, from its centre")
    to_m: Finite = Field(description="greater than `from_m`")
    material: str = Field(description="name of a material of the world")


class Wall(Document):
    """An upright box on the floor. Its x axis runs along its length, y across its thickness."""

    name: str
    length_m: Positive
    thickness_m: Positive
    height_m: Positive
    x_m: Finite = Field(description="centre")
    y_m: Finite = Field(description="centre")
    yaw_rad: Finite
    material: str = Field(description="name of a material of the world")
    coverings: tuple[Covering, ...] = Field((), description="none overlap")

    def map_from_wall(self) -> SE2:
        """Pose of the wall's centre."""
        return SE2(self.x_m, self.y_m, self.yaw_rad)

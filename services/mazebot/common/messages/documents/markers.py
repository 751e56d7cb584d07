"""ArUco markers: on the walls, their dictionaries, and as the map holds them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from mazebot.common.messages.documents.document import (
    Document,
    Finite,
    Positive,
    Quaternion,
    Vector,
)


class Marker(Document):
    """An ArUco marker, given by the wall it hangs on. `offset_m` runs along the wall's x axis from
    the wall's centre.
    """

    id: Annotated[int, Field(ge=0, le=100_000)] = Field(description="unique in the world")
    dictionary: str = Field(
        "DICT_4X4_100", description="OpenCV's name, or a file in the folder dictionaries/"
    )
    size_m: Positive = Field(0.3, description="side of the black square")
    quiet_zone_modules: Annotated[int, Field(ge=1, le=16)] = Field(
        1, description="width of the white quiet zone around it, in modules of the marker"
    )
    wall: str = Field(description="name of a wall")
    side: Literal["left", "right"] = Field(
        description="the face towards the wall's +y axis (left) or -y axis (right)"
    )
    offset_m: Finite = Field(0.0, description="along the wall's x axis, from its centre")
    height_m: Finite = Field(description="of the marker's centre above the floor")

    @property
    def name(self) -> str:
        """Name of the entity of a marker that is part of the world."""
        return f"aruco_{self.id}"


DICTIONARY_FILES = (".yml", ".yaml", ".json", ".xml")
"""Endings of files of custom ArUco dictionaries."""


class MarkerDictionary(Document):
    """The codes of a dictionary of ArUco markers that is not one of OpenCV's."""

    name: str = Field(description="as markers give it: that of its file")
    modules: Annotated[int, Field(ge=2, le=16)] = Field(
        description="along a marker's side, without its border"
    )
    max_correction_bits: Annotated[int, Field(ge=0)] = 0
    codes: tuple[Annotated[str, Field(pattern="^[01]+$")], ...] = Field(
        min_length=1, description="by id: its modules row by row, 0 black, 1 white"
    )

    @model_validator(mode="after")
    def _fits_its_size(self) -> MarkerDictionary:
        digits = self.modules * self.modules
        if any(len(code) != digits for code in self.codes):
            raise ValueError(f"codes: each must have {digits} digits (modules {self.modules})")
        return self


class MappedMarker(Document):
    """A marker as it was found when the map was made."""

    dictionary: str
    marker_id: Annotated[int, Field(ge=0)]
    position_m: Vector
    orientation_xyzw: Quaternion = Field(description="x to its right, y up, z out of its face")

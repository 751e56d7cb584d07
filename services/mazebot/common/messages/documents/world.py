"""A world, and the request for one."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from mazebot.common.messages.documents.document import Document, Finite, Positive, Rgba
from mazebot.common.messages.documents.entities import Body
from mazebot.common.messages.documents.markers import MappedMarker, Marker, MarkerDictionary
from mazebot.common.messages.documents.places import Location, Planar
from mazebot.common.messages.documents.rooms import (
    Ceiling,
    KeepoutZone,
    PointLight,
    Room,
    SpeedZone,
    UnseenArea,
)
from mazebot.common.messages.documents.walls import Material, Wall


class WorldRequest(Document):
    """The requested world; `bringup` publishes it latched."""

    world_name: str = Field(description="name of a recipe in worlds/, e.g. `sim_house_enhanced`")
    use_aruco: bool = Field(True, description="keep the recipe's ArUco markers")
    overrides: tuple[str, ...] = Field(
        (), description="`field=value` in YAML, overrides the recipe's value: `maze.seed=3`"
    )
    slam: bool = Field(False, description="`mapping` makes the map and localises the robot in it")
    explore: bool = Field(True, description="with `slam`: `explorer` drives by itself")

    @property
    def explores(self) -> bool:
        """Whether `explorer` drives."""
        return self.slam and self.explore


class WorldStatus(Document):
    """The result of a world request: `error` is empty where the world was loaded."""

    request: WorldRequest
    world_hash: str = Field(
        "", description="hash of the running world, from this request or another one"
    )
    error: str = Field("", description="one line: what is wrong, and what is allowed")
    running: WorldRequest | None = Field(
        None,
        description="the request of the world that is running, for a worldgen that is "
        "started again",
    )


class World(Document):
    """A resolved world: everything it contains, with the hash that identifies it; and how this run
    knows it, which is not part of the hash.
    """

    name: str
    recipe: str = Field(description="file name of the recipe it came from")
    hash: str = Field(description="sha256 of everything else here, first 16 hex digits")
    walls: tuple[Wall, ...]
    materials: tuple[Material, ...]
    markers: tuple[Marker, ...] = ()
    dictionaries: tuple[MarkerDictionary, ...] = Field(
        (), description="those of the markers that are not OpenCV's"
    )
    bodies: tuple[Body, ...] = ()
    rooms: tuple[Room, ...] = ()
    locations: tuple[Location, ...] = ()
    keepout_zones: tuple[KeepoutZone, ...] = ()
    speed_limits: tuple[SpeedZone, ...] = ()
    start: Planar
    map_resolution_m: Positive = 0.05
    map_sha256: str = Field("", description="of a ready map's cells; empty: made from the world")
    floor_material: str = Field("", description="name of a material; empty: plain grey")
    ceiling: Ceiling | None = None
    lights: tuple[PointLight, ...] = ()
    sky: Rgba = (0.7, 0.7, 0.7, 1.0)
    light_direction: tuple[Finite, Finite, Finite] = (-0.5, 0.1, -0.9)
    light_ambient: Finite = 0.8
    light_diffuse: Finite = 0.8
    slam: bool = Field(False, description="the robot gets no map: `mapping` makes one")
    explore: bool = Field(False, description="with `slam`: `explorer` drives by itself")
    mapped_markers: tuple[MappedMarker, ...] | None = Field(
        None,
        description="the markers that the robot knows; null: all, at their true poses",
    )
    unseen: tuple[UnseenArea, ...] = Field(
        (), description="where the lidar sees nothing of what is on the map, its plane passes it"
    )

    @model_serializer(mode="wrap")
    def _without_empty(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A world without zones, dictionaries and a map of its own is written, and so hashed, as
        if these did not exist.
        """
        content: dict[str, Any] = handler(self)
        optional = ("keepout_zones", "speed_limits", "dictionaries")
        for field in (*optional, "slam", "explore", "unseen"):
            if not content.get(field, True):
                del content[field]
        if content.get("mapped_markers", ()) is None:
            del content["mapped_markers"]
        return content

    def content_hash(self) -> str:
        """The value that `hash` must have."""
        known = {"hash", "slam", "explore", "mapped_markers", "unseen"}
        content = json.dumps(self.model_dump(mode="json", exclude=known), sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:16]

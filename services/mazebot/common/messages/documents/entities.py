"""What is in a world and may be spawned: bodies and markers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mazebot.common.messages.documents.document import (
    Document,
    Point2,
    Positive,
    Quaternion,
    Vector,
)
from mazebot.common.messages.documents.shapes import Shape
from mazebot.common.messages.documents.walls import Material


class Body(Document):
    """A rigid body of any shapes. Walls are not bodies."""

    name: str
    position_m: Vector
    orientation_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    mass_kg: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        0.0, description="0: it never moves"
    )
    shapes: tuple[Shape, ...]

    @property
    def moves(self) -> bool:
        """Whether it can ever leave its pose."""
        return self.mass_kg > 0.0


class MarkerEntity(Document):
    """An ArUco marker on its panel. Its pose is that of the panel's centre; its face points along
    +z, with +x to the right and +y up seen from the front.
    """

    name: str
    kind: Literal["marker"] = "marker"
    position_m: Vector
    orientation_xyzw: Quaternion
    panel_side_m: Positive = Field(description="side of the panel, with the quiet zone")
    texture_sha256: str
    marker_id: int
    marker_size_m: Positive = Field(description="side of the black square")
    dictionary: str


MAX_PATH_SPEED_M_S = 5.0


class ScriptedPath(Document):
    """A path that a body follows repeatedly at constant speed, facing forward: from its pose to
    each waypoint in order, then straight back to its pose (`loop`) or back along the same path.
    """

    waypoints_m: tuple[Point2, ...] = Field(min_length=1, max_length=1000)
    speed_m_s: Annotated[float, Field(gt=0.0, le=MAX_PATH_SPEED_M_S, allow_inf_nan=False)]
    loop: bool = False
    yields: bool = Field(True, description="stops while the robot blocks its path")


class BodyEntity(Document):
    """A rigid body of any shapes that was spawned in a world. Its pose is that of its origin."""

    name: str
    kind: Literal["body"] = "body"
    position_m: Vector
    orientation_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    mass_kg: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        0.0, description="0: moved only by its path, if it has one"
    )
    shapes: tuple[Shape, ...] = Field(min_length=1)
    materials: tuple[Material, ...] = Field((), description="the materials that its shapes name")
    path: ScriptedPath | None = Field(None, description="needs mass_kg 0")
    placed: Annotated[int, Field(ge=0)] = Field(
        0,
        description="counts how often it was put at its pose: a new count moves it back to its "
        "pose if it has moved since",
    )

    @property
    def moves(self) -> bool:
        """Whether it can leave its pose without being set to another one."""
        return self.mass_kg > 0.0 or self.path is not None


Entity = Annotated[MarkerEntity | BodyEntity, Field(discriminator="kind")]
Thing = Body | BodyEntity


class Refusal(Document):
    """A rejected entity, and why."""

    name: str
    reason: str


class FirstPose(Document):
    """Where an entity was first, which has been moved since."""

    name: str
    position_m: Vector
    orientation_xyzw: Quaternion


class Entities(Document):
    """A set of entities of one world: the desired set, or the set that exists."""

    world_hash: str
    revision: Annotated[int, Field(ge=0)] = Field(
        0,
        description="number of the desired set; in the set that exists: number of the desired set "
        "that it implements. 0: the first set of a spawner that has just started. If a set exists "
        "already, it is kept, and only entities that were rejected before are retried",
    )
    entities: tuple[Entity, ...] = ()
    refused: tuple[Refusal, ...] = ()
    initial: tuple[FirstPose, ...] = Field(
        (), description="first poses of the entities that have been moved: a reset puts them back"
    )
    deleted: tuple[MarkerEntity, ...] = Field(
        (), description="the world's own markers that have been deleted: a reset hangs them again"
    )
    reset_epoch: Annotated[int, Field(ge=0)] = Field(
        0,
        description="epoch of the newest reset that has put them back; in a desired set, of the "
        "newest that the spawner knows of",
    )

    @property
    def markers(self) -> tuple[MarkerEntity, ...]:
        """The entities that are markers, in order."""
        return tuple(one for one in self.entities if isinstance(one, MarkerEntity))

    @property
    def bodies(self) -> tuple[BodyEntity, ...]:
        """The entities that are bodies, in order."""
        return tuple(one for one in self.entities if isinstance(one, BodyEntity))

"""Queries that spawn, delete, move and list entities."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.messages.documents.document import Document, Quaternion, Vector
from mazebot.common.messages.documents.entities import Entity


class SpawnEntity(Document):
    """Requests that an entity be spawned. Repeating the same request changes nothing."""

    entity: Entity
    allow_renaming: bool = Field(
        False,
        description="if the name is taken, use the first free one: `name_1`",
    )
    assets: dict[str, str] = Field(
        default_factory=dict,
        description="textures (PNG) and meshes (npz) of the entity, base64, by their sha256",
    )


class DeleteEntity(Document):
    """Requests that an entity be deleted."""

    name: str


class SetEntityState(Document):
    """Requests that an entity be moved to another pose."""

    name: str
    position_m: Vector
    orientation_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)


class EntityReply(Document):
    """The result of an entity request: the entity's pose, or the reason of the failure."""

    error: str = Field("", description="one line; empty: done")
    name: str = Field("", description="name of the entity in the world")
    position_m: Vector = (0.0, 0.0, 0.0)
    orientation_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)


class GetEntityBounds(Document):
    """Requests the box around an entity."""

    name: str


class EntityBoundsReply(Document):
    """The box, with sides along the axes of the entity's frame."""

    error: str = Field("", description="one line; empty: done")
    low_m: Vector = Field((0.0, 0.0, 0.0), description="its least x, y, z")
    high_m: Vector = Field((0.0, 0.0, 0.0), description="its greatest x, y, z")


class GetEntities(Document):
    """Requests the list of entities in the world."""

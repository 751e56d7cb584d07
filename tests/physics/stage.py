"""A world with little in it, where things come, move and go."""

from __future__ import annotations

from typing import Any

from mazebot.common.messages.documents import (
    BodyEntity,
    Box,
    Entities,
    Entity,
    Geometry,
    Material,
    ScriptedPath,
    Shape,
)
from mazebot.common.messages.topics import DESIRED_ENTITIES, ENTITIES, SCAN
from mazebot.physics.bodies.bodies import Bodies
from tests.physics.driver import Driver, texture, world

OPEN = world(walls=[("Wall", 4.0, 0.0, -2.0, 0.0)])
RED = Material(name="paint", ambient=(1.0, 0.0, 0.0, 1.0), diffuse=(1.0, 0.0, 0.0, 1.0))
CRATE = Box(size_m=(0.3, 0.3, 0.5))
PANEL_TEXTURE = texture(40)


def crate(
    name: str = "crate", x_m: float = 1.0, y_m: float = 0.0, z_m: float = 0.25,
    geometry: Geometry = CRATE, **changes: Any,
) -> BodyEntity:  # fmt: skip
    shape = Shape(name="all", geometry=geometry, material="paint")
    values = {"position_m": (x_m, y_m, z_m), "shapes": (shape,), "materials": (RED,)}
    return BodyEntity.model_validate({"name": name, **values, **changes})


def path(*waypoints_m: tuple[float, float], **changes: Any) -> ScriptedPath:
    values: dict[str, Any] = {"waypoints_m": waypoints_m, "speed_m_s": 0.4}
    return ScriptedPath.model_validate({**values, **changes})


class Stage(Driver):
    """A driver who desires sets of entities, one after the other."""

    def __init__(self, **config: object) -> None:
        super().__init__(**{"scan_noise_m": 0.0, **config})
        self.revision = 0

    def desire(self, *entities: Entity, revision: int | None = None) -> Entities:
        """What stands, as it was told in the step in which the set was read."""
        self.revision = self.revision + 1 if revision is None else revision
        # Not validated: a set may have come past the schema.
        desired = Entities.model_construct(
            world_hash=OPEN.hash, revision=self.revision, entities=entities, refused=()
        )
        told = len(self.all(ENTITIES))
        self.deliver(DESIRED_ENTITIES, desired)
        self.turn()
        assert len(self.all(ENTITIES)) <= told + 1
        return self.last(ENTITIES)

    @property
    def bodies(self) -> Bodies:
        assert self.node._simulation is not None
        return self.node._simulation.bodies

    def ahead_m(self) -> float:
        """What the lidar measures straight ahead, in the newest scan."""
        self.wait(0.11)
        return float(self.last(SCAN).ranges[0])


def names(told: Entities) -> list[str]:
    return [entity.name for entity in told.entities]


def reasons(told: Entities) -> dict[str, str]:
    return {refusal.name: refusal.reason for refusal in told.refused}

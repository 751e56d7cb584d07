"""Where a reset puts the entities: back to where they were first."""

from __future__ import annotations

from collections.abc import Container

from mazebot.common.messages.documents import Entities, Entity


def since_reset(desired: Entities, at_reset: Entities, kept: Container[str] | None) -> Entities:
    """The desired set as a reset leaves it, of which the spawner does not know yet; `at_reset` was
    the desired set at the reset.

    What has not been requested anew since is where it was first, or gone if its name is not in
    `kept`; None keeps all. The world's own markers that were deleted hang again.
    `since_reset(desired, desired, kept)` is the set after the reset itself.
    """
    before = {one.name: one for one in at_reset.entities}
    unmoved = {one.name for one in desired.entities if before.get(one.name) == one}
    stay = [
        one
        for one in desired.entities
        if kept is None or one.name in kept or one.name not in unmoved
    ]
    first = {one.name: one for one in desired.initial}
    gone = {one.name for one in at_reset.deleted}
    again = tuple(one for one in desired.deleted if one.name in gone)

    def returned(one: Entity) -> Entity:
        pose = first.get(one.name)
        if pose is None or one.name not in unmoved:
            return one
        update = {"position_m": pose.position_m, "orientation_xyzw": pose.orientation_xyzw}
        return one.model_copy(update=update)

    return desired.model_copy(
        update={
            "entities": (*again, *map(returned, stay)),
            "initial": tuple(pose for pose in desired.initial if pose.name not in unmoved),
            "deleted": tuple(one for one in desired.deleted if one not in again),
        }
    )

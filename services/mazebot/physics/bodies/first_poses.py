"""Where a reset puts the entities: back to where they were first."""

from __future__ import annotations

from mazebot.common.messages.documents import Entities, Entity


def since_reset(desired: Entities, at_reset: Entities) -> Entities:
    """The desired set as a reset leaves it, of which the spawner does not know yet; `at_reset` was
    the desired set at the reset.

    What has not been requested anew since is where it was first, and the world's own markers that
    were deleted hang again. `since_reset(desired, desired)` is the set after the reset itself.
    """
    before = {one.name: one for one in at_reset.entities}
    unmoved = {one.name for one in desired.entities if before.get(one.name) == one}
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
            "entities": (*again, *map(returned, desired.entities)),
            "initial": tuple(pose for pose in desired.initial if pose.name not in unmoved),
            "deleted": tuple(one for one in desired.deleted if one not in again),
        }
    )

"""What a reset has put back is desired from then on, and can be moved and deleted once more."""

from __future__ import annotations

from mazebot.common.messages import documents as doc
from mazebot.common.messages.topics import ENTITIES
from mazebot.common.node.node import Outbox
from tests.spawner.stage import Stage, box


def reset(stage: Stage, *things: doc.Entity) -> None:
    """Let the physics say that a reset has left these."""
    standing = stage.physics.standing
    assert standing is not None
    left = {"entities": things, "reset_epoch": 2, "initial": (), "deleted": ()}
    stage.physics.standing = standing.model_copy(update=left)
    Outbox(stage.physics, stage.transport._send).put(ENTITIES, stage.physics.standing)
    stage.turn()


def test_the_set_is_as_the_reset_has_left_it() -> None:
    stage = Stage()
    stage.spawn(box())
    (marker, _) = stage.physics.sets[-1].entities
    stage.move("box", 3.0)
    stage.delete(marker.name)
    desired = stage.physics.sets[-1]
    assert [(one.name, one.position_m) for one in desired.initial] == [("box", (1.0, 2.0, 0.2))]
    assert desired.deleted == (marker,)
    reset(stage, marker, box(placed=1))
    desired = stage.physics.sets[-1]
    assert desired.entities == (marker, box(placed=1))
    assert (desired.initial, desired.deleted, desired.reset_epoch) == ((), (), 2)
    # The same request as at first changes nothing, and the same move is one.
    assert stage.spawn(box()) == doc.EntityReply(name="box", position_m=(1.0, 2.0, 0.2))
    stage.move("box", 3.0)
    assert stage.physics.sets[-1].entities[1].position_m == (3.0, 2.0, 0.2)
    assert stage.delete(marker.name) == doc.EntityReply(name=marker.name)
    assert stage.latest_set() == ["box"]


def test_a_marker_whose_id_is_taken_does_not_hang_again() -> None:
    stage = Stage()
    (marker,) = stage.physics.sets[-1].entities
    assert isinstance(marker, doc.MarkerEntity)
    stage.delete(marker.name)
    other = marker.model_copy(update={"name": "other"})
    reply = stage.spawn(other)
    assert reply is not None
    assert not reply.error
    assert stage.physics.sets[-1].deleted == ()

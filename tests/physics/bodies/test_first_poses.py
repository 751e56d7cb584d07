"""Where things are after a reset: where they were first, whatever the spawner knows of it."""

from __future__ import annotations

from typing import Any, Literal

from mazebot.common.messages.documents import (
    BodyEntity,
    Entities,
    FirstPose,
    Planar,
    SimulationControl,
)
from mazebot.common.messages.topics import DESIRED_ENTITIES, ENTITIES, SIMULATION_CONTROL
from tests.physics.driver import panel
from tests.physics.stage import OPEN, PANEL_TEXTURE, Stage, crate


def moved(name: str, from_x_m: float, to_x_m: float) -> tuple[BodyEntity, FirstPose]:
    """One that has been moved once, and where it was first."""
    first = crate(name, from_x_m)
    pose = FirstPose(
        name=name, position_m=first.position_m, orientation_xyzw=first.orientation_xyzw
    )
    return crate(name, to_x_m, placed=1), pose


def take(stage: Stage, **values: Any) -> Entities:
    stage.revision += 1
    desired = Entities(world_hash=OPEN.hash, revision=stage.revision, **values)
    stage.deliver(DESIRED_ENTITIES, desired)
    stage.turn()
    return stage.last(ENTITIES)


def reset(stage: Stage, scope: Literal["all", "fresh"] = "all") -> Entities:
    stage.inbox.ask(SIMULATION_CONTROL, SimulationControl(reset=scope), lambda _: None)
    stage.turn()
    return stage.last(ENTITIES)


def places(told: Entities) -> dict[str, float]:
    return {one.name: one.position_m[0] for one in told.entities}


def test_a_reset_puts_back_what_was_moved_and_hangs_what_was_deleted(stage: Stage) -> None:
    stage.send_asset(PANEL_TEXTURE)
    sign = panel("sign", PANEL_TEXTURE.header.frame_id, position_m=(0.0, -1.923, 0.3))
    box, first = moved("box", 1.0, 2.0)
    before: dict[str, Any] = {"initial": (first,), "deleted": (sign,)}
    take(stage, entities=(box, crate("other", 3.0)), **before)
    told = reset(stage)
    assert places(told) == {"sign": 0.0, "box": 1.0, "other": 3.0}
    assert (told.initial, told.deleted, told.reset_epoch) == ((), (), 2)
    # A spawner that does not know of the reset yet asks for something else.
    told = take(stage, entities=(box, crate("other", 3.0), crate("new", 4.0)), **before)
    assert places(told) == {"sign": 0.0, "box": 1.0, "other": 3.0, "new": 4.0}
    again = box.model_copy(update={"placed": 2})
    assert places(take(stage, entities=(again,), **before)) == {"sign": 0.0, "box": 2.0}
    # One that knows of it moves to the same place once more.
    told = take(stage, entities=(box,), **before, reset_epoch=told.reset_epoch)
    assert places(told) == {"box": 2.0}
    assert places(reset(stage)) == {"sign": 0.0, "box": 1.0}


def test_where_another_stands_at_the_first_place_all_stay_where_they_were_moved_to(
    stage: Stage,
) -> None:
    box, first = moved("box", 1.0, 2.0)
    take(stage, entities=(box, crate("other", 1.0)), initial=(first,))
    told = reset(stage)
    assert places(told) == {"box": 2.0, "other": 1.0}
    assert not told.refused


def test_what_stands_at_the_robots_start_keeps_nothing_from_its_first_place(stage: Stage) -> None:
    away = SimulationControl(robot_pose=Planar(x_m=-3.0, y_m=0.0, yaw_rad=0.0))
    stage.inbox.ask(SIMULATION_CONTROL, away, lambda _: None)
    box, first = moved("box", 1.0, 2.0)
    assert len(take(stage, entities=(crate("start", 0.0), box), initial=(first,)).entities) == 2
    told = reset(stage)
    assert places(told) == {"box": 1.0}
    assert [one.name for one in told.refused] == ["start"]


def test_a_fresh_reset_removes_what_was_spawned(stage: Stage) -> None:
    box, first = moved("box", 1.0, 2.0)
    take(stage, entities=(box,), initial=(first,))
    assert places(reset(stage, "fresh")) == {}
    # A spawner that does not know of the reset yet asks for something else.
    told = take(stage, entities=(box, crate("new", 4.0)), initial=(first,))
    assert places(told) == {"new": 4.0}

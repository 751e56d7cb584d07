"""What becomes of requests: each is answered by what then stands, and changes nothing or all."""

from __future__ import annotations

import base64
import hashlib
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import (
    ASSETS,
    DELETE_ENTITY,
    GET_ENTITIES,
    GET_ENTITY_BOUNDS,
    SET_ENTITY_STATE,
    SPAWN_ENTITY,
)
from mazebot.common.world.geometry import TriangleMesh, mesh_to_bytes
from mazebot.common.world.marker_entities import marker_entities
from mazebot.common.world.marker_picture import draw
from mazebot.spawner.config import SpawnerConfig
from mazebot.spawner.desired_set import MAX_ASKED_FOR, MAX_ENTITY_BYTES
from mazebot.spawner.node import MAX_WAITING, MAX_WAITING_BYTES, SpawnerNode
from tests.common.house import marker, wall, world
from tests.spawner.stage import FORBIDDEN_X_M, HOUSE, Stage, box

FAR_M = FORBIDDEN_X_M + 1.0


def png(seed: int = 0) -> bytes:
    return draw(marker(id=seed), 8)


def as_assets(*files: bytes) -> dict[str, str]:
    return {hashlib.sha256(one).hexdigest(): base64.b64encode(one).decode() for one in files}


def textured(data: bytes, **changes: Any) -> doc.BodyEntity:
    material = doc.Material(name="red", texture_sha256=hashlib.sha256(data).hexdigest())
    return box(materials=(material,), **changes)


def triangle() -> bytes:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    up = np.array([[0.0, 0, 1]] * 3)
    return mesh_to_bytes(TriangleMesh(corners, up, np.zeros((3, 2)), np.array([[0, 1, 2]], "i4")))


def with_mesh(data: bytes) -> doc.BodyEntity:
    mesh = doc.Mesh(sha256=hashlib.sha256(data).hexdigest())
    return box(shapes=(doc.Shape(name="mesh", geometry=mesh),), materials=())


def hand_marker(id_: int = 8, x_m: float = 1.0, **changes: Any) -> tuple[doc.MarkerEntity, bytes]:
    """A marker on the house's wall, made as the world's own are."""
    house = world([wall(length_m=4.0)], [marker(id=id_, offset_m=x_m)])
    hung, textures = marker_entities(house)
    (data,) = textures.values()
    return hung.markers[0].model_copy(update={"name": f"hand_{id_}", **changes}), data


def test_a_thing_that_is_asked_for_stands_and_the_asker_is_told_where() -> None:
    stage = Stage()
    reply = stage.spawn(box(x_m=1.5))
    assert reply == doc.EntityReply(name="box", position_m=(1.5, 2.0, 0.2))
    assert stage.names() == ["aruco_7", "box"]
    assert stage.latest_set() == ["aruco_7", "box"]
    assert [one.revision for one in stage.physics.sets] == [0, 1]


def test_the_answer_comes_within_two_steps_and_while_the_simulation_is_paused() -> None:
    stage = Stage()
    stage.physics.paused = True
    began_ns = stage.executive.now_ns
    assert stage.spawn(box()) is not None
    assert stage.executive.now_ns == began_ns


def test_the_same_request_again_changes_nothing_and_is_done() -> None:
    stage = Stage()
    first, sets = stage.spawn(box()), len(stage.physics.sets)
    assert stage.spawn(box()) == first
    assert len(stage.physics.sets) == sets
    stage.move("box", 3.0)
    again = stage.spawn(box())
    assert again is not None
    assert (again.error, again.position_m) == ("", (3.0, 2.0, 0.2))


def test_another_thing_of_a_name_is_refused_or_renamed() -> None:
    stage = Stage()
    stage.spawn(box())
    reply = stage.spawn(box(x_m=3.0))
    assert reply == doc.EntityReply(error="name: 'box' already exists", name="box")
    renamed = [stage.spawn(box(x_m=float(x)), allow_renaming=True) for x in (3, 4, 3)]
    assert [one and one.name for one in renamed] == ["box_1", "box_2", "box_1"]
    for taken in ("wall", "aruco_7"):
        reply = stage.spawn(box(taken))
        assert reply is not None
        assert "already exists" in reply.error


def test_a_hundred_requests_at_once_for_one_name_make_one_body_and_each_is_answered() -> None:
    stage = Stage()
    same = stage.ask_all(SPAWN_ENTITY, *[doc.SpawnEntity(entity=box())] * 100)
    assert {one.error for one in same} == {""}
    too_far = stage.ask_all(SPAWN_ENTITY, *[doc.SpawnEntity(entity=box("far", FAR_M))] * 9)
    assert [one.error for one in too_far] == ["too far"] * 9
    different = [doc.SpawnEntity(entity=box("tin", float(x))) for x in range(100)]
    replies = stage.ask_all(SPAWN_ENTITY, *different)
    assert sorted({one.error for one in replies}) == ["", "name: 'tin' already exists"]
    assert sum(not one.error for one in replies) == 1
    assert stage.names() == ["aruco_7", "box", "tin"]


def test_what_the_physics_refuses_is_told_with_the_reason_and_taken_back() -> None:
    stage = Stage()
    good, bad = stage.ask_all(
        SPAWN_ENTITY, *(doc.SpawnEntity(entity=one) for one in (box("good"), box("bad", FAR_M)))
    )
    assert (good.error, bad.error) == ("", "too far")
    assert stage.latest_set() == ["aruco_7", "good"]
    assert stage.physics.standing is not None
    assert stage.physics.standing.refused == ()
    assert stage.physics.sets[-1].revision == 2


def test_a_move_that_is_refused_leaves_the_thing_where_it_was() -> None:
    stage = Stage()
    stage.spawn(box(x_m=1.0))
    moved = stage.move("box", 2.0)
    assert moved is not None
    assert (moved.error, moved.position_m) == ("", (2.0, 2.0, 0.2))
    refused = stage.move("box", FAR_M)
    assert refused is not None
    assert refused.error == "too far"
    (entity,) = stage.physics.sets[-1].bodies
    assert entity.position_m == (2.0, 2.0, 0.2)
    assert stage.names() == ["aruco_7", "box"]


def test_what_moves_by_itself_can_be_put_again_where_it_was_put_before() -> None:
    stage = Stage()
    for mass_kg, sets in ((0.0, 2), (1.0, 3)):
        stage = Stage()
        stage.spawn(box(mass_kg=mass_kg))
        reply = stage.move("box", 1.0)
        assert reply is not None
        assert not reply.error
        assert len(stage.physics.sets) == sets
    assert stage.physics.sets[-1].bodies[0].placed == 1


def test_a_thing_that_is_deleted_is_gone_and_its_name_is_free() -> None:
    stage = Stage()
    stage.spawn(box())
    assert stage.delete("box") == doc.EntityReply(name="box")
    assert stage.names() == ["aruco_7"]
    reply = stage.delete("box")
    assert reply is not None
    assert reply.error == "name: 'box': no such entity"
    again = stage.spawn(box(x_m=2.0))
    assert again is not None
    assert not again.error
    of_the_world = stage.delete("wall")
    assert of_the_world is not None
    assert of_the_world.error == "name: 'wall': is part of the world"


def test_requests_of_one_name_that_come_together_follow_each_other() -> None:
    stage = Stage()
    order: list[str] = []

    def told(word: str) -> Any:
        return lambda reply: order.append(f"{word} {reply.error or 'done'}")

    state = doc.SetEntityState(name="box", position_m=(3.0, 2.0, 0.2))
    stage.transport.ask(SPAWN_ENTITY, doc.SpawnEntity(entity=box()), told("spawn"))
    stage.transport.ask(SET_ENTITY_STATE, state, told("move"))
    stage.turn(8)
    stage.transport.ask(DELETE_ENTITY, doc.DeleteEntity(name="box"), told("delete"))
    stage.transport.ask(SET_ENTITY_STATE, state, told("move"))
    stage.turn(8)
    assert order == [
        "spawn done", "move done", "delete done", "move name: 'box': no such entity"
    ]  # fmt: skip
    assert stage.names() == ["aruco_7"]


def test_requests_of_one_name_keep_their_order() -> None:
    stage = Stage()
    stage.spawn(box())
    states = [doc.SetEntityState(name="box", position_m=(x, 2.0, 0.2)) for x in (2.0, 3.0, 2.0)]
    replies: list[doc.EntityReply] = []
    for state in states:
        stage.transport.ask(SET_ENTITY_STATE, state, replies.append)
    stage.turn(10)
    assert [one.position_m[0] for one in replies] == [2.0, 3.0, 2.0]
    assert stage.physics.sets[-1].bodies[0].position_m[0] == 2.0


def test_one_of_two_that_delete_at_once_is_told_that_there_is_nothing() -> None:
    stage = Stage()
    stage.spawn(box())
    answers = stage.ask_all(DELETE_ENTITY, *[doc.DeleteEntity(name="box")] * 2)
    stage.turn(3)
    assert [one and one.error for one in answers] == ["", "name: 'box': no such entity"]


def test_a_name_whose_spawning_is_refused_is_free_for_the_next() -> None:
    stage = Stage()
    requests = (
        doc.SpawnEntity(entity=box(x_m=FAR_M)),
        doc.SpawnEntity(entity=box(x_m=3.0), allow_renaming=True),
    )
    answers = stage.ask_all(SPAWN_ENTITY, *requests)
    stage.turn(3)
    assert [(one.name, one.error) for one in answers] == [("box", "too far"), ("box", "")]


def test_what_is_deleted_makes_room_only_for_what_is_requested_later() -> None:
    stage = Stage()
    stage.spawn(box())
    stage.transport.ask(SPAWN_ENTITY, doc.SpawnEntity(entity=box("tin")), lambda _: None)
    stage.transport.ask(DELETE_ENTITY, doc.DeleteEntity(name="box"), lambda _: None)
    stage.turn(8)
    names = [[one.name for one in desired.entities] for desired in stage.physics.sets[-2:]]
    assert names == [["aruco_7", "box", "tin"], ["aruco_7", "tin"]]


def test_the_worlds_markers_can_be_moved_and_deleted() -> None:
    stage = Stage()
    (entity,) = stage.physics.sets[-1].markers
    x, y, z = entity.position_m
    state = doc.SetEntityState(
        name="aruco_7", position_m=(x + 1.0, y, z), orientation_xyzw=entity.orientation_xyzw
    )
    assert stage.ask(SET_ENTITY_STATE, state).error == ""
    off = state.model_copy(update={"position_m": (x, y + 1.0, z)})
    assert stage.ask(SET_ENTITY_STATE, off).error == "floats 1.002 m off wall"
    assert stage.physics.sets[-1].markers[0].position_m == (x + 1.0, y, z)
    stage.delete("aruco_7")
    assert stage.names() == []


def test_a_marker_asked_for_by_hand_is_judged_as_the_worlds_are() -> None:
    stage = Stage()
    one, data = hand_marker(8, x_m=1.0)
    assert stage.spawn(one, assets=as_assets(data)) == doc.EntityReply(
        name="hand_8", position_m=one.position_m, orientation_xyzw=one.orientation_xyzw
    )
    for changes, reason in (
        ({"name": "b", "marker_id": 9}, "overlaps hand_8"),
        ({"name": "b", "marker_id": 7}, "marker_id: 7: must be unique: already used by 'aruco_7'"),
        ({"name": "b", "marker_id": 100}, "id: 100: must be less than 100 in DICT_4X4_100"),
        ({"name": "b", "marker_id": -1}, "marker_id: -1: must be 0 to 100000"),
        ({"name": "b", "dictionary": "QR", "marker_id": 9}, "dictionary: 'QR': must be one of"),
        ({"name": "b", "marker_id": 9, "panel_side_m": 0.1}, "marker_size_m: 0.3: must be at"),
        (
            {"name": "b", "marker_id": 9, "position_m": (0.0, 0.0, 5.0)},
            "does not lie flat on a face of wall",
        ),
    ):
        reply = stage.spawn(one.model_copy(update=changes), assets=as_assets(data))
        assert reply is not None
        assert reply.error.startswith(reason), reply.error
    assert stage.names() == ["aruco_7", "hand_8"]


def test_markers_hidden_by_a_mesh_of_the_world_are_refused() -> None:
    board = TriangleMesh(
        np.array([[-1.0, 0.3, 0], [1, 0.3, 0], [1, 0.3, 1], [-1, 0.3, 1]]),
        np.array([[0.0, 1, 0]] * 4), np.zeros((4, 2)), np.array([[0, 1, 2], [0, 2, 3]], "i4"),
    )  # fmt: skip
    data = mesh_to_bytes(board)
    shape = doc.Shape(
        name="board", material="plain", geometry=doc.Mesh(sha256=hashlib.sha256(data).hexdigest())
    )
    body = doc.Body(name="board", position_m=(0.0, 0.0, 0.0), shapes=(shape,))
    house = HOUSE.model_copy(update={"bodies": (body,)})
    house = house.model_copy(update={"hash": house.content_hash()})
    stage = Stage(None)
    stage.load(house)
    assert stage.spawner.waiting_for() == "meshes of the world on /world/assets"
    content = np.frombuffer(data, np.uint8)
    asset = msg.CompressedImage(
        msg.header(0, hashlib.sha256(data).hexdigest()), format="npz", data=content
    )
    stage.worldgen_outbox.put(ASSETS, asset)
    stage.turn()
    assert stage.spawner.waiting_for() is None
    ((_, reason),) = [(r.name, r.reason) for r in stage.physics.sets[-1].refused]
    assert reason == "is hidden by board, 0.198 m in front of it"


def test_assets_are_sent_once_and_only_whole() -> None:
    stage = Stage()
    sent = stage.sent_assets()
    data, mesh = png(), triangle()
    for one, files in ((textured(data), (data,)), (with_mesh(mesh), (mesh,))):
        named = one.model_copy(update={"name": f"thing_{len(sent)}"})
        reply = stage.spawn(named, assets=as_assets(*files))
        assert reply is not None
        assert not reply.error
    stage.spawn(textured(data, name="other", x_m=2.0))
    assert sent == [*as_assets(data), *as_assets(mesh)]
    stage.delete("other")
    assert len(sent) == 2
    # What nothing needed for a while may have been forgotten.
    stage.delete("thing_0")
    stage.spawn(textured(data, name="thing_0"), assets=as_assets(data))
    assert sent[2:] == [*as_assets(data)]


@pytest.mark.parametrize(
    ("entity", "assets", "reason"),
    [
        (textured(png()), {}, "must be given: used by the entity"),
        (box(), as_assets(png()), "is not used by"),
        (textured(png()), {next(iter(as_assets(png()))): "!!"}, "must be base64"),
        (textured(png()), {next(iter(as_assets(png()))): "AAAA"}, "does not match the"),
        (textured(png()[:-9]), as_assets(png()[:-9]), "is corrupt or truncated"),
        (textured(b"GIF8"), as_assets(b"GIF8"), "is a GIF, must be a PNG"),
        (with_mesh(b"no mesh"), as_assets(b"no mesh"), "is not a mesh file"),
        (with_mesh(triangle()[:-40]), as_assets(triangle()[:-40]), "is not a mesh file"),
        (with_mesh(png()), as_assets(png()), "is not a mesh file"),
        (box(""), {}, "name: '': must be 1 to 100 printable characters"),
        (box(" box"), {}, "must be 1 to 100 printable characters, without leading or "
                          "trailing spaces"),
        (box("a\nb"), {}, "must be 1 to 100 printable"),
        (box("x" * 101), {}, "must be 1 to 100"),
        (box("/map"), {}, "must not begin with a slash"),
        (box(x_m=1e9), {}, "must be within 1000 m"),
        (box(orientation_xyzw=(0.0, 0.0, 0.0, 0.0)), {}, "must be of unit length"),
        (box(materials=()), {}, "material: 'red': must be one of its materials"),
        (box(materials=box().materials * 2), {}, "materials: must have unique names"),
        (
            box(mass_kg=1.0, path=doc.ScriptedPath(waypoints_m=((1.0, 1.0),), speed_m_s=1.0)), {},
            "mass_kg: 1: must be 0: it follows a path",
        ),
        (box(shapes=box().shapes * 2000), {}, f"must be at most {MAX_ENTITY_BYTES}"),
    ],
)  # fmt: skip
def test_a_bad_request_is_refused_in_one_line_and_changes_nothing(
    entity: doc.BodyEntity, assets: dict[str, str], reason: str
) -> None:
    stage = Stage()
    reply = stage.spawn(entity, assets=assets)
    assert reply is not None
    assert reason in reply.error
    assert "\n" not in reply.error
    assert len(stage.physics.sets) == 1


def test_there_is_an_end_to_what_can_be_asked_for() -> None:
    stage = Stage()
    requests = [doc.SpawnEntity(entity=box(f"b{i}", i * 0.4)) for i in range(MAX_ASKED_FOR + 5)]
    replies = stage.ask_all(SPAWN_ENTITY, *requests)
    refused = [one.error for one in replies if one.error]
    assert refused == [f"too many entities: at most {MAX_ASKED_FOR}"] * 5
    assert len(stage.names()) == MAX_ASKED_FOR + 1


def test_hundreds_of_files_come_and_go_and_a_late_reader_is_still_given_those_in_use() -> None:
    stage = Stage()
    sent = stage.sent_assets()
    kept = png(1)
    stage.spawn(textured(kept, name="kept"), assets=as_assets(kept))
    for number in range(300):
        data = mesh_to_bytes(
            TriangleMesh(
                np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, number + 1.0]]), np.zeros((3, 3)),
                np.zeros((3, 2)), np.array([[0, 1, 2]], "i4"),
            )
        )  # fmt: skip
        stage.spawn(with_mesh(data), assets=as_assets(data))
        stage.delete("box")
        window = sent[-ASSETS.depth :]
        assert next(iter(as_assets(kept))) in window
    (own,) = stage.physics.sets[-1].markers
    assert own.texture_sha256 in window
    assert len(sent) < 400


def test_requests_wait_for_a_world_and_for_the_physics() -> None:
    stage = Stage(None)
    stage.physics.is_away = True
    replies: list[doc.EntityReply] = []
    stage.transport.ask(SPAWN_ENTITY, doc.SpawnEntity(entity=box()), replies.append)
    stage.turn()
    stage.load(HOUSE)
    assert replies == []
    stage.physics.is_away = False
    stage.turn()
    assert [one.error for one in replies] == [""]


def test_a_new_world_drops_what_was_asked_of_the_old() -> None:
    stage = Stage()
    stage.spawn(box())
    stage.physics.is_away = True
    replies: list[doc.EntityReply] = []
    for name in ("in_flight", "waits"):
        stage.transport.ask(SPAWN_ENTITY, doc.SpawnEntity(entity=box(name)), replies.append)
        stage.turn()
    other = world([wall()], [marker(id=9)])
    stage.load(other)
    assert len(replies) == 2
    assert all(one.error == "the world was replaced by 'test'"
               for one in replies)  # fmt: skip
    stage.physics.is_away = False
    stage.turn()
    assert stage.names() == ["aruco_9"]
    stage.load(other)
    assert stage.names() == ["aruco_9"]


def test_more_requests_than_can_wait_are_refused() -> None:
    stage = Stage()
    stage.physics.is_away = True
    replies: list[doc.EntityReply] = []
    for _ in range(3):
        for _ in range(MAX_WAITING // 2 + 1):
            stage.transport.ask(DELETE_ENTITY, doc.DeleteEntity(name="box"), replies.append)
        stage.turn(1)
    # The first ones are told at once that there is no box.
    errors = {one.error for one in replies}
    assert errors == {"name: 'box': no such entity"}
    stage.transport.ask(SPAWN_ENTITY, doc.SpawnEntity(entity=box()), replies.append)
    stage.turn(1)
    replies.clear()
    for _ in range(3):
        for _ in range(MAX_WAITING // 2 + 1):
            stage.transport.ask(DELETE_ENTITY, doc.DeleteEntity(name="box"), replies.append)
        stage.turn(1)
    assert {one.error for one in replies} == {f"too many requests: {MAX_WAITING} are pending"}


def test_more_bytes_than_can_wait_are_refused() -> None:
    stage = Stage(None)
    replies: list[doc.EntityReply] = []
    big = doc.SpawnEntity(entity=box(), assets={"a": "A" * (MAX_WAITING_BYTES // 3)})
    for _ in range(5):
        stage.transport.ask(SPAWN_ENTITY, big, replies.append)
    stage.transport.ask(SPAWN_ENTITY, doc.SpawnEntity(entity=box()), replies.append)
    stage.turn()
    assert len(replies) == 2
    assert {one.error[:15] for one in replies} == {"assets: too lar"}


def test_a_spawner_that_begins_anew_adopts_what_stands() -> None:
    stage = Stage()
    stage.spawn(box())
    stage.delete("aruco_7")
    stage.spawner = SpawnerNode(SpawnerConfig())
    stage.start()
    stage.load(HOUSE)
    assert stage.names() == ["box"]
    stage.restart_physics()
    assert stage.names() == ["box"]
    assert stage.spawn(box()) == doc.EntityReply(name="box", position_m=(1.0, 2.0, 0.2))
    stage.spawn(box("other", 2.0))
    assert stage.latest_set() == ["box", "other"]


def test_a_physics_that_begins_anew_is_told_what_should_stand() -> None:
    stage = Stage()
    stage.spawn(box())
    stage.restart_physics()
    assert stage.names() == ["aruco_7", "box"]
    assert stage.delete("box") == doc.EntityReply(name="box")


def test_a_physics_that_begins_anew_answers_what_was_asked_while_it_was_away() -> None:
    stage = Stage()
    stage.physics.is_away = True
    assert stage.spawn(box()) is None
    replies: list[doc.EntityReply] = []
    stage.transport.ask(SPAWN_ENTITY, doc.SpawnEntity(entity=box("tin", 2.0)), replies.append)
    stage.turn()
    stage.physics.sets += stage.waiting_sets()
    stage.restart_physics()
    assert stage.names() == ["aruco_7", "box", "tin"]
    assert [one.error for one in replies] == [""]


def test_what_moves_is_told_where_it_is() -> None:
    stage = Stage()
    stage.spawn(box(mass_kg=1.0))
    there = np.eye(4)
    there[:3, 3] = (5.0, 6.0, 0.2)
    stage.physics.moved = [
        msg.transform_stamped(0, "map", "box", there),
        msg.transform_stamped(0, "odom", "base_footprint", there),
    ]
    stage.turn()
    found = stage.ask(GET_ENTITIES, doc.GetEntities())
    assert found.bodies[0].position_m == (5.0, 6.0, 0.2)
    stage.physics.moved = []
    stage.physics.paused = True
    found = stage.ask(GET_ENTITIES, doc.GetEntities())
    assert found.bodies[0].position_m == (5.0, 6.0, 0.2)
    stage.move("box", 1.0)
    found = stage.ask(GET_ENTITIES, doc.GetEntities())
    assert found.bodies[0].position_m == (1.0, 2.0, 0.2)


def test_the_box_around_an_entity_is_told_in_its_frame() -> None:
    stage = Stage()
    turned = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
    parts = (
        doc.Shape(name="low", geometry=doc.Box(size_m=(0.4, 0.2, 0.2)), position_m=(0.1, 0, 0)),
        doc.Shape(
            name="high", geometry=doc.Cylinder(radius_m=0.05, length_m=0.6),
            position_m=(0.0, 0.0, 0.2),
        ),
        doc.Shape(name="bar", geometry=doc.Box(size_m=(1.0, 0.1, 0.1)), orientation_xyzw=turned),
    )  # fmt: skip
    stage.spawn(box(shapes=parts, orientation_xyzw=turned))
    reply = stage.ask(GET_ENTITY_BOUNDS, doc.GetEntityBounds(name="box"))
    assert (reply.error, reply.low_m, reply.high_m) == (
        "", pytest.approx((-0.1, -0.5, -0.1)), pytest.approx((0.3, 0.5, 0.5)),
    )  # fmt: skip
    none = stage.ask(GET_ENTITY_BOUNDS, doc.GetEntityBounds(name="x"))
    assert none.error == "no such entity"


def test_the_box_around_a_mesh_or_a_marker_is_told() -> None:
    stage = Stage()
    data = triangle()
    (sha256,) = as_assets(data)
    mesh = doc.Mesh(sha256=sha256, scale=(2.0, 1.0, 1.0))
    one = box(shapes=(doc.Shape(name="mesh", geometry=mesh),), materials=())
    reply = stage.spawn(one, assets=as_assets(data))
    assert reply is not None
    assert reply.error == ""
    (panel,) = stage.physics.sets[-1].markers
    half_m = panel.panel_side_m / 2.0
    for name, high_m in (("box", (2.0, 1.0, 0.0)), ("aruco_7", (half_m, half_m, 0.0))):
        bounds = stage.ask(GET_ENTITY_BOUNDS, doc.GetEntityBounds(name=name))
        assert (bounds.error, bounds.high_m) == ("", pytest.approx(high_m))


_NAMES = st.sampled_from(["a", "b", "c"])
_PLACES_M = st.sampled_from([1.0, 2.0, FAR_M])
_ASKED = st.one_of(
    st.builds(
        lambda name, x_m, new_name: (
            SPAWN_ENTITY,
            doc.SpawnEntity(entity=box(name, x_m), allow_renaming=new_name),
        ),
        _NAMES,
        _PLACES_M,
        st.booleans(),
    ),
    st.builds(lambda name: (DELETE_ENTITY, doc.DeleteEntity(name=name)), _NAMES),
    st.builds(
        lambda name, x_m: (
            SET_ENTITY_STATE,
            doc.SetEntityState(name=name, position_m=(x_m, 2.0, 0.2)),
        ),
        _NAMES,
        _PLACES_M,
    ),
)


@settings(max_examples=30)
@given(st.lists(st.lists(_ASKED, max_size=6), max_size=5))
def test_whatever_is_asked_at_once_each_is_answered_once_and_what_stands_is_what_should(
    batches: list[list[tuple[Any, Any]]],
) -> None:
    stage = Stage()
    for batch in batches:
        replies: list[list[doc.EntityReply]] = [[] for _ in batch]
        for (query, message), kept in zip(batch, replies, strict=True):
            assert stage.transport.ask(query, message, kept.append)
        stage.turn(2 * len(batch) + 3)
        assert [len(kept) for kept in replies] == [1] * len(batch)
        standing = stage.physics.standing
        assert standing is not None
        assert standing.refused == ()
        assert standing.entities == stage.physics.sets[-1].entities
        assert standing.revision == stage.physics.sets[-1].revision
        assert all(one.position_m[0] < FAR_M for one in standing.entities)


@settings(max_examples=30)
@given(
    st.builds(
        box,
        st.text(max_size=8),
        orientation_xyzw=st.tuples(*[st.floats(-1e308, 1e308)] * 4),
        position_m=st.tuples(*[st.floats(-1e308, 1e308)] * 3),
        mass_kg=st.floats(0.0, 1e308),
    )
)
def test_whatever_a_body_says_it_is_answered_in_one_line(entity: doc.BodyEntity) -> None:
    stage = Stage()
    reply = stage.spawn(entity)
    assert reply is not None
    assert "\n" not in reply.error
    assert (reply.error == "") == (entity.name in stage.names())

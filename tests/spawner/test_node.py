from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mazebot.common.maths.frames import SE2, rotation_from_quaternion
from mazebot.common.messages import wire
from mazebot.common.messages.documents import Entities, Marker, World
from mazebot.common.messages.topics import ASSETS, DESIRED_ENTITIES, WORLD, Topic
from mazebot.common.node.node import Envelope, Inbox, Outbox
from mazebot.common.world.marker_entities import MAX_MARKERS, marker_entities
from mazebot.spawner.config import SpawnerConfig
from mazebot.spawner.node import SpawnerNode
from mazebot.worldgen.recipe.loader import load_world
from tests.common.house import marker, wall, world

Sent = list[tuple[Topic[object], object, Envelope]]


def run(node: SpawnerNode, *worlds: World) -> Sent:
    """What the node sends in one step in which the worlds have come."""
    sent: Sent = []
    inbox, outbox = Inbox(node), Outbox(node, lambda *message: sent.append(message))
    for number, one in enumerate(worlds):
        inbox.deliver(WORLD, one, Envelope("worldgen", number, 0, one.hash))
    node.step(0, inbox, outbox)
    return sent


def refusals(markers: Sequence[Marker]) -> list[tuple[str, str]]:
    desired, _ = marker_entities(world([wall(length_m=4.0)], markers))
    return [(refusal.name, refusal.reason) for refusal in desired.refused]


def test_the_markers_of_the_house_hang_where_they_should() -> None:
    node = SpawnerNode(SpawnerConfig())
    assert node.waiting_for() == "a world"
    house = load_world("sim_house_enhanced").world
    sent = run(node, house)
    assert node.waiting_for() is None
    assert [topic for topic, _, _ in sent] == [ASSETS, ASSETS, DESIRED_ENTITIES]
    assert {envelope.world_hash for _, _, envelope in sent} == {house.hash}
    desired = sent[-1][1]
    assert isinstance(desired, Entities)
    assert (desired.world_hash, desired.refused) == (house.hash, ())
    by_id = {entity.marker_id: entity for entity in desired.markers}
    assert by_id[60].position_m == pytest.approx((1.4788, 2.0812, 0.25), abs=1e-4)
    assert by_id[80].position_m == pytest.approx((-1.8015, 0.4270, 0.25), abs=1e-4)
    for entity in desired.markers:
        # The face looks to the east, right is north, up is up.
        rotation = rotation_from_quaternion(*entity.orientation_xyzw)
        assert rotation == pytest.approx(
            np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], np.float64), abs=1e-5
        )
        assert entity.panel_side_m == pytest.approx(0.4)
        assert (entity.marker_size_m, entity.dictionary) == (0.3, "DICT_4X4_100")


def test_each_texture_is_sent_under_its_hash_and_survives_the_wire() -> None:
    sent = run(SpawnerNode(SpawnerConfig()), load_world("sim_house_enhanced").world)
    assets = {}
    for topic, message, _ in sent:
        data = wire.encode(topic, message)
        assert wire.encode(topic, wire.decode(topic, data)) == data
        if topic is ASSETS:
            picture = message.data.tobytes()  # type: ignore[attr-defined]
            assets[message.header.frame_id] = picture  # type: ignore[attr-defined]
    assert all(hashlib.sha256(data).hexdigest() == sha256 for sha256, data in assets.items())
    desired = sent[-1][1]
    assert isinstance(desired, Entities)
    assert [entity.texture_sha256 for entity in desired.markers] == list(assets)


def test_a_world_without_markers_wants_nothing() -> None:
    bare = load_world("sim_house_enhanced", use_aruco=False).world
    assert [message for _, message, _ in run(SpawnerNode(SpawnerConfig()), bare)] == [
        Entities(world_hash=bare.hash)
    ]


def test_the_newest_world_counts() -> None:
    node = SpawnerNode(SpawnerConfig())
    first, second = world([wall()], [marker()]), world([wall()], [marker(id=8)])
    assert run(node, first)[-1][1].world_hash == first.hash  # type: ignore[attr-defined]
    assert run(node) == []
    desired = run(node, first, second)[-1][1]
    assert isinstance(desired, Entities)
    assert [entity.name for entity in desired.markers] == ["aruco_8"]
    assert node.world_hash == second.hash


def test_one_bad_marker_is_refused_and_the_others_hang(caplog: pytest.LogCaptureFixture) -> None:
    one = world([wall()], [marker(id=1, height_m=0.0), marker(id=2)])
    with caplog.at_level(logging.INFO, "spawner"):
        desired = run(SpawnerNode(SpawnerConfig()), one)[-1][1]
    assert isinstance(desired, Entities)
    assert [entity.name for entity in desired.markers] == ["aruco_2"]
    reason = "extends 0.200 m below the floor"
    assert [(r.name, r.reason) for r in desired.refused] == [("aruco_1", reason)]
    assert [(r.levelname, r.getMessage()) for r in caplog.records] == [
        ("ERROR", f"aruco_1 rejected: {reason}"), ("INFO", "Spawned 1 of 2 markers"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("second", "reason"),
    [
        (marker(id=1, offset_m=1.0), "id: 1: must be unique: already on wall"),
        (marker(id=1, side="right", dictionary="DICT_4X4_250"), "id: 1: must be unique: already"),
        (marker(id=2, offset_m=0.1), "overlaps aruco_1"),
        (marker(id=2, wall="roof"), "wall: 'roof': no such wall"),
        (marker(id=200), "id: 200: must be less than 100 in DICT_4X4_100"),
        (marker(id=2, dictionary="QR"), "dictionary: 'QR': must be one of DICT_4X4_100"),
        (marker(id=2, size_m=1e308), "must lie within 10000 m"),
    ],
)
def test_a_second_marker_is_refused_with_the_reason(second: Marker, reason: str) -> None:
    ((name, found),) = refusals([marker(id=1), second])
    assert name == f"aruco_{second.id}"
    assert found.startswith(reason)


def test_there_are_no_more_markers_than_a_late_reader_is_given() -> None:
    many = [
        marker(
            id=id_, dictionary="DICT_4X4_250", size_m=0.03, offset_m=-1.9 + 0.05 * (id_ // 2),
            height_m=0.1 + 0.1 * (id_ % 2),
        )
        for id_ in range(MAX_MARKERS + 6)
    ]  # fmt: skip
    assert refusals(many) == [
        (f"aruco_{id_}", f"too many markers: at most {MAX_MARKERS}")
        for id_ in range(MAX_MARKERS, MAX_MARKERS + 6)
    ]


@settings(max_examples=60)
@given(
    st.builds(
        marker, id=st.integers(0, 100_000), side=st.sampled_from(["left", "right"]),
        offset_m=st.floats(allow_nan=False, allow_infinity=False),
        height_m=st.floats(allow_nan=False, allow_infinity=False),
        size_m=st.floats(0.0, exclude_min=True, allow_nan=False, allow_infinity=False),
        quiet_zone_modules=st.integers(1, 16), dictionary=st.sampled_from(["DICT_4X4_50", "x"]),
    )
)  # fmt: skip
def test_whatever_a_marker_says_it_hangs_or_is_refused(one: Marker) -> None:
    desired, textures = marker_entities(world([wall()], [one]))
    assert len(desired.markers) + len(desired.refused) == 1
    assert len(desired.markers) == len(textures)
    assert all("\n" not in refusal.reason for refusal in desired.refused)


def test_a_wall_at_any_yaw_has_a_good_pose_for_its_marker() -> None:
    for yaw_rad in np.linspace(-3.0, 3.0, 7):
        host = wall(pose=SE2(1.0, 2.0, float(yaw_rad)))
        ahead = host.map_from_wall() @ SE2(0.0, 2.0, 0.0)
        desired, _ = marker_entities(world([host], [marker()], start=ahead))
        (entity,) = desired.markers
        normal = rotation_from_quaternion(*entity.orientation_xyzw)[:, 2]
        towards = np.array([ahead.x_m, ahead.y_m]) - entity.position_m[:2]
        assert normal[:2] @ towards == pytest.approx(2.0 - 0.1 - 0.002)

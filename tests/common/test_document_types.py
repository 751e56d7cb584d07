"""Documents as messages of the package mazebot_msgs."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest
from pydantic import JsonValue

from mazebot.cli.pages.ros_package import package_files
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import cdr, document_types, wire
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Document
from mazebot.common.messages.topics import ENTITIES, NAVIGATION_CHECKPOINT, TOPICS, WORLD
from tests.common.samples import PLANAR, SAMPLES

DOCUMENTS = [topic for topic in TOPICS if issubclass(topic.type, Document)]
ROS_NAME = re.compile(r"[a-z](?:_?[a-z0-9])*")
C_WORDS = {"false", "true", "int", "float", "bool", "char", "long", "short", "default", "register"}


def there_and_back(document: Document) -> Any:
    """A document after its time on the wire."""
    kind = type(document)
    data = cdr.encode(document_types.type_name_of(kind), document_types.pack(document))
    message = msg.TYPESTORE.deserialize_cdr(data, document_types.type_name_of(kind))
    return wire.document_of(kind, message)


@pytest.mark.parametrize("topic", DOCUMENTS, ids=lambda topic: topic.name)
def test_a_document_is_the_same_after_the_wire(topic: Any) -> None:
    assert there_and_back(SAMPLES[topic]) == SAMPLES[topic]


@pytest.mark.parametrize("topic", DOCUMENTS, ids=lambda topic: topic.name)
def test_the_bytes_are_those_of_the_library_that_encodes_ros_messages(topic: Any) -> None:
    kind = document_types.type_name_of(topic.type)
    message = document_types.pack(SAMPLES[topic])
    assert wire.encode(topic, SAMPLES[topic]) == bytes(msg.TYPESTORE.serialize_cdr(message, kind))


@pytest.mark.parametrize(
    "goal",
    [
        act.NavigateToPose(pose=PLANAR), act.NavigateThroughPoses(poses=(PLANAR, PLANAR)),
        act.FollowWaypoints(
            poses=(PLANAR,), tasks=(act.WaypointTask(wait_s=1.0, photo=True, input_timeout_s=2.0),)
        ),
        act.FollowPath(path=(PLANAR,)), act.Spin(), act.BackUp(), act.DriveOnHeading(), act.Wait(),
        act.AssistedTeleop(), act.DockRobot(), act.DockRobot(dock_pose=PLANAR), act.UndockRobot(),
        None,
    ],
)  # fmt: skip
def test_each_goal_of_a_checkpoint_is_the_same_after_the_wire(goal: Any) -> None:
    document = SAMPLES[NAVIGATION_CHECKPOINT].model_copy(update={"goal": goal})
    assert there_and_back(document) == document


@pytest.mark.parametrize("markers", [None, (), "one"])
def test_no_list_is_not_an_empty_one(markers: Any) -> None:
    one = doc.MappedMarker(
        dictionary="DICT_4X4_50", marker_id=3, position_m=(1.0, 2.0, 3.0),
        orientation_xyzw=(0.0, 0.0, 0.0, 1.0),
    )  # fmt: skip
    known = (one,) if markers == "one" else markers
    world = SAMPLES[WORLD].model_copy(update={"mapped_markers": known})
    assert there_and_back(world).mapped_markers == known


def test_any_json_value_of_a_parameter_is_the_same_after_the_wire() -> None:
    values: dict[str, JsonValue] = {
        "a": 1, "b": 1.5, "c": None, "d": [1, "x", {"y": [True]}], "e": "ü\n\"", "f": "",
    }  # fmt: skip
    document = doc.Parameters(service="physics", values=values)
    assert there_and_back(document) == document
    assert type(there_and_back(document).values["a"]) is int


def test_two_values_for_one_are_refused() -> None:
    entity = document_types.pack(SAMPLES[ENTITIES]).entities[0]
    data = document_types.pack(SAMPLES[ENTITIES])
    changes: list[dict[str, Any]] = [
        {"marker_entity": [], "body_entity": []}, {"marker_entity": [1, 2]}
    ]  # fmt: skip
    for change in changes:
        wrong = dataclasses.replace(data, entities=[dataclasses.replace(entity, **change)])
        with pytest.raises(wire.WireError, match=r"invalid schema: .*must be (1|one)"):
            wire.document_of(doc.Entities, wrong)


def test_what_is_none_is_an_empty_list() -> None:
    feedback = act.ActionFeedback(goal_id="a", action="spin")
    assert len(document_types.pack(feedback).distance_remaining_m) == 0
    assert there_and_back(feedback) == feedback
    near = feedback.model_copy(update={"distance_remaining_m": 0.0})
    assert there_and_back(near) == near
    state = act.CollisionMonitorState(action="stop", nearest_m=(1.0, 2.0))
    assert there_and_back(state) == state
    np.testing.assert_array_equal(document_types.pack(state).nearest_m, (1.0, 2.0))


def test_a_field_without_a_rule_is_told_with_its_name() -> None:
    class Odd(Document):
        """A set has no order."""

        things: set[int]

    with pytest.raises(TypeError, match=r"Odd\.things: no message field for set\[int\]"):
        document_types.type_name_of(Odd)


def test_the_package_has_every_topic_and_names_that_ros_and_c_take() -> None:
    files = package_files()
    texts = {path: text for path, text in files.items() if path.endswith(".msg")}
    for topic in DOCUMENTS:
        assert f"msg/{wire.type_name(topic).rpartition('/')[2]}.msg" in texts
    for path, text in texts.items():
        assert re.fullmatch(r"msg/[A-Z][A-Za-z0-9]*\.msg", path)
        assert path in files["CMakeLists.txt"]
        for line in text.splitlines():
            if not line.startswith("#"):
                kind, name, *_ = line.partition("#")[0].split()
                assert ROS_NAME.fullmatch(name), line
                assert name not in C_WORDS
                nested = kind.partition("[")[0]
                assert nested.islower() or f"msg/{nested}.msg" in texts

"""simulation_interfaces, beside the queries that answer it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from mazebot.common.config import ServiceConfig
from mazebot.common.messages import documents as doc
from mazebot.common.messages.topics import GET_ENTITY_BOUNDS, READ_MODEL, Query
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.common.ros import simulation as sim
from mazebot.common.ros.interfaces import interfaces
from mazebot.common.ros.table import ROS_SERVICES, services_of
from mazebot.worldgen.models.model_reading import entity_of

BOX = {
    "name": "box", "kind": "body", "position_m": [0, 0, 0],
    "shapes": [{"name": "box", "geometry": {"kind": "box", "size_m": [0.2, 0.2, 0.2]}}],
}  # fmt: skip
BODY = doc.BodyEntity.model_validate({**BOX, "name": "crate_1", "position_m": [1, 2, 0.1]})
OTHER = BODY.model_copy(update={"name": "crate_2"})


class Idle(Node):
    name = "spawner"
    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        pass


class Spawner:
    """Answers the queries, and keeps them."""

    def __init__(self, error: str = "") -> None:
        self.asked: list[Any] = []
        self.entities: tuple[doc.Entity, ...] = (BODY, OTHER)
        self._error = error

    def __call__(self, query: Query[Any, Any], document: Any) -> Any:
        assert isinstance(document, query.request)
        self.asked.append(document)
        if query is READ_MODEL:
            return entity_of(document)
        if query.response is doc.Entities:
            return doc.Entities(world_hash="", entities=self.entities)
        if query is GET_ENTITY_BOUNDS:
            return doc.EntityBoundsReply(
                error=self._error, low_m=(-0.1, -0.2, -0.3), high_m=(0.1, 0.2, 0.3)
            )
        return doc.EntityReply(error=self._error, name="box_1")


def answer(
    name: str,
    values: Mapping[str, Any],
    reply: Callable[[Query[Any, Any], Any], Any],
    distro: str = "jazzy",
) -> Any:
    """The response, over its bytes."""
    types = interfaces(distro)
    (service,) = (one for one in ROS_SERVICES if one.name == name)
    data = types.encode(f"{service.type}_Request", values)
    steps = service.handle(types.decode(f"{service.type}_Request", data), Idle())
    answered: Any = None
    while True:
        try:
            answered = reply(*steps.send(answered))
        except StopIteration as end:
            made = types.encode(f"{service.type}_Response", end.value)
            return types.read(f"{service.type}_Response", made)


@pytest.mark.parametrize("distro", ["jazzy", "lyrical"])
def test_an_entity_is_spawned_by_both_forms_of_the_request(distro: str) -> None:
    resource = {"resource_string": json.dumps(BOX)}
    form = {"entity_resource": resource} if distro == "lyrical" else resource
    pose = {"position": {"x": 0.5, "y": -0.9}, "orientation": {"z": 1.0}}
    values = {"name": "crate", "initial_pose": {"pose": pose}, "allow_renaming": True, **form}
    spawner = Spawner()
    response = answer("/spawn_entity", values, spawner, distro)
    assert (response.result.result, response.entity_name) == (sim.OK, "box_1")
    (wanted,) = spawner.asked
    assert (wanted.entity.name, wanted.allow_renaming) == ("crate", True)
    assert wanted.entity.position_m == (0.5, -0.9, 0.0)
    assert wanted.entity.orientation_xyzw == (0.0, 0.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("values", "code", "text"),
    [
        ({"uri": "file:///box.sdf"}, sim.UNSUPPORTED_FORMAT, "uri"),
        ({}, sim.NO_RESOURCE, "resource_string"),
        ({"resource_string": "<sdf/>"}, sim.PARSE_ERROR, "resource_string.sdf"),
        ({"resource_string": "<robot"}, sim.PARSE_ERROR, "resource_string.urdf"),
        ({"resource_string": "{}", "uri": "model://sun"}, sim.UNSUPPORTED_FORMAT, "uri"),
        ({"uri": "model://../worlds"}, sim.UNSUPPORTED_FORMAT, "uri"),
        ({"uri": "model://no_such_model"}, sim.NO_RESOURCE, "must be"),
        ({"resource_string": '{"kind": "body"}'}, sim.PARSE_ERROR, "Field required"),
        (
            {"resource_string": json.dumps(BOX), "entity_namespace": "a"},
            sim.NAMESPACE_UNSUPPORTED, "entity_namespace",
        ),
        (
            {"resource_string": json.dumps(BOX), "name": "crate_1"},
            sim.NAME_NOT_UNIQUE, "in use",
        ),
        (
            {
                "resource_string": json.dumps(BOX),
                "initial_pose": {"header": {"frame_id": "odom"}},
            },
            sim.INVALID_POSE, "must be map",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_spawned_says_why(values: Mapping[str, Any], code: int, text: str) -> None:
    spawner = Spawner()
    response = answer("/spawn_entity", values, spawner)
    assert response.result.result == code
    assert text in response.result.error_message
    assert not any(isinstance(one, doc.SpawnEntity) for one in spawner.asked)


SDF = """<?xml version="1.0"?>
<sdf version="1.9"><model name="crate"><link name="link">
  <inertial><mass>2.5</mass></inertial>
  <collision name="c"><geometry><box><size>0.3 0.2 0.4</size></box></geometry></collision>
  <visual name="v"><geometry><box><size>0.3 0.2 0.4</size></box></geometry></visual>
</link></model></sdf>"""
URDF = """<robot name="post"><link name="base">
  <collision><geometry><cylinder radius="0.1" length="0.5"/></geometry></collision>
</link></robot>"""


@pytest.mark.parametrize(
    ("text", "name", "given", "mass_kg"),
    [(SDF, "", "crate", 2.5), (SDF, "mine", "mine", 2.5), (URDF, "", "post", None)],
)
def test_a_model_of_gazebo_is_spawned(
    text: str, name: str, given: str, mass_kg: float | None
) -> None:
    pose = {"position": {"x": 0.5, "y": -0.9, "z": 0.2}, "orientation": {"w": 1.0}}
    values = {"name": name, "resource_string": text, "initial_pose": {"pose": pose},
              "allow_renaming": True}  # fmt: skip
    spawner = Spawner()
    response = answer("/spawn_entity", values, spawner)
    assert response.result.result == sim.OK, response.result.error_message
    wanted = spawner.asked[-1]
    assert (wanted.entity.name, wanted.entity.position_m) == (given, (0.5, -0.9, 0.2))
    assert wanted.entity.shapes
    if mass_kg is not None:
        assert wanted.entity.mass_kg == mass_kg


@pytest.mark.parametrize("uri", ["unit_box", "model://unit_box"])
def test_a_model_is_spawned_by_its_name(uri: str, tmp_path: Path) -> None:
    folder = tmp_path / "unit_box"
    folder.mkdir()
    (folder / "model.config").write_text("<model><sdf version='1.9'>model.sdf</sdf></model>")
    (folder / "model.sdf").write_text(SDF)

    class Shelf(Spawner):
        def __call__(self, query: Query[Any, Any], document: Any) -> Any:
            return (
                entity_of(document, tmp_path)
                if query is READ_MODEL
                else super().__call__(query, document)
            )

    spawner = Shelf()
    response = answer("/spawn_entity", {"uri": uri, "allow_renaming": True}, spawner)
    assert response.result.result == sim.OK, response.result.error_message
    assert spawner.asked[-1].entity.name == "crate"


def test_entities_are_listed_by_the_pattern_of_their_names() -> None:
    for pattern, names in (
        ("", ["crate_1", "crate_2"]), ("_2$", ["crate_2"]), ("^crate", ["crate_1", "crate_2"]),
        ("1|x", ["crate_1"]), ("none", []),
    ):  # fmt: skip
        response = answer("/get_entities", {"filters": {"filter": pattern}}, Spawner())
        assert (response.result.result, response.entities) == (sim.OK, names)
    states = answer("/get_entities_states", {}, Spawner())
    assert [one.pose.position.x for one in states.states] == [1.0, 1.0]
    assert states.states[0].header.frame_id == "map"


@pytest.mark.parametrize(
    "filters",
    [
        {"filter": "(a+)+$"}, {"filter": "a*b*c*"}, {"filter": "*"},
        {"categories": [{"category": 9}]}, {"bounds": {"points": [{"x": 1.0}]}},
        {"bounds": {"type": 1}}, {"bounds": {"type": 4, "points": [{}, {}]}},
        {"bounds": {"type": 2, "points": [{}, {}]}}, {"bounds": {"type": 2, "points": [{}] * 257}},
        {"bounds": {"type": 3, "points": [{}, {"x": -0.1}]}},
    ],
)  # fmt: skip
def test_a_filter_that_is_unknown_or_could_take_forever_is_not_supported(
    filters: Mapping[str, Any],
) -> None:
    spawner = Spawner()
    response = answer("/get_entities", {"filters": filters}, spawner)
    assert response.result.result == sim.FEATURE_UNSUPPORTED
    assert not spawner.asked


MARKER = doc.MarkerEntity(
    name="m5", position_m=(0.0, 0.0, 0.0), orientation_xyzw=(0.0, 0.0, 0.0, 1.0), panel_side_m=0.2,
    texture_sha256="", marker_id=5, marker_size_m=0.15, dictionary="DICT_4X4_50",
)  # fmt: skip
PUSHED = BODY.model_copy(update={"name": "ball", "mass_kg": 0.5})
WALKER = BODY.model_copy(
    update={
        "name": "walker",
        "path": doc.ScriptedPath(waypoints_m=((1.0, 1.0),), speed_m_s=0.4),
    }
)


def test_an_entity_is_of_a_category_and_has_tags() -> None:
    spawner = Spawner()
    spawner.entities = (BODY, PUSHED, WALKER, MARKER)
    found = {
        name: answer("/get_entity_info", {"entity": name}, spawner).info
        for name in ("crate_1", "ball", "walker", "m5")
    }
    # STATIC_OBJECT, OBJECT, DYNAMIC_OBJECT, STATIC_OBJECT
    assert [info.category.category for info in found.values()] == [5, 0, 4, 5]
    assert [info.tags for info in found.values()] == [["body"]] * 3 + [["marker"]]
    assert found["m5"].description == "ArUco marker 5 of DICT_4X4_50, 0.15 m"
    assert found["ball"].description == "box; 0.5 kg"
    assert "0.4 m/s" in found["walker"].description
    for filters, names in (
        ({"categories": [{"category": 5}]}, ["crate_1", "m5"]),
        ({"categories": [{"category": 0}, {"category": 4}]}, ["ball", "walker"]),
        ({"tags": {"tags": ["marker", "x"]}}, ["m5"]),
        ({"tags": {"tags": ["marker", "x"], "filter_mode": 1}}, []),
        ({"tags": {"tags": ["body"]}, "filter": "l", "categories": [{"category": 4}]}, ["walker"]),
    ):
        response = answer("/get_entities", {"filters": filters}, spawner)
        assert (response.result.result, response.entities) == (sim.OK, names)
    assert answer("/get_entity_info", {"entity": "x"}, spawner).result.result == sim.NOT_FOUND


def test_an_entity_has_bounds() -> None:
    response = answer("/get_entity_bounds", {"entity": "crate_1"}, Spawner())
    assert (response.result.result, response.bounds.type) == (sim.OK, 1)
    corners = [(point.x, point.y, point.z) for point in response.bounds.points]
    assert corners == [(0.1, 0.2, 0.3), (-0.1, -0.2, -0.3)]
    unknown = answer("/get_entity_bounds", {"entity": "x"}, Spawner())
    assert unknown.result.result == sim.NOT_FOUND
    failed = answer("/get_entity_bounds", {"entity": "crate_1"}, Spawner("no mesh"))
    assert (failed.result.result, failed.result.error_message) == (sim.OPERATION_FAILED, "no mesh")


def test_an_entity_has_a_state_that_can_be_set() -> None:
    spawner = Spawner()
    assert answer("/get_entity_state", {"entity": "crate_1"}, spawner).state.pose.position.y == 2.0
    state = {"header": {"frame_id": "world"}, "pose": {"position": {"x": 3.0}}}
    values = {"entity": "crate_1", "state": state}
    assert answer("/set_entity_state", values, spawner).result.result == sim.OK
    assert spawner.asked[-1].position_m == (3.0, 0.0, 0.0)
    for part in ("twist", "acceleration"):
        moving = {"entity": "crate_1", "state": {**state, part: {"linear": {"x": 1.0}}}}
        response = answer("/set_entity_state", moving, spawner)
        assert response.result.result == sim.FEATURE_UNSUPPORTED
        assert response.result.error_message.startswith(f"state.{part}: must be zero")
    for name in ("/get_entity_state", "/set_entity_state", "/delete_entity"):
        assert answer(name, {"entity": "none"}, spawner).result.result == sim.NOT_FOUND
    response = answer("/delete_entity", {"entity": "crate_1"}, Spawner("it is bolted down"))
    assert response.result.result == sim.OPERATION_FAILED
    assert response.result.error_message == "it is bolted down"


@pytest.mark.parametrize(
    ("flags", "result", "told"),
    [
        ({"set_pose": True}, sim.OK, ""),
        ({"set_pose": True, "set_twist": True}, sim.FEATURE_UNSUPPORTED, "set_twist"),
        ({"set_acceleration": True}, sim.FEATURE_UNSUPPORTED, "set_acceleration"),
        ({}, sim.OPERATION_FAILED, "set_pose"),
    ],
)
def test_since_2_the_flags_say_what_of_a_state_is_set(
    flags: Mapping[str, bool], result: int, told: str
) -> None:
    spawner = Spawner()
    # A twist that is not to be set says nothing.
    state = {"pose": {"position": {"x": 3.0}}, "twist": {"linear": {"x": 1.0}}}
    values = {"entity": "crate_1", "state": state, **flags}
    response = answer("/set_entity_state", values, spawner, "lyrical")
    assert response.result.result == result
    assert response.result.error_message.startswith(told)
    moved = [one for one in spawner.asked if isinstance(one, doc.SetEntityState)]
    assert [one.position_m for one in moved] == [(3.0, 0.0, 0.0)] * (result == sim.OK)


@pytest.mark.parametrize(
    ("scope", "reset"), [(0, "fresh"), (255, "fresh"), (3, "all"), (1, "time"), (2, ""), (4, "")]
)
def test_a_reset_has_a_scope(scope: int, reset: str) -> None:
    asked: list[Any] = []

    def reply(query: Query[Any, Any], document: Any) -> doc.SimulationControlReply:
        asked.append(document.reset)
        return doc.SimulationControlReply()

    response = answer("/reset_simulation", {"scope": scope}, reply)
    assert response.result.result == (sim.OK if reset else sim.FEATURE_UNSUPPORTED)
    assert asked == ([reset] if reset else [])


def test_a_service_has_one_node_and_one_name() -> None:
    names = [service.name for service in ROS_SERVICES]
    assert len({*names}) == len(names)
    assert {one.name for one in services_of("spawner")} > {"/spawn_entity", "/spawner/get_state"}


def within(bounds: Mapping[str, Any], *entities: doc.Entity) -> list[str]:
    """The names of entities whose box is of 0.2 x 0.4 x 0.6 m."""
    spawner = Spawner()
    spawner.entities = entities
    response = answer("/get_entities", {"filters": {"bounds": bounds}}, spawner)
    assert response.result.result == sim.OK, response.result.error_message
    return list(response.entities)


def points(*values: tuple[float, float, float]) -> list[dict[str, float]]:
    return [dict(zip("xyz", value, strict=True)) for value in values]


TURNED = BODY.model_copy(
    update={
        "name": "turned",
        "orientation_xyzw": (0.0, 0.0, math.sin(0.25 * math.pi / 2), math.cos(0.25 * math.pi / 2)),
    }
)
"""By 45 degrees: it reaches to 0.212 m from its middle along x, and has no corner at (0.1, 0.2)."""


@pytest.mark.parametrize(
    ("bounds", "found"),
    [
        ({}, ["crate_1", "turned"]),
        ({"type": 3, "points": points((1.0, 2.0, 0.1), (0.0, 0.0, 0.0))}, ["crate_1", "turned"]),
        ({"type": 3, "points": points((1.2, 2.0, 0.1), (0.11, 9.0, 9.0))}, ["crate_1", "turned"]),
        # The first's face is 0.1 m from the middle, the other's corner 0.212 m.
        ({"type": 3, "points": points((1.3, 2.0, 0.1), (0.15, 0.0, 0.0))}, ["turned"]),
        ({"type": 1, "points": points((2.0, 3.0, 1.0), (1.15, 1.0, 0.0))}, ["turned"]),
        ({"type": 1, "points": points((1.15, 1.0, 0.0), (2.0, 3.0, 1.0))}, ["turned"]),
        # Both boxes around them reach there, and but one of the two.
        ({"type": 1, "points": points((1.5, 2.5, 0.2), (1.09, 2.19, 0.0))}, ["crate_1"]),
        ({"type": 1, "points": points((1.5, 2.5, 2.2), (0.5, 1.5, 2.0))}, []),
        (
            {"type": 2, "points": points((-9, -9, 0), (9, -9, 0), (0, 9, 0), (0, 0, 9))},
            ["crate_1", "turned"],
        ),
        (
            {"type": 2, "points": points((1.09, 2.19, 0), (1.5, 2.19, 0.1), (1.09, 2.5, 0))},
            ["crate_1"],
        ),
        ({"type": 2, "points": points((3.0, 3.0, 0), (4.0, 3.0, 0), (3.0, 4.0, 0))}, []),
    ],
)  # fmt: skip
def test_entities_are_filtered_by_where_they_are(
    bounds: Mapping[str, Any], found: list[str]
) -> None:
    assert within(bounds, BODY, TURNED) == found


def test_an_entity_without_bounds_is_told_and_one_that_is_gone_is_not() -> None:
    spawner = Spawner("no mesh")
    values = {"filters": {"bounds": {"type": 3, "points": [{}, {"x": 9.0}]}}}
    response = answer("/get_entities", values, spawner)
    assert response.result.result == sim.OPERATION_FAILED
    assert response.result.error_message == "no mesh"

    def deleted(query: Query[Any, Any], document: Any) -> Any:
        reply = spawner(query, document)
        spawner.entities = ()
        return reply

    response = answer("/get_entities", values, deleted)
    assert (response.result.result, list(response.entities)) == (sim.OK, [])

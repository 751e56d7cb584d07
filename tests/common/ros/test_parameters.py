"""The parameters of a node, as `ros2 param` asks for them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from mazebot.cli.pages.parameters_page import CONFIGS, parameter_rows
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import PARAMETER_EVENTS, SERVICES, SET_PARAMETERS
from mazebot.common.messages.wire import decode, encode
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.common.ros import parameters as par
from mazebot.common.ros.interfaces import interfaces
from mazebot.common.ros.table import services_of
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.node import NavigationNode
from mazebot.physics.config import PhysicsConfig

VEL = "controller_server.max_linear_vel"
BUFFER = "controller_server.general_goal_checker.xy_goal_tolerance_buffer"
POINTS = "collision_monitor.polygons.FootprintApproach.points"


class Navigation(Node):
    name = "navigation"
    live_parameters = NavigationNode.live_parameters
    parameter_aliases = NavigationNode.parameter_aliases
    _config = NavigationConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        pass


class Physics(Node):
    name = "physics"
    _config = PhysicsConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        pass


def ask(node: Node, service: str, values: Mapping[str, Any], error: str = "") -> tuple[Any, Any]:
    """The response over its bytes, and the documents that the node was asked for."""
    types = interfaces()
    (found,) = (one for one in services_of(node.name) if one.name == f"/{node.name}/{service}")
    data = types.encode(f"{found.type}_Request", values)
    steps = found.handle(types.decode(f"{found.type}_Request", data), node)
    asked: list[Any] = []
    answered: Any = None
    while True:
        try:
            query, document = steps.send(answered)
        except StopIteration as end:
            made = types.encode(f"{found.type}_Response", end.value)
            return types.read(f"{found.type}_Response", made), asked
        assert query is SET_PARAMETERS
        asked.append(document.values)
        answered = doc.SetParametersReply(error=error)


def given(name: str, value: Any) -> dict[str, Any]:
    return {"name": name, "value": par.value_message(value)}


@pytest.mark.parametrize("service", SERVICES)
def test_every_parameter_of_the_page_can_be_read(service: str) -> None:
    node = type("Any", (Physics,), {"name": service, "_config": CONFIGS[service]()})()
    schema = CONFIGS[service].model_json_schema()
    rows = parameter_rows(schema, schema.get("$defs", {}))
    wanted = {row[0] for row in rows if ".NAME." not in row[0]}
    names = ask(node, "list_parameters", {})[0].result.names
    # A mapping has the names of what is in it.
    missing = {
        name for name in wanted - {*names} if not any(one.startswith(f"{name}.") for one in names)
    }
    assert not missing
    response, _ = ask(node, "get_parameters", {"names": names})
    assert len(response.values) == len(names)
    types, _ = ask(node, "get_parameter_types", {"names": names})
    assert [value.type for value in response.values] == types.types.tolist()


def test_names_are_listed_by_prefix_and_depth() -> None:
    node = Navigation()
    listed = ask(node, "list_parameters", {"prefixes": ["velocity_smoother"]})[0].result
    assert "velocity_smoother.feedback" in listed.names
    assert {name.partition(".")[0] for name in listed.names} == {"velocity_smoother"}
    assert listed.prefixes == ["velocity_smoother"]
    top = ask(node, "list_parameters", {"depth": 1})[0].result.names
    assert set(top) == {"seed", "use_sim_time"}


def test_a_value_has_the_type_that_ros_has() -> None:
    node = Navigation()
    names = [VEL, "max_linear_vel", "max_vel_x", "seed", "use_sim_time", "max_velocity", "nothing"]
    values = ask(node, "get_parameters", {"names": names})[0].values
    assert [value.type for value in values] == [3, 3, 3, 2, 1, 8, 0]
    assert {values[i].double_value for i in range(3)} == {0.46}
    assert values[5].double_array_value.tolist() == [0.46, 0.0, 1.9]


def test_a_description_says_the_range_and_whether_it_can_be_set() -> None:
    described = ask(Physics(), "describe_parameters", {"names": ["wheel_slip", "renderer"]})[0]
    slip, renderer = described.descriptors
    (range_,) = slip.floating_point_range
    assert (range_.from_value, range_.to_value, slip.read_only) == (0.0, 0.9, True)
    assert "cpu" in renderer.additional_constraints
    (vel,) = ask(Navigation(), "describe_parameters", {"names": [VEL]})[0].descriptors
    assert not vel.read_only
    assert vel.additional_constraints == "> 0"


@pytest.mark.parametrize("name", [VEL, "max_linear_vel", "max_vel_x"])
def test_what_can_change_is_set_by_a_query_of_the_node(name: str) -> None:
    response, asked = ask(Navigation(), "set_parameters", {"parameters": [given(name, 0.2)]})
    assert response.results[0].successful
    assert asked == [{VEL: 0.2}]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("seed", 3, "seed: read only: it is read at the start, from MAZEBOT_NAVIGATION_SEED"),
        (
            "max_linear_velo",
            1.0,
            f"no parameter of /navigation; did you mean {VEL}?",
        ),
        ("use_sim_time", False, "read only"),
    ],
)
def test_a_refusal_says_why(name: str, value: Any, reason: str) -> None:
    request = {"parameters": [given(name, value), given(VEL, 0.2)]}
    response, asked = ask(Navigation(), "set_parameters", request)
    assert [one.successful for one in response.results] == [False, True]
    assert reason in response.results[0].reason
    assert asked == [{VEL: 0.2}]
    whole, asked = ask(Navigation(), "set_parameters_atomically", request)
    assert not whole.result.successful
    assert not asked


def test_the_error_of_the_node_is_the_reason() -> None:
    request = {"parameters": [given(VEL, -1.0)]}
    response, _ = ask(Navigation(), "set_parameters", request, error="must be > 0")
    assert response.results[0].reason == "must be > 0"


def test_to_set_what_it_is_already_is_no_error() -> None:
    request = {"parameters": [given("use_sim_time", True)]}
    response, asked = ask(Physics(), "set_parameters", request)
    assert response.results[0].successful
    assert not asked


@pytest.mark.parametrize(
    ("name", "value", "types"),
    [
        (VEL, "0.3", "double (got string)"),
        (VEL, True, "double (got bool)"),
        ("max_velocity", "[0.4, 0.0, 1.9]", "double_array (got string)"),
        ("use_sim_time", 1, "bool (got integer)"),
        (VEL, ["3.0"], "double (got string_array)"),
    ],
)
def test_another_type_is_refused(name: str, value: Any, types: str) -> None:
    response, asked = ask(Navigation(), "set_parameters", {"parameters": [given(name, value)]})
    (result,) = response.results
    assert not result.successful
    assert result.reason.endswith(f": Wrong parameter type: must be {types}")
    assert not asked


def test_integers_are_taken_for_doubles_and_an_unset_parameter_takes_any_type() -> None:
    values = {VEL: 1, "velocity_smoother.max_velocity": [1, 0, 2], BUFFER: 0.1, POINTS: "[]"}
    request = {"parameters": [given(name, value) for name, value in values.items()]}
    response, (asked,) = ask(Navigation(), "set_parameters_atomically", request)
    assert response.result.successful
    assert asked == values
    assert type(asked[VEL]) is float


def test_a_type_that_no_parameter_has_is_refused() -> None:
    value = {"type": 5}
    request = {"parameters": [{"name": VEL, "value": value}]}
    response, asked = ask(Navigation(), "set_parameters", request)
    assert "byte_array" in response.results[0].reason
    assert not asked


def test_a_change_is_an_event() -> None:
    event = par.parameter_event(Navigation(), 1_500_000_000, {VEL: 0.2})
    got = decode(PARAMETER_EVENTS, encode(PARAMETER_EVENTS, event))
    assert isinstance(got, msg.ParameterEvent)
    assert (got.node, got.stamp.sec, got.stamp.nanosec) == ("/navigation", 1, 500_000_000)
    assert got.changed_parameters[0].value.double_value == 0.2

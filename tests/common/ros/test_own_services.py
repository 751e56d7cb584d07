"""Services of the package mazebot_msgs, by the queries of their nodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import wire
from mazebot.common.messages.topics import (
    EMERGENCY_STOP,
    INPUT_AT_WAYPOINT,
    QUERIES,
    SIMULATION_STATS,
    Query,
)
from mazebot.common.ros.own_services import OWN_QUERIES, OWN_SERVICES
from tests.common.ros.test_simulation import answer
from tests.common.samples import PLANAR, SAMPLES

POSE = {"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.0}


def reply_of(query: Query[Any, Any]) -> Any:
    """A reply with something in it."""
    if query.response is doc.SimulationControlReply:
        return query.response(error="no", stats=SAMPLES[SIMULATION_STATS])
    if query.response is act.SmoothPathReply:
        return query.response(path=(PLANAR,), error_code=501, error_msg="no")
    return query.response(error="no")


@pytest.mark.parametrize(
    ("name", "values", "wanted"),
    [
        ("/simulation/control", {"pause": [True]}, doc.SimulationControl(pause=True)),
        ("/simulation/control", {}, doc.SimulationControl()),
        (
            "/simulation/control",
            {"reset": ["all"], "seed": [3], "speed": [0.0], "robot_pose": [POSE]},
            doc.SimulationControl(reset="all", seed=3, speed=0.0, robot_pose=PLANAR),
        ),
        ("/navigation/pause", {"pause": True}, act.PauseGoal(pause=True)),
        ("/collision_monitor/toggle", {"enable": False}, act.Toggle(enable=False)),
        (
            "/clear_costmap",
            {"costmap": "global", "area": "around_pose", "reset_distance_m": 2.0, "pose": [POSE]},
            act.ClearCostmap(costmap="global", area="around_pose", reset_distance_m=2.0,
                             pose=PLANAR),
        ),
        ("/smooth_path", {"path": [POSE, POSE]}, act.SmoothPath(path=(PLANAR, PLANAR),
                                                                check_for_collisions=False)),
    ],
)  # fmt: skip
def test_a_service_asks_its_query_and_hands_the_reply_on(
    name: str, values: Mapping[str, Any], wanted: Any
) -> None:
    asked: list[Any] = []

    def reply(query: Query[Any, Any], document: Any) -> Any:
        assert query.name == name
        asked.append(document)
        return reply_of(query)

    response = answer(name, values, reply)
    assert asked == [wanted]
    (query,) = (one for one in OWN_QUERIES if one.name == name)
    assert wire.document_of(query.response, response) == reply_of(query)


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"seed": [-1]}, "seed"), ({"reset": ["half"]}, "reset"), ({"speed": [1e-9]}, "speed"),
        ({"step": [1, 2]}, "2 values: must be one at most"),
    ],
)  # fmt: skip
def test_a_request_that_is_none_is_refused_with_its_field(
    values: Mapping[str, Any], field: str
) -> None:
    with pytest.raises(wire.WireError, match=field):
        answer("/simulation/control", values, lambda *_: None)


@pytest.mark.parametrize("error", ["", "the robot waits for no input"])
def test_the_input_at_a_waypoint_is_a_trigger(error: str) -> None:
    response = answer(INPUT_AT_WAYPOINT.name, {}, lambda *_: act.Reply(error=error))
    assert (response.success, response.message) == (not error, error)


@pytest.mark.parametrize("data", [True, False])
def test_the_emergency_stop_is_set_and_cleared_by_a_bool(data: bool) -> None:
    asked: list[Any] = []

    def reply(_: Query[Any, Any], document: Any) -> Any:
        asked.append(document)
        return act.Reply()

    response = answer(EMERGENCY_STOP.name, {"data": data}, reply)
    assert asked == [doc.EmergencyStop(stop=data)]
    assert (response.success, response.message) == (True, "")


def test_each_service_is_of_the_node_that_answers_its_query() -> None:
    owners = {query.name: query.owner for query in QUERIES}
    assert {one.name: one.owner for one in OWN_SERVICES} == {
        one.name: owners[one.name] for one in OWN_SERVICES
    }

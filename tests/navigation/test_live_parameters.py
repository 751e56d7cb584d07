"""Parameters that are set while the robot drives."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from mazebot.common.config import value_of
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages.topics import (
    ACTION_RESULT,
    ODOM,
    PARAMETER_EVENTS,
    PARAMETERS,
    SEND_GOAL,
    SET_PARAMETERS,
)
from mazebot.embedded.session import Session

VEL = "controller_server.max_linear_vel"


@pytest.fixture(params=["mppi", pytest.param("regulated_pure_pursuit", marks=pytest.mark.slow)])
def session(request: pytest.FixtureRequest) -> Iterator[Session]:
    with Session("enhanced", camera=False, controller=request.param) as opened:
        opened.run_for(2.0)
        yield opened


def error_of(session: Session, values: dict[str, Any]) -> str:
    return session.ask(SET_PARAMETERS, doc.SetParameters(values=values), 30.0).error


def fastest_m_s(session: Session, seconds: float) -> float:
    with session.watching(ODOM) as odom:
        session.run_for(seconds)
    return max(one.twist.twist.linear.x for one in odom)


def test_the_highest_speed_changes_on_the_way_to_a_goal(session: Session) -> None:
    goal = act.NavigateToPose(pose=doc.Planar(x_m=0.5, y_m=-0.9, yaw_rad=0.0))
    with session.watching(PARAMETER_EVENTS) as events, session.watching(PARAMETERS) as told:
        reply = session.ask(SEND_GOAL, act.SendGoal(goal_id="a", goal=goal), 30.0)
        assert reply.accepted, reply
        session.run_for(0.5)
        assert error_of(session, {VEL: 0.1}) == ""
        session.run_for(1.0)
        assert 0.05 < fastest_m_s(session, 2.0) < 0.11
        assert error_of(session, {VEL: 0.3}) == ""
        assert 0.15 < fastest_m_s(session, 3.0) < 0.31
        with session.watching(ACTION_RESULT) as results:
            session.wait(60.0, lambda: bool(results))
    assert [result.status for result in results] == ["succeeded"]
    assert [event.changed_parameters[0].value.double_value for event in events] == [0.1, 0.3]
    values = [value_of(one.values, VEL) for one in told if one.service == "navigation"]
    assert values == [0.1, 0.3]


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ({VEL: -0.1}, f"{VEL}: must be greater than 0 (got -0.1)"),
        ({VEL: "fast"}, f"{VEL}: must be a valid number (got 'fast')"),
        ({VEL: 0.2, "controller_server.max_angular_vel": 0.0}, "max_angular_vel: must be greater"),
        ({"controller_server.max_linear_vele": 0.1}, "did you mean max_linear_vel?"),
        ({"seed": 1}, "seed: read only"),
        ({"global_costmap.resolution": 0.1}, "read only"),
    ],
)
def test_a_refusal_changes_nothing(values: dict[str, Any], error: str) -> None:
    with Session("enhanced", camera=False) as session:
        session.run_for(0.2)
        with session.watching(PARAMETERS) as told:
            assert error in error_of(session, values)
            session.run_for(0.2)
        assert not told

"""Keepout zones and speed limits of a world, driven by the real robot in a small room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import ClearCostmap
from mazebot.common.messages.documents import SetParameters
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    CLEAR_COSTMAP,
    GLOBAL_COSTMAP,
    GROUND_TRUTH_ODOM,
    KEEPOUT_FILTER_MASK,
    SET_PARAMETERS,
    SPEED_FILTER_MASK,
)
from mazebot.embedded.session import Session
from tests.worldgen import folder

CONTROLLERS = ["mppi", "regulated_pure_pursuit"]
KEEPOUT_X_M, KEEPOUT_Y_M = (-0.2, 0.4), (-0.3, 0.9)
SLOW_X_M = (-1.0, -0.4)
LIMIT_M_S = 0.15


def rectangle(x_m: tuple[float, float], y_m: tuple[float, float]) -> list[list[float]]:
    return [[x_m[0], y_m[0]], [x_m[1], y_m[0]], [x_m[1], y_m[1]], [x_m[0], y_m[1]]]


KEEPOUT = {"name": "carpet", "polygon_m": rectangle(KEEPOUT_X_M, KEEPOUT_Y_M)}
SLOW = {
    "name": "crossing", "polygon_m": rectangle(SLOW_X_M, (-1.0, 1.0)), "speed_limit_m_s": LIMIT_M_S,
}  # fmt: skip


def room(
    tmp_path: Path, controller: str = "mppi", settings: Path | None = None, **fields: object
) -> Session:
    recipe = folder.room()
    recipe |= {"map_resolution_m": 0.05, "start": {"x_m": -1.5, "y_m": 0.0}, "locations": {}}
    worlds_dir = folder.make(tmp_path / "worlds", recipe | fields)
    return Session(
        "room", worlds_dir=worlds_dir, camera=False, controller=controller, scan_noise_m=0.0,
        settings=settings,
    )  # fmt: skip


def drive(session: Session, x_m: float, y_m: float) -> tuple[int, Array, Array]:
    """The code, and of the drive the true (n, 2) places and (n,) speeds."""
    with session.watching(GROUND_TRUTH_ODOM) as seen:
        code = session.goal(x_m, y_m).error_code
    places = [msg.se2_from_pose(odom.pose.pose)[:2] for odom in seen]
    return code, np.array(places), np.array([odom.twist.twist.linear.x for odom in seen])


def within(
    places_m: Array, x_m: tuple[float, float], y_m: tuple[float, float]
) -> NDArray[np.bool_]:
    x, y = places_m.T
    return np.asarray((x > x_m[0]) & (x < x_m[1]) & (y > y_m[0]) & (y < y_m[1]))


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_the_robot_goes_round_a_keepout_zone_and_slowly_through_a_speed_limit(
    controller: str, tmp_path: Path
) -> None:
    with room(tmp_path, controller, keepout_zones=[KEEPOUT], speed_limits=[SLOW]) as session:
        code, places_m, speeds_m_s = drive(session, 1.4, 0.0)
        keepout, speed = session.latest(KEEPOUT_FILTER_MASK), session.latest(SPEED_FILTER_MASK)
    assert code == 0
    # The zone lies on the straight way.
    assert within(places_m, KEEPOUT_X_M, (-1.0, 1.0)).any()
    assert not within(places_m, KEEPOUT_X_M, KEEPOUT_Y_M).any()
    slow = within(places_m, SLOW_X_M, (-1.0, 1.0))
    assert slow.sum() > 50
    assert speeds_m_s[slow].max() < LIMIT_M_S + 0.02
    assert speeds_m_s[~slow].max() > 2.0 * LIMIT_M_S
    assert keepout is not None
    assert speed is not None
    # Cells that the zone covers or cuts.
    assert 12 * 24 <= int((msg.cells_from_grid(keepout) == 100).sum()) <= 13 * 25
    assert int(msg.cells_from_grid(speed).max()) == round(100.0 * (1.0 - LIMIT_M_S / 0.46))


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_very_slow_zone_is_driven_through_and_no_failure_of_the_controller(
    controller: str, tmp_path: Path
) -> None:
    slow = {"name": "ward", "polygon_m": rectangle((-1.3, -1.2), (-1.0, 1.0)), "percent": 5}
    with room(tmp_path, controller, speed_limits=[slow]) as session:
        result = session.goal(-0.5, 0.0)
    assert (result.error_code, result.number_of_recoveries) == (0, 0), result.error_msg


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_percents_are_of_the_speed_that_the_robot_may_drive_now(
    controller: str, tmp_path: Path
) -> None:
    slow = {"name": "ward", "polygon_m": rectangle((-1.2, 0.6), (-1.0, 1.0)), "percent": 50}
    # More than the robot can.
    settings = tmp_path / "fast.yaml"
    settings.write_text("navigation: {controller_server: {max_linear_vel: 1.0}}")
    with room(tmp_path, controller, settings=settings, speed_limits=[slow]) as session:
        code, places_m, speeds_m_s = drive(session, 1.4, 0.0)
        in_zone = within(places_m, (-1.1, 0.5), (-1.0, 1.0))
        assert (code, bool(in_zone.any())) == (0, True)
        assert 0.15 < speeds_m_s[in_zone].max() < 0.25
        values = {"controller_server.max_linear_vel": 0.2}
        assert session.ask(SET_PARAMETERS, SetParameters(values=values), 9.0).error == ""
        code, places_m, speeds_m_s = drive(session, -1.5, 0.0)
        in_zone = within(places_m, (-1.1, 0.5), (-1.0, 1.0))
        assert (code, bool(in_zone.any())) == (0, True)
        assert 0.06 < speeds_m_s[in_zone].max() < 0.12
        mask = session.latest(SPEED_FILTER_MASK)
    assert mask is not None
    assert mask.data.max() == 50


def test_a_goal_in_a_keepout_zone_is_refused_by_its_name_and_cleared_costmaps_keep_it(
    tmp_path: Path,
) -> None:
    with room(tmp_path, keepout_zones=[KEEPOUT]) as session:
        result = session.goal(0.1, 0.3)
        assert result.error_code == ErrorCode.GOAL_OCCUPIED
        assert "goal (0.10, 0.30) is in keepout zone carpet: must be outside" in result.error_msg
        assert "the nearest free pose is (" in result.error_msg
        reply = session.ask(CLEAR_COSTMAP, ClearCostmap(costmap="global"))
        assert reply.error == ""
        session.run_for(2.0)
        costmap = session.latest(GLOBAL_COSTMAP)
        assert costmap is not None
        assert session.goal(0.1, 0.3).error_code == ErrorCode.GOAL_OCCUPIED
    frame = SE2(0.1, 0.3, 0.0)
    origin = msg.se2_from_pose(costmap.info.origin)
    row, column = (int((frame[i] - origin[i]) / costmap.info.resolution) for i in (1, 0))
    assert msg.cells_from_grid(costmap)[row, column] == 100


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_robot_that_stands_in_a_keepout_zone_leaves_it(controller: str, tmp_path: Path) -> None:
    around = {"name": "garage", "polygon_m": rectangle((-1.9, -0.9), (-0.5, 0.5))}
    with room(tmp_path, controller, keepout_zones=[around]) as session:
        assert session.goal(-1.2, 0.2).error_code == ErrorCode.GOAL_OCCUPIED
        code, places_m, _ = drive(session, 1.0, 0.0)
    assert code == 0
    inside = within(places_m, (-1.9, -0.9), (-0.5, 0.5))
    # Once out, it stays out.
    assert inside[0]
    assert np.abs(np.diff(inside.astype(int))).sum() == 1

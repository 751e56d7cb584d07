"""What a behaviour tree hears while it runs: updates of its goal, and names of plugins."""

from __future__ import annotations

from pathlib import Path

import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import (
    CONTROLLER_SELECTOR,
    GOAL_UPDATE,
    PLANNER_SELECTOR,
    Topic,
)
from mazebot.navigation.behavior.bt_navigator import BtNavigatorParams
from mazebot.navigation.config import NavigationConfig
from tests.navigation.behavior.nav2_default_trees import FOLLOW_POINT
from tests.navigation.driving import LOCATIONS, NodeDriver

NEAR = LOCATIONS["location1"]
WAY = [SE2(-1.47 + 0.55 * share, -1.18 + 0.56 * share, 0.79) for share in (0.0, 0.5, 1.0)]
WAY += [SE2(-0.92, y_m, 1.57) for y_m in (-0.3, 0.0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8)]


def made(folder: Path) -> NodeDriver:
    """A robot whose goals are driven by the tree that follows a point at 1 m."""
    tree = folder / "follow_point.xml"
    tree.write_text(FOLLOW_POINT)
    trees = BtNavigatorParams(default_nav_to_pose_bt_xml=str(tree))
    return NodeDriver(NavigationConfig(bt_navigator=trees))


@pytest.fixture
def driver(tmp_path: Path) -> NodeDriver:
    driver = made(tmp_path)
    driver.learn()
    driver.run(0.5)
    return driver


def update(driver: NodeDriver, goal: SE2, frame_id: str = "map", stamp_ns: int = 0) -> None:
    message = msg.PoseStamped(msg.header(stamp_ns, frame_id), msg.pose_from_se2(goal))
    driver.deliver(GOAL_UPDATE, wire.encode(GOAL_UPDATE, message))


def select(driver: NodeDriver, topic: Topic[msg.String], name: str) -> None:
    driver.deliver(topic, wire.encode(topic, msg.String(data=name)))


def on_board(driver: NodeDriver, key: str) -> object:
    """What the running tree has on its blackboard."""
    assert driver.node._drive is not None
    tree = driver.node._drive.navigator.running_tree()
    assert tree is not None
    return tree.blackboard.get(key)


def test_nav2s_tree_follows_a_point_that_moves(driver: NodeDriver) -> None:
    driver.goal(NEAR)
    driver.run(6.0)
    for point in WAY:
        update(driver, point, stamp_ns=driver.now_ns)
        driver.run(2.0)
    place = driver.log.poses[-1]
    assert place.distance_m(WAY[-1]) == pytest.approx(1.05, abs=0.15)
    assert place.distance_m(NEAR) > 1.5
    # It waits for the next one.
    assert driver.results() == []


def test_an_update_counts_for_the_goal_of_its_time(driver: NodeDriver) -> None:
    """Those for a task before change nothing, and one that comes with its goal counts."""
    update(driver, WAY[-1])
    driver.run(0.1)
    driver.goal(NEAR)
    driver.run(1.0)
    assert on_board(driver, "updated_goal") == NEAR
    update(driver, WAY[-1], stamp_ns=driver.now_ns - 5_000_000_000)
    driver.run(1.1)
    assert on_board(driver, "updated_goal") == NEAR
    assert driver.rejected(GOAL_UPDATE) == {"older than the goal": 1}
    other = LOCATIONS["location2"]
    driver.goal(other)
    update(driver, WAY[-1], stamp_ns=driver.now_ns)
    driver.run(1.1)
    assert on_board(driver, "goal") == pytest.approx(other)
    assert on_board(driver, "updated_goal") == pytest.approx(WAY[-1])


def test_an_update_that_is_no_pose_in_the_map_is_counted(
    driver: NodeDriver, caplog: pytest.LogCaptureFixture
) -> None:
    driver.goal(NEAR)
    driver.run(0.5)
    update(driver, WAY[-1], "odom")
    header, pose = msg.header(0, "map"), msg.pose_from_se2(WAY[-1])
    pose.orientation.z = 5.0
    driver.deliver(GOAL_UPDATE, wire.encode(GOAL_UPDATE, msg.PoseStamped(header, pose)))
    driver.run(1.5)
    assert driver.rejected(GOAL_UPDATE) == {
        "frame_id is not map": 1, "quaternion not normalized": 1
    }  # fmt: skip
    assert on_board(driver, "updated_goal") == NEAR
    said = "/goal_update: frame_id 'odom': must be 'map' or empty"
    assert said in [record.message for record in caplog.records]


def test_selectors_take_the_name_last_heard_and_refuse_unknown_ones(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    driver = made(tmp_path)
    # Before there is a map.
    select(driver, CONTROLLER_SELECTOR, "regulated_pure_pursuit")
    driver.run(0.1)
    driver.learn()
    driver.run(0.5)
    driver.goal(NEAR)
    driver.run(0.5)
    assert driver.node.facts()["controller"] == "regulated_pure_pursuit"
    assert on_board(driver, "selected_planner") == "GridBased"
    select(driver, CONTROLLER_SELECTOR, "warp")
    select(driver, PLANNER_SELECTOR, "a_star")
    driver.run(0.1)
    select(driver, PLANNER_SELECTOR, "teleport")
    driver.run(0.5)
    assert driver.node.facts()["controller"] == "regulated_pure_pursuit"
    assert on_board(driver, "selected_planner") == "a_star"
    assert driver.rejected(CONTROLLER_SELECTOR) == {"unknown name": 1}
    assert [one.message for one in caplog.records if one.levelname == "ERROR"] == [
        "/controller_selector: controller 'warp': must be one of mppi, regulated_pure_pursuit",
        "/planner_selector: planner 'teleport': must be one of a_star, any_angle",
    ]
    assert driver.results() == []
    select(driver, CONTROLLER_SELECTOR, "")
    driver.run(0.2)
    assert driver.node.facts()["controller"] == "mppi"

"""Nodes in a namespace, whose topics below it are the robot's own, and nodes of other packages."""

from typing import Any

import pytest
import yaml

from mazebot.common.nav2_params.loader import load_nav2_params
from mazebot.common.nav2_params.report import Report, report
from tests.common.nav2_params.files import MODELS, row_of

COSTMAP = {
    "plugins": ["obstacle_layer"],
    "obstacle_layer": {
        "plugin": "nav2_costmap_2d::ObstacleLayer",
        "observation_sources": "laser",
        "laser": {"topic": "SCAN", "data_type": "LaserScan", "obstacle_max_range": 1.5},
    },
}
NODES: dict[str, dict[str, Any]] = {
    "amcl": {"scan_topic": "SCAN"},
    "controller_server": {"odom_topic": "ODOM"},
    "collision_monitor": {
        "cmd_vel_out_topic": "CMD",
        "observation_sources": ["scan"],
        "scan": {"type": "scan", "topic": "SCAN"},
    },
    "local_costmap": COSTMAP,
    "behavior_server": {"local_costmap_topic": "COSTMAP"},
}
NAMES = {"SCAN": "scan", "ODOM": "odom", "CMD": "cmd_vel", "COSTMAP": "local_costmap/costmap_raw"}


def told(namespace: str, prefix: str) -> Report:
    """What becomes of these nodes in a namespace, whose topics have a prefix."""
    nodes = {
        name: {name: {"ros__parameters": values}} if name == "local_costmap"
        else {"ros__parameters": values}
        for name, values in NODES.items()
    }  # fmt: skip
    text = yaml.safe_dump({namespace: nodes} if namespace else nodes)
    for word, topic in NAMES.items():
        text = text.replace(f": {word}\n", f": {prefix}{topic}\n")
    return report(load_nav2_params(text, "my.yaml"), MODELS)


@pytest.mark.parametrize(
    ("namespace", "prefix"),
    [
        ("robot1", "/robot1/"),
        ("/robot1", "/robot1/"),
        ("fleet/robot1", "/fleet/robot1/"),
        ("", "<robot_namespace>/"),
        ("", "/<robot_namespace>/"),
        ("robot1", "/"),
        ("", ""),
    ],
)
def test_topics_of_the_nodes_own_namespace_are_the_robots(namespace: str, prefix: str) -> None:
    found = told(namespace, prefix)
    assert [row for row in found.rows if row.differs] == []
    layer: Any = found.settings["navigation"]["local_costmap"]
    assert layer == {"obstacle_layer": {"scan": {"obstacle_max_range": 1.5}}}
    for parameter in ("scan_topic", "odom_topic", "cmd_vel_out_topic", "scan.topic",
                      "obstacle_layer.laser.topic", "local_costmap_topic"):  # fmt: skip
        assert row_of(found, parameter).status == "used"


def test_topics_of_another_namespace_are_those_of_another_robot() -> None:
    for namespace, prefix in (("robot1", "/robot2/"), ("", "/robot1/"), ("robot", "/robot1/")):
        found = told(namespace, prefix)
        assert "local_costmap" not in found.settings.get("navigation", {})
        assert row_of(found, "scan_topic").differs


def test_a_parameter_of_another_packages_node_is_not_said_to_be_one_of_nav2() -> None:
    text = "slam_toolbox: {ros__parameters: {resolution: 0.1}}\n"
    text += "ekf_filter_node: {ros__parameters: {frequency: 30.0}}\n"
    found = report(load_nav2_params(text, "my.yaml"), MODELS)
    package = "slam_toolbox, whose parameters `mazebot map build --params` takes"
    for name, of in (("resolution", package), ("frequency", "robot_localization")):
        row = row_of(found, name)
        assert (row.status, row.note) == ("unknown", f"not a node of Nav2 but of {of}")

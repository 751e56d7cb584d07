"""The configuration of RViz2 asks for topics that there are, as they are published."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from mazebot.common.files.root import ROOT
from mazebot.common.messages import wire
from mazebot.common.messages.topics import BY_NAME, EDGE, Delivery

CONFIG: dict[str, Any] = yaml.safe_load((ROOT / "examples" / "ros2" / "mazebot.rviz").read_text())
TYPES = {
    "Map": "nav_msgs/msg/OccupancyGrid", "RobotModel": "std_msgs/msg/String",
    "LaserScan": "sensor_msgs/msg/LaserScan", "PoseArray": "geometry_msgs/msg/PoseArray",
    "PoseWithCovariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "Path": "nav_msgs/msg/Path", "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "Polygon": "geometry_msgs/msg/PolygonStamped", "Image": "sensor_msgs/msg/Image",
    "SetInitialPose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "SetGoal": "geometry_msgs/msg/PoseStamped",
}  # fmt: skip
"""What each display and tool of rviz_default_plugins reads or publishes."""
UPDATES = "map_msgs/msg/OccupancyGridUpdate"


def topics_of(items: str) -> list[Any]:
    found = []
    for item in CONFIG["Visualization Manager"][items]:
        kind = item["Class"].removeprefix("rviz_default_plugins/")
        for key in ("Topic", "Description Topic", "Update Topic"):
            if key in item:
                wanted = UPDATES if key == "Update Topic" else TYPES[kind]
                found.append(pytest.param(item[key], wanted, id=item[key]["Value"]))
    return found


@pytest.mark.parametrize(("shown", "kind"), topics_of("Displays"))
def test_a_display_hears_its_topic(shown: dict[str, Any], kind: str) -> None:
    topic = BY_NAME[shown["Value"]]
    assert wire.type_name(topic) == kind
    latched = topic.delivery is Delivery.LATCHED
    assert shown["Durability Policy"] == ("Transient Local" if latched else "Volatile")
    best_effort = topic.delivery is Delivery.LATEST
    assert shown["Reliability Policy"] == ("Best Effort" if best_effort else "Reliable")


@pytest.mark.parametrize(("published", "kind"), topics_of("Tools"))
def test_a_tool_publishes_what_a_user_may(published: dict[str, Any], kind: str) -> None:
    topic = BY_NAME[published["Value"]]
    assert wire.type_name(topic) == kind
    assert EDGE in topic.owners

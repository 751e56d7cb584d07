"""The configuration of `ros2_bridge`."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import Literal

from pydantic import Field

from mazebot.common.config import Names, ServiceConfig
from mazebot.common.messages.topics import EDGE, TOPICS

NAME = "ros2_bridge"
"""Of the service, its section of settings and its node."""

OF_USERS = tuple(topic.name for topic in TOPICS if EDGE in topic.owners)
"""The topics that the user's own tools publish."""


class Ros2BridgeConfig(ServiceConfig):
    """What is carried between the bus and the nodes of ROS 2 that speak DDS."""

    domain_id: int | None = Field(
        None, ge=0, le=232, description="ROS domain on the side of DDS; None: as bus.domain_id"
    )
    discovery: Literal["localhost", "subnet"] = Field(
        "localhost",
        description="where nodes are found, as ROS_AUTOMATIC_DISCOVERY_RANGE: on this machine "
        "alone, or in its network",
    )
    to_ros: Names = Field(
        ("*",),
        description="topics that nodes of ROS 2 hear, of those in docs/topics.md: names with "
        "commas, `*` is any part of a name",
    )
    from_ros: Names = Field(
        OF_USERS,
        description="topics that nodes of ROS 2 publish for Mazebot, as in `to_ros`: by default "
        "those of the user's own tools; for Nav2 in place of its navigation also /tf",
    )
    services: Names = Field(
        ("*",),
        description="services and actions that nodes of ROS 2 may call, as in `to_ros`: the name "
        "of an action stands for all that it consists of",
    )


def is_allowed(name: str, patterns: tuple[str, ...]) -> bool:
    """Whether a topic or service, named without the stack's namespace, is one of `patterns`."""
    of_action = name.partition("/_action/")[0]
    return any(fnmatchcase(of_action, pattern) for pattern in patterns)

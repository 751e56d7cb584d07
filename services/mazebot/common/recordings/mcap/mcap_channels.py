"""What ROS 2 tools want to know about a topic in an MCAP file."""

from __future__ import annotations

import functools

from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import BY_NAME, Delivery

_QOS = """\
- history: keep_last
  depth: {depth}
  reliability: {reliability}
  durability: {durability}
  deadline: {{sec: 9223372036, nsec: 854775807}}
  lifespan: {{sec: 9223372036, nsec: 854775807}}
  liveliness: automatic
  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}
  avoid_ros_namespace_conventions: false
"""
"""As rosbag2 (version 9) writes it; the durations mean: none."""


@functools.cache
def definition_of(type_name: str) -> str:
    """The definition of a message type, followed by those of all types in it (`ros2msg`)."""
    return msg.TYPESTORE.generate_msgdef(type_name, ros_version=2)[0]


@functools.cache
def qos_profiles_of(topic_name: str) -> str:
    """The quality of service of a topic's publishers, as YAML: without `transient_local`,
    `ros2 bag play` would not send latched messages to late subscribers.
    """
    topic = BY_NAME.get(topic_name)
    latched = topic is not None and topic.delivery is Delivery.LATCHED
    return _QOS.format(
        depth=max(topic.depth, 1) if topic is not None else 10,
        reliability="reliable",
        durability="transient_local" if latched else "volatile",
    )

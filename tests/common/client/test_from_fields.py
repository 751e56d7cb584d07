"""Messages from what people and their tools write."""

from typing import Any

import pytest

from mazebot.common.client.from_fields import message_of
from mazebot.common.config import ConfigError

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
SCAN = "sensor_msgs/msg/LaserScan"


@pytest.mark.parametrize(
    ("kind", "content", "said"),
    [
        (POSE, {"pose": {"pose": {"position": {"x": None}}}}, "pose.position.x: None: must be a n"),
        (POSE, {"pose": {"pose": None}}, "pose.pose: None: must be the fields of"),
        (POSE, {"pose": {"covariance": None}}, "pose.covariance: None: must be a list"),
        (POSE, {"pose": {"covariance": [0.1, None, *[0.0] * 34]}}, "covariance[1]: None: must be"),
        (POSE, {"header": {"stamp": {"sec": None}}}, "stamp.sec: None: must be an integer"),
        (POSE, {"header": {"frame_id": None}}, "frame_id: None: must be a string"),
        (SCAN, {"ranges": None}, "ranges: None: must be a list"),
        (SCAN, {"ranges": [1.0, None]}, "ranges[1]: None: must be a number"),
        ("std_msgs/msg/Bool", {"data": None}, "data: None: must be true or false"),
    ],
)
def test_a_value_that_is_null_is_no_zero(kind: str, content: Any, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        message_of(kind, content, "/topic")
    assert said in str(caught.value)


def test_what_is_not_given_is_zero() -> None:
    message = message_of(POSE, {"pose": {"pose": {"position": {"x": 1}}}}, "/topic")
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    assert (position.x, position.y, orientation.w) == (1.0, 0.0, 1.0)
    assert (message.header.frame_id, message.header.stamp.sec) == ("", 0)
    assert message.pose.covariance.tolist() == [0.0] * 36
    assert len(message_of(SCAN, {}, "/topic").ranges) == 0

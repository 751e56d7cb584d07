"""Parts of ROS messages as plain values, and back."""

from __future__ import annotations

from typing import Any

from mazebot.common.maths.frames import MAP_FRAME
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Planar

_NS_PER_S = 1_000_000_000


def pose_stamped(pose: Planar) -> msg.PoseStamped:
    """A planar pose in the map, without a time."""
    return msg.PoseStamped(header=msg.header(0, MAP_FRAME), pose=msg.pose_from_se2(pose.se2()))


def check_in_map(header: msg.Header) -> None:
    """Raises ValueError where a header names another frame."""
    if header.frame_id not in ("", MAP_FRAME):
        raise ValueError(f"frame_id {header.frame_id!r:.40}: must be 'map' or empty")


def planar_of(pose: msg.PoseStamped) -> Planar:
    """A pose in the map. Raises ValueError where it is in another frame, or is no rotation."""
    check_in_map(pose.header)
    q = pose.pose.orientation
    if not msg.is_unit(q):
        raise ValueError(f"orientation ({q.x:g}, {q.y:g}, {q.z:g}, {q.w:g}): must have length 1")
    planar = msg.se2_from_pose(pose.pose)
    return Planar(x_m=planar.x_m, y_m=planar.y_m, yaw_rad=planar.yaw_rad)


def duration_values(seconds: float) -> dict[str, int]:
    """builtin_interfaces/Duration of seconds."""
    sec, nanosec = divmod(round(seconds * _NS_PER_S), _NS_PER_S)
    return {"sec": sec, "nanosec": nanosec}


def seconds_of(duration: Any) -> float:
    """Seconds of a builtin_interfaces/Duration."""
    seconds: float = duration.sec + duration.nanosec / _NS_PER_S
    return seconds

"""The particles as a message."""

from __future__ import annotations

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import MAP_FRAME, Array
from mazebot.common.messages import messages as msg

_MAX_PARTICLES_SHOWN = 500


def cloud_message(now_ns: int, particles: Array) -> msg.PoseArray:
    """At most 500 of the (n, 3) particles: x, y in metres and yaw in radians."""
    shown = particles[:: max(1, -(-len(particles) // _MAX_PARTICLES_SHOWN))]
    cos, sin = portable_kernels.cos_sin_each(shown[:, 2] / 2.0)
    zeros = [0.0] * len(shown)
    points = map(msg.Point, shown[:, 0].tolist(), shown[:, 1].tolist(), zeros)
    turns = map(msg.Quaternion, zeros, zeros, sin.tolist(), cos.tolist())
    return msg.PoseArray(
        header=msg.header(now_ns, MAP_FRAME), poses=list(map(msg.Pose, points, turns))
    )

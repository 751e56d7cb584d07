"""Ground truth of the robot, for evaluation; no estimate is made from it."""

from __future__ import annotations

import numpy as np

from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, MAP_FRAME
from mazebot.common.messages import messages as msg
from mazebot.physics.bodies.bodies import Bodies
from mazebot.physics.bodies.robot_body import WHEELS

_EXACT = np.zeros(36)
_EXACT.setflags(write=False)


def ground_truth(bodies: Bodies, stamp_ns: int) -> msg.Odometry:
    """True pose of base_footprint in the map, and its true velocity in its own axes."""
    map_from_footprint, velocity, spin = bodies.footprint_motion()
    return msg.Odometry(
        header=msg.header(stamp_ns, MAP_FRAME),
        child_frame_id=BASE_FOOTPRINT_FRAME,
        pose=msg.PoseWithCovariance(pose=msg.pose_from_se3(map_from_footprint), covariance=_EXACT),
        twist=msg.TwistWithCovariance(
            twist=msg.Twist(
                linear=msg.Vector3(*map_from_footprint.rotate_back(*velocity)),
                angular=msg.Vector3(*map_from_footprint.rotate_back(*spin)),
            ),
            covariance=_EXACT,
        ),
    )


def joint_states(
    angles_rad: tuple[float, float], speeds_rad_s: tuple[float, float], stamp_ns: int
) -> msg.JointState:
    """Angles and speeds of the wheels, left and right, as measured by their encoders."""
    return msg.JointState(
        header=msg.header(stamp_ns, ""),
        name=list(WHEELS),
        position=np.array(angles_rad),
        velocity=np.array(speeds_rad_s),
        effort=np.zeros(0),
    )


def mover_frames(bodies: Bodies, stamp_ns: int) -> list[msg.TransformStamped]:
    """True poses of the moving bodies in the map, as transforms to frames of their names."""
    names = bodies.mover_names
    if not names:
        return []
    return [
        msg.transform_stamped(stamp_ns, MAP_FRAME, name, pose)
        for name, pose in zip(names, bodies.map_from_movers(), strict=True)
    ]

"""The messages that the user's tools publish: a velocity, an initial pose."""

from __future__ import annotations

import numpy as np

from mazebot.common.client.robot import Robot
from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, MAP_FRAME, SE2
from mazebot.common.messages import messages as msg


def velocity(robot: Robot, linear_m_s: float, angular_rad_s: float) -> msg.TwistStamped:
    """A velocity of base_footprint, for CMD_VEL and CMD_VEL_TELEOP."""
    return msg.TwistStamped(
        header=msg.header(robot.now_ns(), BASE_FOOTPRINT_FRAME),
        twist=msg.Twist(
            linear=msg.Vector3(linear_m_s, 0.0, 0.0), angular=msg.Vector3(0.0, 0.0, angular_rad_s)
        ),
    )


def initial_pose(
    robot: Robot, map_from_base: SE2, std_m: float, std_rad: float
) -> msg.PoseWithCovarianceStamped:
    """A pose for INITIAL_POSE, with the standard deviations of x and y, and of the yaw."""
    covariance = np.diag([std_m * std_m, std_m * std_m, std_rad * std_rad])
    return msg.PoseWithCovarianceStamped(
        header=msg.header(robot.now_ns(), MAP_FRAME),
        pose=msg.PoseWithCovariance(
            pose=msg.pose_from_se2(map_from_base), covariance=msg.planar_covariance(covariance)
        ),
    )

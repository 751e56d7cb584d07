"""Navigation's results as messages."""

from __future__ import annotations

from services.common import portable_kernels
from services.common.frames import BASE_FOOTPRINT_FRAME, MAP_FRAME, SE2, Array
from services.common.node import messages as msg
from services.common.node.documents import NavigationResult, Planar
from services.navigation.collision import Velocity
from services.navigation.costmap import LayeredCostmap
from services.navigation.navigator import GoalResult
from services.navigation.path import PlannedPath

_MAX_PARTICLES_SHOWN = 500


def planar_document(pose: SE2) -> Planar:
    """A pose in the form of the documents."""
    return Planar(x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad)


def twist_message(now_ns: int, velocity: Velocity) -> msg.TwistStamped:
    """A velocity command."""
    return msg.TwistStamped(
        header=msg.header(now_ns, BASE_FOOTPRINT_FRAME),
        twist=msg.Twist(
            linear=msg.Vector3(velocity.linear_m_s, 0.0, 0.0),
            angular=msg.Vector3(0.0, 0.0, velocity.angular_rad_s),
        ),
    )


def path_message(now_ns: int, path: PlannedPath) -> msg.Path:
    """A path as poses in the map."""
    header = msg.header(now_ns, MAP_FRAME)
    poses = [
        msg.PoseStamped(header=header, pose=msg.pose_from_se2(SE2(float(x), float(y), float(yaw))))
        for (x, y), yaw in zip(path.points_m, path.yaws_rad, strict=True)
    ]
    return msg.Path(header=header, poses=poses)


def cloud_message(now_ns: int, particles: Array) -> msg.PoseArray:
    """At most 500 of the (n, 3) particles: x, y in metres and yaw in radians."""
    shown = particles[:: -(-len(particles) // _MAX_PARTICLES_SHOWN)]
    cos, sin = portable_kernels.cos_sin_each(shown[:, 2] / 2.0)
    zeros = [0.0] * len(shown)
    points = map(msg.Point, shown[:, 0].tolist(), shown[:, 1].tolist(), zeros)
    turns = map(msg.Quaternion, zeros, zeros, sin.tolist(), cos.tolist())
    return msg.PoseArray(
        header=msg.header(now_ns, MAP_FRAME), poses=list(map(msg.Pose, points, turns))
    )


def costmap_message(now_ns: int, costmap: LayeredCostmap) -> msg.OccupancyGrid:
    """The costmap with all its layers."""
    frame = costmap.frame
    return msg.occupancy_grid(
        now_ns,
        frame.resolution_m,
        SE2(frame.origin_x_m, frame.origin_y_m, 0.0),
        costmap.master.occupancy(),
    )


def result_message(result: GoalResult) -> NavigationResult:
    """How a goal ended."""
    return NavigationResult(
        goal=planar_document(result.goal.pose),
        goal_stamp_ns=result.goal.stamp_ns,
        error_code=int(result.error_code),
        error_msg=result.error_msg,
        start_time_s=result.start_ns * 1e-9,
        end_time_s=result.end_ns * 1e-9,
        number_of_recoveries=result.number_of_recoveries,
    )

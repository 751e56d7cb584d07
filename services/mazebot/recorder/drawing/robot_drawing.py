"""How the robot is drawn: its body, its frames, its sensors' measurements, its true pose."""

from __future__ import annotations

import functools
import math

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    MAP_FRAME,
    SE3,
)
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.recorder.drawing import palette
from mazebot.recorder.drawing.canvas import Canvas, draw_trail, entity_part
from mazebot.recorder.drawing.mesh import mesh_drawing

TRUTH_FRAME = "ground_truth"
"""Frame of the true robot; `base_footprint` is the estimated one."""

_PLOT_NS = 95_000_000
_SCAN_NS = 195_000_000
_OUTLINE_POINTS = 0.75
"""In screen units, at any distance: thin, not to hide the true robot inside."""
_ORIGIN = 0.0, 0.0, 0.0


def draw_robot(canvas: Canvas) -> None:
    """Draw the robot's body at its true pose, and its outline at its estimated pose."""
    log = canvas.recording.log
    robot, name = canvas.robot, "ground_truth/robot"
    log(name, rr.CoordinateFrame(TRUTH_FRAME), mesh_drawing(robot.body), static=True)
    for wheel in robot.wheels:
        frame = rr.CoordinateFrame(f"{TRUTH_FRAME}/{wheel.joint}")
        log(f"{name}/{wheel.joint}", frame, mesh_drawing(wheel.mesh), static=True)
    log(
        "amcl_pose/robot",
        rr.CoordinateFrame(BASE_FOOTPRINT_FRAME),
        rr.LineStrips3D(
            robot.outline(), colors=palette.ESTIMATE, radii=rr.Radius.ui_points(_OUTLINE_POINTS)
        ),
        static=True,
    )
    canvas.recording.at(canvas.now_ns)
    _turn_wheels(canvas, {wheel.joint: 0.0 for wheel in robot.wheels})


def draw_tf(canvas: Canvas, transforms: msg.TFMessage) -> None:
    """Named frames, as in RViz: entities in a frame are drawn at its pose at that time."""
    for entry in transforms.transforms:
        canvas.at(entry.header.stamp)
        t, q = entry.transform.translation, entry.transform.rotation
        canvas.recording.transform(
            f"tf/{entity_part(entry.child_frame_id)}",
            (t.x, t.y, t.z),
            (q.x, q.y, q.z, q.w),
            entry.header.frame_id,
            entry.child_frame_id,
        )


def draw_tf_static(canvas: Canvas, transforms: msg.TFMessage) -> None:
    """The robot's fixed frames."""
    canvas.comparison.add_static_transforms(transforms)
    for entry in transforms.transforms:
        path = f"tf_static/{entity_part(entry.child_frame_id)}"
        canvas.recording.log(path, _transform(entry), static=True)


def draw_odom(canvas: Canvas, odometry: msg.Odometry) -> None:
    """Measured velocities, and the drift of wheel odometry alone."""
    stamp_ns = canvas.at(odometry.header.stamp)
    if canvas.due("odom", stamp_ns, _PLOT_NS):
        _draw_twist(canvas, "odom", odometry.twist.twist)
        error = canvas.comparison.odometry(odometry)
        if error is not None:
            canvas.recording.scalar("error/odometry_m", error.distance_m)


def draw_joint_states(canvas: Canvas, joints: msg.JointState) -> None:
    """Rotation of the wheels."""
    stamp_ns = canvas.at(joints.header.stamp)
    if not canvas.due("joint_states", stamp_ns, _PLOT_NS):
        return
    angles = dict(zip(joints.name, joints.position.tolist(), strict=False))
    _turn_wheels(canvas, angles)
    for name, speed_rad_s in zip(joints.name, joints.velocity.tolist(), strict=False):
        for side in ("left", "right"):
            if side in name:
                canvas.recording.scalar(f"joint_states/{side}_rad_s", speed_rad_s)


def draw_battery(canvas: Canvas, battery: msg.BatteryState) -> None:
    """What is left in the battery."""
    canvas.at(battery.header.stamp)
    if math.isfinite(battery.percentage):
        canvas.recording.scalar("battery/percentage", battery.percentage)


def draw_imu(canvas: Canvas, imu: msg.Imu) -> None:
    """Yaw rate and level accelerations."""
    stamp_ns = canvas.at(imu.header.stamp)
    if canvas.due("imu", stamp_ns, _PLOT_NS):
        canvas.recording.scalar("imu/angular_velocity_z_rad_s", imu.angular_velocity.z)
        canvas.recording.scalar("imu/linear_acceleration_x_m_s2", imu.linear_acceleration.x)
        canvas.recording.scalar("imu/linear_acceleration_y_m_s2", imu.linear_acceleration.y)


def draw_scan(canvas: Canvas, scan: msg.LaserScan) -> None:
    """The scan's hits five times a second, in the lidar's frame: relative to the estimated pose."""
    _draw_hits(canvas, "scan", scan, palette.SCAN)


def draw_depth_scan(canvas: Canvas, scan: msg.LaserScan) -> None:
    """What the depth image shows above the floor, likewise in the camera's frame."""
    _draw_hits(canvas, "camera/depth/scan", scan, palette.DEPTH_SCAN)


def _draw_hits(canvas: Canvas, path: str, scan: msg.LaserScan, color: tuple[int, int, int]) -> None:
    if not canvas.due(path, canvas.at(scan.header.stamp), _SCAN_NS):
        return
    ranges_m = scan.ranges
    echo = (ranges_m >= scan.range_min) & (ranges_m <= scan.range_max)
    directions = _directions(len(ranges_m), scan.angle_min, scan.angle_increment)
    points = ranges_m.compress(echo)[:, np.newaxis] * directions.compress(echo, axis=0)
    canvas.frame(
        path, scan.header.frame_id, lambda: rr.Points3D.from_fields(colors=color, radii=0.02)
    )
    canvas.recording.log(path, rr.Points3D(points))


def draw_ground_truth_odom(canvas: Canvas, odometry: msg.Odometry) -> None:
    """The true robot, its path so far, and its velocities."""
    canvas.comparison.add_truth(odometry)
    stamp_ns = canvas.at(odometry.header.stamp)
    pose = odometry.pose.pose
    p, q = pose.position, pose.orientation
    canvas.recording.transform(
        "ground_truth/odom", (p.x, p.y, p.z), (q.x, q.y, q.z, q.w), MAP_FRAME, TRUTH_FRAME
    )
    draw_trail(canvas, "ground_truth/odom/path", pose, 0.03, palette.TRUTH, 0.03)
    if canvas.due("ground_truth/odom/twist", stamp_ns, _PLOT_NS):
        _draw_twist(canvas, "ground_truth/odom", odometry.twist.twist)


def draw_contact(canvas: Canvas, contact: doc.Contact) -> None:
    """The position of a contact of the robot."""
    canvas.recording.at(round(contact.time_s * 1e9))
    canvas.contacts_m.append(contact.position_m)
    text = f"contact: {contact.robot_link} with {contact.body}, {contact.impulse_n_s:.3g} N s"
    canvas.event("contact", text, "WARN")
    canvas.recording.log(
        "contacts",
        rr.CoordinateFrame(MAP_FRAME),
        rr.Points3D(list(canvas.contacts_m), colors=palette.BAD, radii=0.04),
        rr.AnyValues(
            robot_link=contact.robot_link, body=contact.body, impulse_n_s=contact.impulse_n_s
        ),
    )


def draw_cmd_vel_teleop(canvas: Canvas, command: msg.TwistStamped) -> None:
    """The velocity commanded by teleoperation."""
    stamp_ns = canvas.at(command.header.stamp)
    if canvas.due("cmd_vel_teleop", stamp_ns, _PLOT_NS):
        _draw_twist(canvas, "cmd_vel_teleop", command.twist)


def draw_cmd_vel(canvas: Canvas, command: msg.TwistStamped) -> None:
    """The commanded velocity."""
    stamp_ns = canvas.at(command.header.stamp)
    if canvas.due("cmd_vel", stamp_ns, _PLOT_NS):
        _draw_twist(canvas, "cmd_vel", command.twist)


@functools.lru_cache(maxsize=8)
def _directions(count: int, first_rad: float, step_rad: float) -> NDArray[np.float32]:
    """(count, 3) unit vectors of a lidar's rays."""
    angle_rad = first_rad + step_rad * np.arange(count)
    beams = [np.cos(angle_rad), np.sin(angle_rad), np.zeros(count)]
    return np.column_stack(beams).astype(np.float32)


def _draw_twist(canvas: Canvas, path: str, twist: msg.Twist) -> None:
    canvas.recording.scalar(f"{path}/linear_m_s", twist.linear.x)
    canvas.recording.scalar(f"{path}/angular_rad_s", twist.angular.z)


def _transform(entry: msg.TransformStamped) -> rr.Transform3D:
    t, q = entry.transform.translation, entry.transform.rotation
    return rr.Transform3D(
        translation=(t.x, t.y, t.z),
        quaternion=rr.Quaternion(xyzw=(q.x, q.y, q.z, q.w)),
        parent_frame=entry.header.frame_id,
        child_frame=entry.child_frame_id,
    )


def _turn_wheels(canvas: Canvas, angles: dict[str, float]) -> None:
    """Set the wheel angles of the true robot. The time must be set."""
    for wheel in canvas.robot.wheels:
        if wheel.joint not in angles:
            continue
        half_rad = angles[wheel.joint] / 2.0
        half_sine = math.sin(half_rad)
        x, y, z = wheel.axis.tolist()
        turn = SE3(_ORIGIN, (x * half_sine, y * half_sine, z * half_sine, math.cos(half_rad)))
        position_m, (x, y, z, w) = wheel.pose @ turn
        xyzw = (x, y, z, w) if w >= 0.0 else (-x, -y, -z, -w)
        child = f"{TRUTH_FRAME}/{wheel.joint}"
        canvas.recording.transform(f"joint_states/{child}", position_m, xyzw, TRUTH_FRAME, child)

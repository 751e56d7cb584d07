"""How each topic's messages are drawn: a function a topic, on entities named like the topics."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from services.common import documents as doc
from services.common import messages as msg
from services.common.diagnostics import (
    RATE_KEY,
    REAL_TIME_FACTOR_KEY,
    REJECTED_KEY,
    WAITING_KEY,
)
from services.common.frames import (
    BASE_FOOTPRINT_FRAME,
    CAMERA_OPTICAL_FRAME,
    MAP_FRAME,
    Array,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from services.common.topics import (
    AMCL_POSE,
    ASSETS,
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CAMERA_INFO,
    CLOCK,
    CMD_VEL,
    CONTACTS,
    DEPTH_IMAGE,
    DEPTH_INFO,
    DESIRED_ENTITIES,
    DETECTIONS,
    DIAGNOSTICS,
    ENTITIES,
    GLOBAL_COSTMAP,
    GOAL_POSE,
    GROUND_TRUTH_ODOM,
    IMU,
    INITIAL_POSE,
    JOINT_STATES,
    MAP,
    MAP_DETECTIONS,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    ODOM,
    PARAMETERS,
    PARTICLE_CLOUD,
    PLAN,
    ROSOUT,
    SCAN,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
    WORLD_REQUEST,
    WORLD_STATUS,
    Topic,
)
from services.recorder import palette
from services.recorder.canvas import Canvas, Trail, entity_part
from services.recorder.mesh import mesh_drawing
from services.recorder.picture_drawing import (
    IMAGE_FRAME,
    draw_camera_compressed,
    draw_camera_image,
    draw_camera_info,
    draw_depth_image,
    draw_depth_info,
)
from services.recorder.world_drawing import (
    draw_asset,
    draw_desired_entities,
    draw_entities,
    draw_world,
    place_what_stands,
)

TRUTH_FRAME = "ground_truth"
"""Frame of the true robot; `base_footprint` is where it believes itself to be."""

_PLOT_NS = 95_000_000
_PATH_NS = 500_000_000
_TRAIL_POINTS = 400
"""Of a way, each of which makes the time until it is drawn again longer."""
_SECOND_NS = 1_000_000_000
_LATCH_NS = 10_000_000_000
"""What has not changed is drawn again this often, for viewers that have only the newest data."""
_MAX_PARTICLES = 500

_SQUARE: Array = np.array(
    [[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0], [-0.5, -0.5, 0.0]]
)

SERIES: dict[str, tuple[str, tuple[int, int, int]]] = {
    "error/localisation_m": ("localisation", palette.ESTIMATE),
    "error/odometry_m": ("odometry drift", palette.SECOND),
    "error/marker_m": ("marker", palette.MARKER),
    "error/localisation_deg": ("heading", palette.ESTIMATE),
    "cmd_vel/linear_m_s": ("commanded", palette.PLAN),
    "odom/linear_m_s": ("odometry", palette.SECOND),
    "ground_truth/odom/linear_m_s": ("true", palette.TRUTH),
    "cmd_vel/angular_rad_s": ("commanded", palette.PLAN),
    "odom/angular_rad_s": ("odometry", palette.SECOND),
    "ground_truth/odom/angular_rad_s": ("true", palette.TRUTH),
    "imu/angular_velocity_z_rad_s": ("yaw rate", palette.PLAN),
    "imu/linear_acceleration_x_m_s2": ("forward", palette.ESTIMATE),
    "imu/linear_acceleration_y_m_s2": ("left", palette.TRUTH),
    "joint_states/left_rad_s": ("left wheel", palette.ESTIMATE),
    "joint_states/right_rad_s": ("right wheel", palette.TRUTH),
    "clock/real_time_factor": ("real time factor", palette.TRUTH),
    "simulation/stats/watchdog_stops": ("watchdog stops", palette.BAD),
    "navigation/status/distance_remaining_m": ("distance remaining", palette.PLAN),
    "navigation/status/number_of_recoveries": ("recoveries", palette.BAD),
    "aruco/detections/count": ("markers in view", palette.MARKER),
}
"""Entities that are numbers over time, with their name and colour in the plots."""

_STATES: dict[str, tuple[int, int, int]] = {
    "active": palette.GOOD,
    "controlling": palette.GOOD,
    "planning": palette.PLAN,
    "recovering": palette.ESTIMATE,
    "idle": (120, 120, 120),
    "waiting": (120, 120, 120),
    "rejecting": palette.BAD,
}


def draw_start(canvas: Canvas) -> None:
    """Draw what no message brings: the robot, twice, and the looks of the plots."""
    log = canvas.recording.log
    robot = canvas.robot
    ghost = (*palette.ESTIMATE, 90)
    for name, frame, tint in (
        ("ground_truth/robot", TRUTH_FRAME, None),
        ("amcl_pose/robot", BASE_FOOTPRINT_FRAME, ghost),
    ):
        log(name, rr.CoordinateFrame(frame), mesh_drawing(robot.body, tint=tint), static=True)
        for wheel in robot.wheels:
            wheel_frame = f"{frame}/{wheel.joint}"
            mesh = mesh_drawing(wheel.mesh, tint=tint)
            log(f"{name}/{wheel.joint}", rr.CoordinateFrame(wheel_frame), mesh, static=True)
            if frame == BASE_FOOTPRINT_FRAME:
                mount = rr.Transform3D(
                    translation=wheel.base_from_joint[:3, 3],
                    mat3x3=wheel.base_from_joint[:3, :3],
                    parent_frame=frame,
                    child_frame=wheel_frame,
                )
                log(f"joint_states/{wheel_frame}", mount, static=True)
    canvas.recording.at(canvas.now_ns)
    _turn_wheels(canvas, {wheel.joint: 0.0 for wheel in robot.wheels})
    for path, (name, color) in SERIES.items():
        log(path, rr.SeriesLines(colors=[color], names=[name], widths=[1.5]), static=True)
    states = rr.StateConfiguration(values=list(_STATES), colors=list(_STATES.values()))
    for path in ("navigation/status/state", "navigation/status/localization"):
        log(path, states, static=True)


def draw_clock(canvas: Canvas, _: msg.Clock) -> None:
    """Simulated seconds a second of wall time, once a second of wall time."""
    now_s = canvas.wall_clock_s()
    if canvas.entities is not None and canvas.due("entities", canvas.now_ns, _LATCH_NS):
        place_what_stands(canvas)
    if canvas.real_time is None:
        canvas.real_time = now_s, canvas.now_ns
        return
    wall_s, sim_ns = canvas.real_time
    if now_s - wall_s >= 1.0:
        factor = (canvas.now_ns - sim_ns) * 1e-9 / (now_s - wall_s)
        canvas.real_time = now_s, canvas.now_ns
        canvas.recording.scalar("clock/real_time_factor", factor)


def draw_world_request(canvas: Canvas, request: doc.WorldRequest) -> None:
    """The request, in words."""
    markers = "with" if request.use_aruco else "without"
    canvas.say("world/request", f"asked for {request.world_name}, {markers} markers")


def draw_world_status(canvas: Canvas, status: doc.WorldStatus) -> None:
    """What became of a request, in words."""
    name = status.request.world_name
    if status.error:
        canvas.say("world/status", f"{name} refused: {status.error}", "ERROR")
    else:
        canvas.say("world/status", f"{name} runs as {status.world_hash}")


def draw_parameters(canvas: Canvas, parameters: doc.Parameters) -> None:
    """How a service is configured, as a document."""
    lines = [f"- {name}: {value}" for name, value in parameters.values.items()]
    text = "\n".join([f"# {parameters.service}", *lines])
    path = f"parameters/{parameters.service}"
    if canvas.changed(path, text):
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        canvas.recording.log(path, document, static=True)


def draw_map(canvas: Canvas, grid: msg.OccupancyGrid) -> None:
    """The occupancy map, just above the floor."""
    drawn = _grid(grid, 0.002, 1.0, rr.components.Colormap.RvizMap)
    canvas.recording.log("map", rr.CoordinateFrame(MAP_FRAME), drawn, static=True)


def draw_tf(canvas: Canvas, transforms: msg.TFMessage) -> None:
    """Frames by name, as RViz has them: what hangs on one is drawn where it was then."""
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
        path = f"tf_static/{entry.child_frame_id}"
        canvas.recording.log(path, _transform(entry), static=True)


def draw_odom(canvas: Canvas, odometry: msg.Odometry) -> None:
    """Measured velocities, and how far wheel odometry alone has drifted."""
    stamp_ns = canvas.at(odometry.header.stamp)
    if canvas.due("odom", stamp_ns, _PLOT_NS):
        _draw_twist(canvas, "odom", odometry.twist.twist)
        error = canvas.comparison.odometry(odometry)
        if error is not None:
            canvas.recording.scalar("error/odometry_m", error.distance_m)


def draw_joint_states(canvas: Canvas, joints: msg.JointState) -> None:
    """The wheels' turning."""
    stamp_ns = canvas.at(joints.header.stamp)
    if not canvas.due("joint_states", stamp_ns, _PLOT_NS):
        return
    angles = dict(zip(joints.name, joints.position.tolist(), strict=False))
    _turn_wheels(canvas, angles)
    for name, speed_rad_s in zip(joints.name, joints.velocity.tolist(), strict=False):
        for side in ("left", "right"):
            if side in name:
                canvas.recording.scalar(f"joint_states/{side}_rad_s", speed_rad_s)


def draw_imu(canvas: Canvas, imu: msg.Imu) -> None:
    """Yaw rate and level accelerations."""
    stamp_ns = canvas.at(imu.header.stamp)
    if canvas.due("imu", stamp_ns, _PLOT_NS):
        canvas.recording.scalar("imu/angular_velocity_z_rad_s", imu.angular_velocity.z)
        canvas.recording.scalar("imu/linear_acceleration_x_m_s2", imu.linear_acceleration.x)
        canvas.recording.scalar("imu/linear_acceleration_y_m_s2", imu.linear_acceleration.y)


def draw_scan(canvas: Canvas, scan: msg.LaserScan) -> None:
    """The echoes, in the lidar's frame: where the robot believes them to be."""
    canvas.at(scan.header.stamp)
    ranges_m = scan.ranges
    echo = (ranges_m >= scan.range_min) & (ranges_m <= scan.range_max)
    directions = _directions(len(ranges_m), scan.angle_min, scan.angle_increment)
    points = ranges_m[echo, np.newaxis] * directions[echo]
    looks = rr.Points3D.from_fields(colors=palette.SCAN, radii=0.02)
    canvas.frame("scan", scan.header.frame_id, looks)
    canvas.recording.log("scan", rr.Points3D(points))


def draw_ground_truth_odom(canvas: Canvas, odometry: msg.Odometry) -> None:
    """The true robot, its way so far, and its velocities."""
    canvas.comparison.add_truth(odometry)
    stamp_ns = canvas.at(odometry.header.stamp)
    pose = odometry.pose.pose
    p, q = pose.position, pose.orientation
    canvas.recording.transform(
        "ground_truth/odom", (p.x, p.y, p.z), (q.x, q.y, q.z, q.w), MAP_FRAME, TRUTH_FRAME
    )
    _draw_trail(canvas, "ground_truth/odom/path", pose, 0.03, palette.TRUTH, 0.03)
    if canvas.due("ground_truth/odom/twist", stamp_ns, _PLOT_NS):
        _draw_twist(canvas, "ground_truth/odom", odometry.twist.twist)


def draw_contact(canvas: Canvas, contact: doc.Contact) -> None:
    """Where the robot touched something."""
    canvas.recording.at(round(contact.time_s * 1e9))
    canvas.contacts_m.append(contact.position_m)
    canvas.recording.log(
        "contacts",
        rr.CoordinateFrame(MAP_FRAME),
        rr.Points3D(list(canvas.contacts_m), colors=palette.BAD, radii=0.04),
        rr.TextLog(
            f"{contact.robot_link} touched {contact.body} with {contact.impulse_n_s:.3f} N s",
            level="WARN",
        ),
    )


def draw_simulation_stats(canvas: Canvas, stats: doc.SimulationStats) -> None:
    """The state's hash, and the watchdog's stops."""
    stamp_ns = round(stats.sim_time_s * 1e9)
    canvas.recording.at(stamp_ns)
    if canvas.due("simulation/stats", stamp_ns, _SECOND_NS):
        canvas.recording.log(
            "simulation/stats",
            rr.AnyValues(
                state_hash=stats.state_hash, iterations=stats.iterations, paused=stats.paused
            ),
        )
        canvas.recording.scalar("simulation/stats/watchdog_stops", stats.watchdog_stops)
    if stats.paused:
        # A pause says nothing of how fast the simulation is.
        canvas.real_time = None
    if canvas.changed("simulation/stats/renderer", stats.renderer):
        canvas.say("simulation/stats", f"renderer: {stats.renderer}")


def draw_detections(canvas: Canvas, detections: msg.Detection3DArray) -> None:
    """The markers' outlines, in the picture and in the camera's frame, and how far off they are.

    The second solution of each pose is grey.
    """
    canvas.at(detections.header.stamp)
    canvas.recording.scalar("aruco/detections/count", len(detections.detections))
    poses: list[tuple[str, Array, Array]] = []
    others: list[Array] = []
    for detection in detections.detections:
        size_m = np.array([detection.bbox.size.x, detection.bbox.size.y, 0.0])
        for number, result in enumerate(detection.results):
            corners = _corners(result.pose.pose, size_m)
            if number == 0:
                poses.append((detection.id, corners, size_m))
            else:
                others.append(corners)
    names = [f"id {name.rpartition(':')[2]}" for name, _, _ in poses]
    frame = detections.header.frame_id or CAMERA_OPTICAL_FRAME
    if canvas.camera is not None:
        k = canvas.camera.k.reshape(3, 3)
        outlines = [_project(k, corners) for _, corners, _ in poses]
        _draw_outlines(canvas, IMAGE_FRAME, outlines, names)
    if canvas.changed("aruco/detections", bool(poses)) or poses:
        canvas.frame("aruco/detections", frame)
        canvas.recording.log(
            "aruco/detections",
            rr.LineStrips3D(
                [corners for _, corners, _ in poses] + others,
                colors=[palette.MARKER] * len(poses) + [palette.SECOND] * len(others),
                radii=[0.006] * len(poses) + [0.002] * len(others),
            ),
        )
    entities = canvas.entities.markers if canvas.entities else ()
    errors_m = [error_m for _, error_m in canvas.comparison.markers(detections, entities)]
    if errors_m:
        canvas.recording.scalar("error/marker_m", max(errors_m))


def draw_map_detections(canvas: Canvas, detections: msg.Detection3DArray) -> None:
    """The markers where the robot believes them to be."""
    canvas.at(detections.header.stamp)
    seen = [detection for detection in detections.detections if detection.results]
    if canvas.changed("aruco/detections_map", bool(seen)) or seen:
        places = [detection.results[0].pose.pose.position for detection in seen]
        canvas.frame("aruco/detections_map", detections.header.frame_id or MAP_FRAME)
        canvas.recording.log(
            "aruco/detections_map",
            rr.Points3D(
                [(p.x, p.y, p.z) for p in places],
                labels=[f"id {detection.id.rpartition(':')[2]}" for detection in seen],
                colors=palette.NAME,
                radii=0.05,
            ),
        )


def draw_initial_pose(canvas: Canvas, estimate: msg.PoseWithCovarianceStamped) -> None:
    """Where a person says the robot is."""
    canvas.at(estimate.header.stamp)
    _draw_arrow(canvas, "initialpose", estimate.pose.pose, palette.ESTIMATE)
    pose = msg.se2_from_pose(estimate.pose.pose)
    text = f"the robot is at ({pose.x_m:.2f}, {pose.y_m:.2f}, {pose.yaw_rad:.2f}), a person says"
    canvas.say("initialpose", text, stamp=estimate.header.stamp)


def draw_goal_pose(canvas: Canvas, goal: msg.PoseStamped) -> None:
    """Where to drive."""
    canvas.at(goal.header.stamp)
    _draw_arrow(canvas, "goal_pose", goal.pose, palette.PLAN)
    pose = msg.se2_from_pose(goal.pose)
    text = f"goal ({pose.x_m:.2f}, {pose.y_m:.2f}, {pose.yaw_rad:.2f})"
    canvas.say("goal_pose", text, stamp=goal.header.stamp)


def draw_amcl_pose(canvas: Canvas, estimate: msg.PoseWithCovarianceStamped) -> None:
    """The estimated pose's uncertainty (2 sigma), the way by it, and its error."""
    stamp_ns = canvas.at(estimate.header.stamp)
    pose = estimate.pose.pose
    _draw_trail(canvas, "amcl_pose/path", pose, 0.06, palette.ESTIMATE, 0.012)
    if canvas.due("amcl_pose", stamp_ns, _PATH_NS):
        covariance = np.asarray(estimate.pose.covariance).reshape(6, 6)[:2, :2]
        variances, axes = np.linalg.eigh((covariance + covariance.T) / 2.0)
        turn = math.atan2(float(axes[1, 1]), float(axes[0, 1]))
        long_m, short_m = 2.0 * np.sqrt(np.maximum(variances[::-1], 1e-8))
        looks = rr.Ellipsoids3D.from_fields(
            colors=palette.ESTIMATE, fill_mode=rr.components.FillMode.Solid
        )
        canvas.frame("amcl_pose", estimate.header.frame_id or MAP_FRAME, looks)
        canvas.recording.log(
            "amcl_pose",
            rr.Ellipsoids3D(
                centers=[(pose.position.x, pose.position.y, 0.02)],
                half_sizes=[(float(long_m), float(short_m), 0.002)],
                quaternions=[(0.0, 0.0, math.sin(turn / 2.0), math.cos(turn / 2.0))],
            ),
        )
    error = canvas.comparison.localisation(estimate)
    if error is not None:
        canvas.recording.scalar("error/localisation_m", error.distance_m)
        canvas.recording.scalar("error/localisation_deg", math.degrees(error.angle_rad))


def draw_particle_cloud(canvas: Canvas, cloud: msg.PoseArray) -> None:
    """The particles as short strokes along their heading; of many, evenly chosen ones."""
    canvas.at(cloud.header.stamp)
    stride = max(1, math.ceil(len(cloud.poses) / _MAX_PARTICLES))
    poses = [msg.se2_from_pose(pose) for pose in cloud.poses[::stride]]
    xyyaw = np.array(poses, np.float64).reshape(-1, 3)
    tails = np.column_stack([xyyaw[:, :2], np.full(len(xyyaw), 0.025)])
    heads = tails + 0.08 * np.column_stack(
        [np.cos(xyyaw[:, 2]), np.sin(xyyaw[:, 2]), np.zeros(len(xyyaw))]
    )
    looks = rr.LineStrips3D.from_fields(colors=palette.PARTICLE, radii=0.004)
    canvas.frame("particle_cloud", cloud.header.frame_id or MAP_FRAME, looks)
    strokes = np.stack([tails, heads], axis=1).astype(np.float32)
    canvas.recording.log("particle_cloud", rr.LineStrips3D(strokes))


def draw_global_costmap(canvas: Canvas, grid: msg.OccupancyGrid) -> None:
    """The costmap, translucent above the floor."""
    stamp_ns = canvas.at(grid.header.stamp)
    path = "global_costmap/costmap"
    if canvas.changed(path, grid.data.tobytes()) or canvas.due(path, stamp_ns, _LATCH_NS):
        canvas.due(path, stamp_ns, 0)
        canvas.frame(path, grid.header.frame_id or MAP_FRAME)
        colormap = rr.components.Colormap.RvizCostmap
        canvas.recording.log(path, _grid(grid, 0.006, 0.22, colormap))


def draw_plan(canvas: Canvas, plan: msg.Path) -> None:
    """The path being followed."""
    canvas.at(plan.header.stamp)
    points = [(p.pose.position.x, p.pose.position.y, 0.045) for p in plan.poses]
    looks = rr.LineStrips3D.from_fields(colors=palette.PLAN, radii=0.018)
    canvas.frame("plan", plan.header.frame_id or MAP_FRAME, looks)
    strips = [np.array(points, np.float32)] if len(points) > 1 else []
    canvas.recording.log("plan", rr.LineStrips3D(strips))


def draw_cmd_vel(canvas: Canvas, command: msg.TwistStamped) -> None:
    """The commanded velocity."""
    stamp_ns = canvas.at(command.header.stamp)
    if canvas.due("cmd_vel", stamp_ns, _PLOT_NS):
        _draw_twist(canvas, "cmd_vel", command.twist)


def draw_navigation_status(canvas: Canvas, status: doc.NavigationStatus) -> None:
    """States over time, and how far the goal is."""
    canvas.recording.at(canvas.now_ns)
    localization = "active" if status.localization_active else "waiting"
    state = status.state if status.navigation_active else "waiting"
    for path, value in (
        ("navigation/status/localization", localization),
        ("navigation/status/state", state),
    ):
        if canvas.changed(path, value):
            canvas.recording.log(path, rr.StateChange(state=value))
    canvas.recording.scalar("navigation/status/distance_remaining_m", status.distance_remaining_m)
    canvas.recording.scalar("navigation/status/number_of_recoveries", status.number_of_recoveries)


def draw_navigation_result(canvas: Canvas, result: doc.NavigationResult) -> None:
    """How a goal ended, in words and in its colour."""
    canvas.recording.at(round(result.end_time_s * 1e9))
    goal = result.goal
    color = palette.BAD if result.error_code else palette.GOOD
    _draw_arrow(canvas, "goal_pose", msg.pose_from_se2(goal.se2()), color)
    where = f"goal ({goal.x_m:.2f}, {goal.y_m:.2f}, {goal.yaw_rad:.2f})"
    if result.error_code:
        text = f"{where} failed with error {result.error_code}: {result.error_msg}"
    else:
        text = f"{where} reached after {result.end_time_s - result.start_time_s:.1f} s"
    canvas.say("navigation/result", text, "WARN" if result.error_code else "INFO")


def draw_diagnostics(canvas: Canvas, array: msg.DiagnosticArray) -> None:
    """Each service's state over time, and each change in words."""
    canvas.at(array.header.stamp)
    for status in array.status:
        path = f"diagnostics/{status.name}"
        said = [
            (v.key, v.value) for v in status.values
            if v.value and not v.key.startswith((RATE_KEY, REAL_TIME_FACTOR_KEY))
        ]  # fmt: skip
        rejected = any(key.startswith(REJECTED_KEY) for key, _ in said)
        waiting = status.message.startswith("waiting")
        state = "waiting" if waiting else "rejecting" if rejected else "active"
        if canvas.changed(path, state):
            if state == "waiting" or rejected:
                configuration = rr.StateConfiguration(
                    values=list(_STATES), colors=list(_STATES.values())
                )
                canvas.recording.log(path, configuration, static=True)
            canvas.recording.log(path, rr.StateChange(state=state))
        if canvas.changed(f"{path}/text", (status.message, tuple(said))):
            details = "; ".join(f"{key}: {value}" for key, value in said if key != WAITING_KEY)
            text = f"[{status.name}]: {status.message}" + (f" ({details})" if details else "")
            level = status.level if isinstance(status.level, int) else status.level[0]
            canvas.recording.log(path, rr.TextLog(text, level="WARN" if level else "INFO"))


def draw_rosout(canvas: Canvas, log: msg.Log) -> None:
    """A line of a service's log."""
    canvas.at(log.stamp)
    canvas.recording.log(
        f"rosout/{log.name}", rr.TextLog(f"[{log.name}]: {log.msg}", level=_level(log.level))
    )


DRAW: dict[Topic[Any], Callable[[Canvas, Any], None]] = {
    CLOCK: draw_clock,
    WORLD_REQUEST: draw_world_request,
    WORLD_STATUS: draw_world_status,
    PARAMETERS: draw_parameters,
    ASSETS: draw_asset,
    WORLD: draw_world,
    MAP: draw_map,
    DESIRED_ENTITIES: draw_desired_entities,
    ENTITIES: draw_entities,
    TF: draw_tf,
    TF_STATIC: draw_tf_static,
    ODOM: draw_odom,
    JOINT_STATES: draw_joint_states,
    IMU: draw_imu,
    SCAN: draw_scan,
    CAMERA_IMAGE: draw_camera_image,
    CAMERA_INFO: draw_camera_info,
    CAMERA_COMPRESSED: draw_camera_compressed,
    DEPTH_IMAGE: draw_depth_image,
    DEPTH_INFO: draw_depth_info,
    GROUND_TRUTH_ODOM: draw_ground_truth_odom,
    CONTACTS: draw_contact,
    SIMULATION_STATS: draw_simulation_stats,
    DETECTIONS: draw_detections,
    MAP_DETECTIONS: draw_map_detections,
    INITIAL_POSE: draw_initial_pose,
    GOAL_POSE: draw_goal_pose,
    AMCL_POSE: draw_amcl_pose,
    PARTICLE_CLOUD: draw_particle_cloud,
    GLOBAL_COSTMAP: draw_global_costmap,
    PLAN: draw_plan,
    CMD_VEL: draw_cmd_vel,
    NAVIGATION_STATUS: draw_navigation_status,
    NAVIGATION_RESULT: draw_navigation_result,
    DIAGNOSTICS: draw_diagnostics,
    ROSOUT: draw_rosout,
}

_LEVELS = ((50, "CRITICAL"), (40, "ERROR"), (30, "WARN"), (20, "INFO"), (0, "DEBUG"))


def _level(level: int) -> str:
    return next(name for least, name in _LEVELS if level >= least)


@functools.cache
def _directions(count: int, first_rad: float, step_rad: float) -> NDArray[np.float32]:
    """(count, 3) unit vectors of a lidar's beams."""
    angle_rad = first_rad + step_rad * np.arange(count)
    beams = [np.cos(angle_rad), np.sin(angle_rad), np.zeros(count)]
    return np.column_stack(beams).astype(np.float32)


def _draw_twist(canvas: Canvas, path: str, twist: msg.Twist) -> None:
    canvas.recording.scalar(f"{path}/linear_m_s", twist.linear.x)
    canvas.recording.scalar(f"{path}/angular_rad_s", twist.angular.z)


def _draw_trail(
    canvas: Canvas,
    path: str,
    pose: msg.Pose,
    z_m: float,
    color: tuple[int, int, int],
    radius_m: float,
) -> None:
    """The way so far, drawn twice a second while it grows, and less often the longer it is. The
    time must be set.
    """
    trail = canvas.trails.setdefault(path, Trail())
    if trail.add(pose.position.x, pose.position.y):
        canvas.last[f"{path}#grown"] = True
    period_ns = _PATH_NS * (1 + len(trail) // _TRAIL_POINTS)
    if canvas.last.get(f"{path}#grown") and canvas.due(path, canvas.now_ns, period_ns):
        canvas.last[f"{path}#grown"] = False
        looks = rr.LineStrips3D.from_fields(colors=color, radii=radius_m)
        canvas.frame(path, MAP_FRAME, looks)
        canvas.recording.log(path, rr.LineStrips3D([trail.points(z_m)]))


def _draw_arrow(canvas: Canvas, path: str, pose: msg.Pose, color: tuple[int, int, int]) -> None:
    """An arrow along a pose's heading, in a ring of the goal tolerance. The time must be set."""
    at = msg.se2_from_pose(pose)
    turn = np.linspace(0.0, 2.0 * math.pi, 33)
    ring = np.column_stack(
        [at.x_m + 0.25 * np.cos(turn), at.y_m + 0.25 * np.sin(turn), np.full(33, 0.03)]
    )
    canvas.frame(path, MAP_FRAME)
    canvas.recording.log(
        path,
        rr.Arrows3D(
            origins=[(at.x_m, at.y_m, 0.05)],
            vectors=[(0.35 * math.cos(at.yaw_rad), 0.35 * math.sin(at.yaw_rad), 0.0)],
            colors=color,
            radii=0.025,
        ),
    )
    canvas.frame(f"{path}/tolerance", MAP_FRAME)
    canvas.recording.log(f"{path}/tolerance", rr.LineStrips3D([ring], colors=color, radii=0.012))


def _draw_outlines(
    canvas: Canvas, frame: str, outlines: list[NDArray[np.float64]], names: list[str]
) -> None:
    path = "aruco/detections/outline"
    if canvas.changed(path, bool(outlines)) or outlines:
        lines = rr.LineStrips2D.from_fields(colors=palette.MARKER, radii=1.5, draw_order=30.0)
        canvas.frame(path, frame, lines)
        canvas.recording.log(path, rr.LineStrips2D(outlines))
        # A label stands over the middle of its outline, and would hide the marker.
        below = [(outline[:, 0].mean(), outline[:, 1].max() + 8.0) for outline in outlines]
        points = rr.Points2D.from_fields(colors=palette.NAME, radii=0.0, show_labels=True)
        canvas.frame(f"{path}/name", frame, points)
        canvas.recording.log(f"{path}/name", rr.Points2D(below, labels=names))


def _grid(
    grid: msg.OccupancyGrid, z_m: float, opacity: float, colormap: rr.components.Colormap
) -> rr.GridMap:
    # Rerun's first row is the top one, ROS' the one of the smallest y.
    cells = np.flipud(msg.cells_from_grid(grid))
    if colormap == rr.components.Colormap.RvizCostmap:
        # What is unknown lies outside the walls, and would hide the floor.
        cells = np.maximum(cells, 0)
    origin, q = grid.info.origin.position, grid.info.origin.orientation
    return rr.GridMap(
        data=np.ascontiguousarray(cells).view(np.uint8).tobytes(),
        format=rr.components.ImageFormat(
            width=grid.info.width, height=grid.info.height, color_model="L", channel_datatype="U8"
        ),
        cell_size=grid.info.resolution,
        translation=(origin.x, origin.y, z_m),
        quaternion=rr.Quaternion(xyzw=(q.x, q.y, q.z, q.w)),
        opacity=opacity,
        colormap=colormap,
    )


def _transform(entry: msg.TransformStamped) -> rr.Transform3D:
    t, q = entry.transform.translation, entry.transform.rotation
    return rr.Transform3D(
        translation=(t.x, t.y, t.z),
        quaternion=rr.Quaternion(xyzw=(q.x, q.y, q.z, q.w)),
        parent_frame=entry.header.frame_id,
        child_frame=entry.child_frame_id,
    )


def _turn_wheels(canvas: Canvas, angles: dict[str, float]) -> None:
    """Put the wheels of the true robot at their angles. The time must be set."""
    for wheel in canvas.robot.wheels:
        if wheel.joint not in angles:
            continue
        axis, angle_rad = wheel.axis, angles[wheel.joint]
        half_sine = math.sin(angle_rad / 2.0)
        x, y, z = (float(v) * half_sine for v in axis)
        turn = rotation_from_quaternion(x, y, z, math.cos(angle_rad / 2.0))
        xyzw = quaternion_from_rotation(wheel.base_from_joint[:3, :3] @ turn)
        x_m, y_m, z_m = (float(v) for v in wheel.base_from_joint[:3, 3])
        child = f"{TRUTH_FRAME}/{wheel.joint}"
        canvas.recording.transform(
            f"joint_states/{child}", (x_m, y_m, z_m), xyzw, TRUTH_FRAME, child
        )


def _corners(pose: msg.Pose, size_m: Array) -> NDArray[np.float64]:
    """(5, 3) closed outline of a marker's square at a pose."""
    matrix = msg.matrix_from_pose(pose)
    return (_SQUARE * size_m) @ matrix[:3, :3].T + matrix[:3, 3]


def _project(k: Array, corners_m: Array) -> NDArray[np.float64]:
    """(n, 2) pixels of points in an optical frame."""
    z_m = np.maximum(corners_m[:, 2:], 1e-3)
    return (corners_m @ k.T)[:, :2] / z_m

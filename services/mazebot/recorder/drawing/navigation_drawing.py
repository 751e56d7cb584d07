"""How the map, marker detections, localisation and navigation are drawn."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mazebot.common.maths.frames import CAMERA_OPTICAL_FRAME, MAP_FRAME, ODOM_FRAME, SE2, Array
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.rows import array_from_points, array_from_poses
from mazebot.recorder.drawing import palette
from mazebot.recorder.drawing.canvas import LATCH_NS, PATH_NS, Canvas, draw_trail
from mazebot.recorder.drawing.marker_drawing import note_detections
from mazebot.recorder.drawing.picture_drawing import IMAGE_FRAME

_MAX_PARTICLES = 300
_SAME_PLACE_M = 0.05
_REPLACED = (ErrorCode.PREEMPTED, ErrorCode.CANCELED, ErrorCode.WORLD_RESTARTED)
"""The goal was not wanted any more."""

_SQUARE: Array = np.array(
    [[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0], [-0.5, -0.5, 0.0]]
)


def draw_map(canvas: Canvas, grid: msg.OccupancyGrid) -> None:
    """The occupancy map, just above the floor; one that the robot makes, at the time it came."""
    drawn = _grid(grid, 0.002, 0, rr.components.Colormap.RvizMap, opacity=0.7)
    if canvas.world.slam:
        canvas.recording.at(canvas.now_ns)
        canvas.frame("map", MAP_FRAME)
        canvas.recording.log("map", drawn)
    else:
        canvas.recording.log("map", rr.CoordinateFrame(MAP_FRAME), drawn, static=True)


def draw_detections(canvas: Canvas, detections: msg.Detection3DArray) -> None:
    """The markers' outlines, in the image and in the camera's frame, and their distances.

    The second solution of each pose is grey.
    """
    canvas.at(detections.header.stamp)
    canvas.recording.scalar("aruco/detections/count", len(detections.detections))
    note_detections(canvas, detections)
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
                _strips([corners for _, corners, _ in poses] + others),
                colors=[palette.MARKER] * len(poses) + [palette.SECOND] * len(others),
                radii=[0.006] * len(poses) + [0.002] * len(others),
            ),
        )
    entities = canvas.entities.markers if canvas.entities else ()
    errors_m = [error_m for _, error_m in canvas.comparison.markers(detections, entities)]
    canvas.measured("error/marker_m", max(errors_m, default=None))


def draw_map_detections(canvas: Canvas, detections: msg.Detection3DArray) -> None:
    """The markers at their detected poses in the map."""
    canvas.at(detections.header.stamp)
    seen = [detection for detection in detections.detections if detection.results]
    if canvas.changed("aruco/detections_map", bool(seen)) or seen:
        places = [detection.results[0].pose.pose.position for detection in seen]
        canvas.frame("aruco/detections_map", detections.header.frame_id or MAP_FRAME)
        canvas.recording.log(
            "aruco/detections_map",
            rr.Points3D(
                [(p.x, p.y, p.z) for p in places],
                colors=palette.NAME,
                radii=0.03,
            ),
        )


def draw_initial_pose(canvas: Canvas, estimate: msg.PoseWithCovarianceStamped) -> None:
    """The initial pose that was set by the user."""
    canvas.at(estimate.header.stamp)
    _draw_arrow(canvas, "initialpose", estimate.pose.pose, palette.ESTIMATE)


def draw_goal_pose(canvas: Canvas, goal: msg.PoseStamped) -> None:
    """The goal pose."""
    canvas.at(goal.header.stamp)
    _draw_arrow(canvas, "goal_pose", goal.pose, palette.PLAN)
    place = msg.se2_from_pose(goal.pose)
    canvas.event("goal", f"goal: {_place_name(canvas, place)}")


def draw_goal_update(canvas: Canvas, goal: msg.PoseStamped) -> None:
    """Where the goal of the task has moved to."""
    canvas.at(goal.header.stamp)
    _draw_arrow(canvas, "goal_update", goal.pose, palette.PLAN)


def draw_controller_selector(canvas: Canvas, name: msg.String) -> None:
    """The controller chosen for a behaviour tree, in the log."""
    canvas.log_text("controller_selector", f"controller: {name.data or 'default'}")


def draw_planner_selector(canvas: Canvas, name: msg.String) -> None:
    """The planner chosen for a behaviour tree, in the log."""
    canvas.log_text("planner_selector", f"planner: {name.data or 'default'}")


def draw_speed_limit(canvas: Canvas, limit: msg.SpeedLimit) -> None:
    """The highest speed that was asked for, in the log."""
    canvas.at(limit.header.stamp)
    heard = act.SpeedLimit(percentage=limit.percentage, speed_limit=limit.speed_limit)
    canvas.log_text("speed_limit", f"speed limit: {heard}")


def _place_name(canvas: Canvas, at: SE2) -> str:
    """The name of the location there, if it has one, and its coordinates."""
    near_m = [
        (math.hypot(place.x_m - at.x_m, place.y_m - at.y_m), place.name)
        for place in canvas.world.locations
    ]
    distance_m, name = min(near_m, default=(math.inf, ""))
    coordinates = f"({at.x_m:.2f}, {at.y_m:.2f})"
    return f"{name} {coordinates}" if distance_m < _SAME_PLACE_M else coordinates


def draw_amcl_pose(canvas: Canvas, estimate: msg.PoseWithCovarianceStamped) -> None:
    """The estimated pose's uncertainty (2 sigma), its path, and its error."""
    stamp_ns = canvas.at(estimate.header.stamp)
    pose = estimate.pose.pose
    draw_trail(canvas, "amcl_pose/path", pose, 0.06, palette.ESTIMATE, 0.012)
    if canvas.due("amcl_pose", stamp_ns, PATH_NS):
        covariance = np.asarray(estimate.pose.covariance).reshape(6, 6)[:2, :2]
        variances, axes = np.linalg.eigh((covariance + covariance.T) / 2.0)
        turn = math.atan2(float(axes[1, 1]), float(axes[0, 1]))
        long_m, short_m = 2.0 * np.sqrt(np.maximum(variances[::-1], 1e-8))
        canvas.frame(
            "amcl_pose", estimate.header.frame_id or MAP_FRAME,
            lambda: rr.Ellipsoids3D.from_fields(
                colors=palette.ESTIMATE, fill_mode=rr.components.FillMode.Solid
            ),
        )  # fmt: skip
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
    """The particles as short strokes along their heading; evenly subsampled if there are many."""
    canvas.at(cloud.header.stamp)
    stride = max(1, math.ceil(len(cloud.poses) / _MAX_PARTICLES))
    numbers = array_from_poses(cloud.poses[::stride])
    xyz_m, (x, y, z, w) = numbers[:, :3], numbers[:, 3:].T
    yaw_rad = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    strokes = np.full((len(xyz_m), 2, 3), 0.025, np.float32)
    strokes[:, :, :2] = xyz_m[:, np.newaxis, :2]
    strokes[:, 1, 0] += 0.08 * np.cos(yaw_rad)
    strokes[:, 1, 1] += 0.08 * np.sin(yaw_rad)
    canvas.frame(
        "particle_cloud", cloud.header.frame_id or MAP_FRAME,
        lambda: rr.LineStrips3D.from_fields(colors=palette.PARTICLE, radii=0.004),
    )  # fmt: skip
    canvas.recording.log("particle_cloud", rr.LineStrips3D(strokes))


def draw_global_costmap(canvas: Canvas, grid: msg.OccupancyGrid) -> None:
    """The costmap, translucent above the floor."""
    stamp_ns = canvas.at(grid.header.stamp)
    path = "global_costmap/costmap"
    if canvas.changed(path, grid.data.tobytes()) or canvas.due(path, stamp_ns, LATCH_NS):
        canvas.due(path, stamp_ns, 0)
        canvas.frame(path, grid.header.frame_id or MAP_FRAME)
        colormap = rr.components.Colormap.RvizCostmap
        canvas.recording.log(path, _grid(grid, 0.006, 1, colormap))


def draw_local_costmap(canvas: Canvas, grid: msg.OccupancyGrid) -> None:
    """The costmap around the robot, above the global one."""
    stamp_ns = canvas.at(grid.header.stamp)
    path = "local_costmap/costmap"
    if canvas.changed(path, grid.data.tobytes()) or canvas.due(path, stamp_ns, LATCH_NS):
        canvas.due(path, stamp_ns, 0)
        canvas.frame(path, grid.header.frame_id or ODOM_FRAME)
        colormap = rr.components.Colormap.RvizCostmap
        canvas.recording.log(path, _grid(grid, 0.008, 2, colormap))


def draw_keepout_mask(canvas: Canvas, grid: msg.OccupancyGrid) -> None:
    """Where the robot must not drive, in the colours of a costmap."""
    _draw_mask(canvas, "keepout_filter_mask", grid, 0.010, 4)


def draw_speed_mask(canvas: Canvas, grid: msg.OccupancyGrid) -> None:
    """Where the robot must be slow: from blue to red, the slower."""
    _draw_mask(canvas, "speed_filter_mask", grid, 0.009, 3)


def _draw_mask(
    canvas: Canvas, path: str, grid: msg.OccupancyGrid, z_m: float, draw_order: int
) -> None:
    canvas.at(grid.header.stamp)
    if canvas.changed(path, grid.data.tobytes()):
        canvas.frame(path, grid.header.frame_id or MAP_FRAME)
        colormap = rr.components.Colormap.RvizCostmap
        canvas.recording.log(path, _grid(grid, z_m, draw_order, colormap))


def draw_plan(canvas: Canvas, plan: msg.Path) -> None:
    """The path being followed."""
    canvas.at(plan.header.stamp)
    points = [(p.pose.position.x, p.pose.position.y, 0.045) for p in plan.poses]
    canvas.frame(
        "plan", plan.header.frame_id or MAP_FRAME,
        lambda: rr.LineStrips3D.from_fields(colors=palette.PLAN, radii=0.018),
    )  # fmt: skip
    strips = [np.array(points, np.float32)] if len(points) > 1 else []
    canvas.recording.log("plan", rr.LineStrips3D(strips))


def draw_trajectories(canvas: Canvas, array: msg.MarkerArray) -> None:
    """The line strips of a controller's rollouts, in their own colours and widths."""
    strips = [marker for marker in array.markers if marker.type == msg.Marker.LINE_STRIP]
    if not strips:
        return
    canvas.at(strips[0].header.stamp)
    canvas.frame("trajectories", strips[0].header.frame_id or MAP_FRAME)
    colors = [(one.color.r, one.color.g, one.color.b, one.color.a) for one in strips]
    canvas.recording.log(
        "trajectories",
        rr.LineStrips3D(
            _strips([array_from_points(one.points) for one in strips]),
            colors=colors,
            radii=[one.scale.x / 2.0 for one in strips],
        ),
    )


def _strips(lines: list[Array]) -> NDArray[np.float32] | list[Array]:
    """Lines with the same number of points as one array, which Rerun takes much faster."""
    alike = len({len(line) for line in lines}) == 1
    return np.stack(lines).astype(np.float32) if alike else lines


def draw_localization_status(canvas: Canvas, status: doc.LocalizationStatus) -> None:
    """The state over time, and how outcome the scans match the map."""
    canvas.recording.at(canvas.now_ns)
    if canvas.changed("localization/status/state", status.state):
        is_bad = status.state == "lost"
        level = "WARN" if is_bad else "INFO"
        canvas.event("localization", f"localization: {status.state}", level)
        canvas.recording.log("localization/status/state", rr.StateChange(state=status.state))
    canvas.recording.scalar("localization/status/quality", status.quality)


def draw_navigation_status(canvas: Canvas, status: doc.NavigationStatus) -> None:
    """States over time, and the distance to the goal."""
    canvas.recording.at(canvas.now_ns)
    state = status.state if status.navigation_active else "waiting"
    if canvas.changed("navigation/status/state", state):
        canvas.recording.log("navigation/status/state", rr.StateChange(state=state))
    remaining_m = None if status.goal is None else status.distance_remaining_m
    canvas.measured("navigation/status/distance_remaining_m", remaining_m)
    recoveries = status.number_of_recoveries
    before = canvas.last.get("navigation/status/number_of_recoveries")
    canvas.last["navigation/status/number_of_recoveries"] = recoveries
    if recoveries > (before if isinstance(before, int) else 0):
        canvas.event("recovery", f"recovery {recoveries} of this goal", "WARN")
    canvas.recording.scalar("navigation/status/number_of_recoveries", recoveries)


def draw_action_feedback(canvas: Canvas, feedback: act.ActionFeedback) -> None:
    """Which action runs, over time."""
    canvas.recording.at(canvas.now_ns)
    path = "navigation/feedback/action"
    if canvas.changed(path, feedback.action):
        canvas.recording.log(path, rr.StateChange(state=feedback.action))
    if feedback.goal is not None and canvas.changed("goal_pose", (feedback.goal, feedback.goal_id)):
        _draw_arrow(canvas, "goal_pose", msg.pose_from_se2(feedback.goal.se2()), palette.PLAN)


def draw_action_result(canvas: Canvas, result: act.ActionResult) -> None:
    """How an action ended, in the log."""
    canvas.recording.at(round(result.end_time_s * 1e9))
    path = "navigation/feedback/action"
    if canvas.changed(path, result.status):
        canvas.recording.log(path, rr.StateChange(state=result.status))
    _log_end(canvas, result.action.replace("_", " "), result.status, result)
    if result.goal is not None:
        color = palette.BAD if result.error_code else palette.GOOD
        _draw_arrow(canvas, "goal_pose", msg.pose_from_se2(result.goal.se2()), color)


def draw_photo_request(canvas: Canvas, request: act.PhotoRequest) -> None:
    """At which waypoint the next picture is taken."""
    canvas.recording.at(request.stamp_ns)
    canvas.recording.log("waypoint_photo/request", rr.TextLog(f"waypoint {request.waypoint}"))


def draw_global_localization_request(canvas: Canvas, _: act.Empty) -> None:
    """That a behaviour tree asks for it, in the log."""
    canvas.log_text(
        "navigation/global_localization", "the behavior tree requested global localization"
    )


def draw_collision_monitor(canvas: Canvas, state: act.CollisionMonitorState) -> None:
    """What the collision monitor does, over time."""
    canvas.recording.at(canvas.now_ns)
    path = "collision_monitor_state"
    if canvas.changed(path, state.action):
        canvas.recording.log(path, rr.StateChange(state=state.action))
        if state.action == "stop":
            canvas.event("fault", f"collision monitor: stop ({state.polygon_name})", "WARN")


def draw_navigation_result(canvas: Canvas, result: doc.NavigationResult) -> None:
    """The result of a goal, in its colour."""
    canvas.recording.at(round(result.end_time_s * 1e9))
    color = palette.BAD if result.error_code else palette.GOOD
    _draw_arrow(canvas, "goal_pose", msg.pose_from_se2(result.goal.se2()), color)
    _log_end(canvas, "goal", "reached", result)


def _log_end(
    canvas: Canvas, what: str, outcome: str, result: doc.NavigationResult | act.ActionResult
) -> None:
    """How a goal ended, as an event. The time must be set."""
    took_s = result.end_time_s - result.start_time_s
    if result.error_code in _REPLACED:
        why = "" if result.error_msg in ("", "canceled") else f": {result.error_msg}"
        canvas.event("goal", f"{what} canceled after {took_s:.1f} s{why}")
    elif result.error_code:
        why = f"{result.error_msg} ({result.error_code})" if result.error_msg else ""
        text = f"{what} failed after {took_s:.1f} s: {why or result.error_code}"
        canvas.event("goal", text, "WARN")
    else:
        canvas.event("goal", f"{what} {outcome} after {took_s:.1f} s")


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
        canvas.frame(
            path, frame,
            lambda: rr.LineStrips2D.from_fields(
                colors=palette.MARKER, radii=1.5, draw_order=30.0
            ),
        )  # fmt: skip
        canvas.recording.log(path, rr.LineStrips2D(_strips(outlines)))
        # A label is drawn over the middle of its outline, and would hide the marker.
        below = [(outline[:, 0].mean(), outline[:, 1].max() + 8.0) for outline in outlines]
        canvas.frame(
            f"{path}/name", frame,
            lambda: rr.Points2D.from_fields(colors=palette.NAME, radii=0.0, show_labels=True),
        )  # fmt: skip
        canvas.recording.log(f"{path}/name", rr.Points2D(below, labels=names))


def _grid(
    grid: msg.OccupancyGrid,
    z_m: float,
    draw_order: int,
    colormap: rr.components.Colormap,
    opacity: float | None = None,
) -> rr.GridMap:
    """A grid above all grids of a lower `draw_order`; without an opacity, the view's is used."""
    # Rerun's first row is the top one; in ROS it is the one with the smallest y.
    cells = np.flipud(msg.cells_from_grid(grid))
    if colormap == rr.components.Colormap.RvizCostmap:
        # Unknown cells lie outside the walls, and would hide the floor.
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
        draw_order=draw_order,
        colormap=colormap,
    )


def _corners(pose: msg.Pose, size_m: Array) -> NDArray[np.float64]:
    """(5, 3) closed outline of a marker's square at a pose."""
    matrix = msg.matrix_from_pose(pose)
    return (_SQUARE * size_m) @ matrix[:3, :3].T + matrix[:3, 3]


def _project(k: Array, corners_m: Array) -> NDArray[np.float64]:
    """(n, 2) pixels of points in an optical frame."""
    z_m = np.maximum(corners_m[:, 2:], 1e-3)
    return (corners_m @ k.T)[:, :2] / z_m

"""How the pose graph, the exploration and the judged map are drawn."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mazebot.common.maths.frames import MAP_FRAME, Array, rotation_from_quaternion
from mazebot.common.messages import messages as msg
from mazebot.common.messages import slam_documents as slam
from mazebot.common.messages.documents import MapEvaluation
from mazebot.common.messages.rows import array_from_points
from mazebot.recorder.drawing import palette
from mazebot.recorder.drawing.canvas import Canvas

Points = NDArray[np.float32]
_NO_POINTS = np.zeros((0, 3), np.float32)

SLAM_SERIES: dict[str, tuple[str, tuple[int, int, int]]] = {
    "mapping/coverage_percent": ("reachable floor mapped", palette.ESTIMATE),
    "mapping/walls_found_percent": ("walls found", palette.TRUTH),
    "mapping/walls_true_percent": ("occupied cells that are walls", palette.PLAN),
    "explore/status/seen_percent": ("floor seen, by the explorer", palette.SECOND),
    "explore/status/frontiers": ("frontiers", palette.SECOND),
    "explore/status/reachable": ("reachable", palette.GOOD),
    "explore/status/set_aside": ("set aside", palette.BAD),
    "mapping/keyframes": ("keyframes", palette.SECOND),
    "mapping/loops": ("loops", palette.GOOD),
}
"""Entities that are time series in runs that make a map, with their name and colour."""

_GRAPH_Z_M, _AXIS_M = 0.08, 0.2
"""Above the paths."""
_KINDS = {
    "odometry": palette.SECOND,
    "scan_match": palette.SECOND,
    "loop": palette.GOOD,
    "marker": palette.MARKER,
}
_SINGLE = {
    msg.Marker.SPHERE,
    msg.Marker.CUBE,
    msg.Marker.CYLINDER,
    msg.Marker.ARROW,
    msg.Marker.TEXT_VIEW_FACING,
}
_DRAWN = _SINGLE | {msg.Marker.POINTS, msg.Marker.SPHERE_LIST, msg.Marker.CUBE_LIST}  # fmt: skip


def draw_pose_graph(canvas: Canvas, graph: slam.PoseGraph) -> None:
    """Keyframes as points, their edges by kind, and markers as axes with their ids."""
    canvas.recording.at(canvas.now_ns)
    places = {node.id: (node.pose.x_m, node.pose.y_m, _GRAPH_Z_M) for node in graph.nodes}
    landmarks = [one.position_m for one in graph.landmarks]
    edges: dict[str, list[tuple[object, object]]] = {kind: [] for kind in _KINDS}
    for edge in graph.edges:
        end = edge.target < len(landmarks) if edge.kind == "marker" else edge.target in places
        if edge.source in places and end:
            target = landmarks[edge.target] if edge.kind == "marker" else places[edge.target]
            edges[edge.kind].append((places[edge.source], target))
    canvas.frame(
        "pose_graph/nodes", MAP_FRAME,
        lambda: rr.Points3D.from_fields(colors=palette.PLAN, radii=0.035),
    )  # fmt: skip
    canvas.recording.log("pose_graph/nodes", rr.Points3D(list(places.values())))
    for kind, color in _KINDS.items():
        path = f"pose_graph/{kind}"
        radius_m = 0.012 if kind == "loop" else 0.005
        looks = functools.partial(rr.LineStrips3D.from_fields, colors=color, radii=radius_m)
        canvas.frame(path, MAP_FRAME, looks)
        canvas.recording.log(path, rr.LineStrips3D(np.array(edges[kind]).reshape(-1, 2, 3)))
    _draw_landmarks(canvas, graph.landmarks)
    canvas.recording.scalar("mapping/keyframes", len(graph.nodes))
    canvas.recording.scalar("mapping/loops", graph.loops)


def _draw_landmarks(canvas: Canvas, landmarks: Iterable[slam.GraphLandmark]) -> None:
    origins, vectors, colors, names = [], [], [], []
    for one in landmarks:
        axes = rotation_from_quaternion(*one.orientation_xyzw)
        origins += [one.position_m] * 3
        vectors += [_AXIS_M * axes[:, axis] for axis in range(3)]
        colors += [(230, 60, 60), (60, 200, 60), (70, 110, 255)]
        names.append(f"{one.marker_id}" + (f" ({one.instance})" if one.instance else ""))
    path = "pose_graph/landmarks"
    canvas.frame(path, MAP_FRAME)
    canvas.recording.log(
        path,
        rr.Arrows3D(
            origins=np.array(origins).reshape(-1, 3),
            vectors=np.array(vectors).reshape(-1, 3),
            colors=colors,
            radii=0.012,
        ),
    )
    path = "pose_graph/landmarks/names"
    canvas.frame(path, MAP_FRAME)
    canvas.recording.log(
        path,
        rr.Points3D(
            np.array(origins[::3]).reshape(-1, 3), labels=names, colors=palette.NAME, radii=0.02
        ),
    )


def draw_exploration_status(canvas: Canvas, status: slam.ExplorationStatus) -> None:
    """The state over time, what it waits for, and its own view of the coverage."""
    canvas.recording.at(canvas.now_ns)
    if canvas.changed("explore/status/state", status.state):
        canvas.recording.log("explore/status/state", rr.StateChange(state=status.state))
    if canvas.changed("explore/status", (status.state, status.reason)):
        text = f"exploration: {status.state}" + (f": {status.reason}" if status.reason else "")
        level = "WARN" if status.state == "failed" else "INFO"
        canvas.recording.log("explore/status", rr.TextLog(text, level=level))
    canvas.recording.scalar("explore/status/seen_percent", 100.0 * status.seen_share)
    canvas.recording.scalar("explore/status/frontiers", status.frontiers)
    canvas.recording.scalar("explore/status/reachable", status.reachable)
    canvas.recording.scalar("explore/status/set_aside", status.set_aside)


def draw_explore_resume(canvas: Canvas, resume: msg.Bool) -> None:
    """That the exploration is stopped or resumed, in the log."""
    canvas.log_text("explore/resume", "exploration: resume" if resume.data else "exploration: stop")


def draw_frontiers(canvas: Canvas, array: msg.MarkerArray) -> None:
    """Points, lists and arrows in their own colours; text as labels."""
    canvas.recording.at(canvas.now_ns)
    points: list[Points] = []
    colors: list[tuple[float, float, float, float]] = []
    radii: list[float] = []
    labels: list[tuple[Points, str]] = []
    strips: list[Points] = []
    strip_colors = []
    for marker in array.markers:
        if marker.action != msg.Marker.ADD:
            continue
        color = (marker.color.r, marker.color.g, marker.color.b, marker.color.a)
        cells = _marker_points(marker)
        if marker.type == msg.Marker.TEXT_VIEW_FACING:
            labels.append((cells[:1], marker.text))
        elif marker.type == msg.Marker.LINE_STRIP:
            strips.append(cells)
            strip_colors.append(color)
        elif marker.type in _DRAWN:
            points.append(cells)
            colors += [color] * len(cells)
            radii += [max(marker.scale.x / 2.0, 0.01)] * len(cells)
    canvas.frame("explore/frontiers", MAP_FRAME)
    canvas.recording.log(
        "explore/frontiers",
        rr.Points3D(np.concatenate(points or [_NO_POINTS]), colors=colors, radii=radii),
    )
    if canvas.changed("explore/frontiers/lines", bool(strips)) or strips:
        canvas.frame("explore/frontiers/lines", MAP_FRAME)
        lines = rr.LineStrips3D(strips, colors=strip_colors, radii=0.015)
        canvas.recording.log("explore/frontiers/lines", lines)
    if canvas.changed("explore/frontiers/names", bool(labels)) or labels:
        canvas.frame("explore/frontiers/names", MAP_FRAME)
        at: Points = np.concatenate([place for place, _ in labels] or [_NO_POINTS])
        names = rr.Points3D(at, labels=[text for _, text in labels], radii=0.0)
        canvas.recording.log("explore/frontiers/names", names)


def draw_true_walls(canvas: Canvas, faces_m: Array) -> None:
    """The true faces on the lidar's level that can be seen: (n, 2, 2) segments, from and to."""
    strips = np.concatenate([faces_m, np.full((len(faces_m), 2, 1), 0.03)], axis=2)
    looks = rr.LineStrips3D(strips.astype(np.float32), colors=palette.TRUTH, radii=0.008)
    canvas.recording.log("mapping/true_walls", rr.CoordinateFrame(MAP_FRAME), looks, static=True)


def draw_map_evaluation(canvas: Canvas, judged: MapEvaluation) -> None:
    """The map's figures against the world."""
    canvas.recording.at(canvas.now_ns)
    for name in ("coverage", "walls_found", "walls_true"):
        share = getattr(judged, f"{name}_share")
        if share is not None:
            canvas.recording.scalar(f"mapping/{name}_percent", 100.0 * share)


def _marker_points(marker: Any) -> Points:
    """(n, 3) its points, or, of a single shape, its pose, in the frame of its message."""
    map_from_marker = msg.matrix_from_pose(marker.pose)
    points = array_from_points(marker.points)
    if marker.type in _SINGLE:
        return np.asarray(map_from_marker[:3, 3][None], np.float32)
    return np.asarray(points @ map_from_marker[:3, :3].T + map_from_marker[:3, 3], np.float32)

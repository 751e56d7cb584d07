"""Messages as frames for the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar, cast

import cv2
import numpy as np

from mazebot.common.maths.frames import Array, pose_matrix, se2_from_matrix
from mazebot.common.maths.portable import product
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.scan import Mount
from mazebot.common.messages.slam_documents import PoseGraph
from mazebot.common.robot.known_markers import known_markers
from mazebot.common.world.footprint import footprint, wall_corners
from mazebot.console.live.frame import Frame, binary_frame, text_frame

T = TypeVar("T")

_MOST_PARTICLES = 2000
_MOST_POINTS = 4000
_JPEG_QUALITY = 70
_CAMERA_WIDTH_PX = 480
_MM_PER_M = 1000.0
_NO_RETURN_MM = 65_535


def world_frame(world: doc.World) -> Frame:
    """The plan of a world: polygons in m, places and zones."""
    return text_frame(
        "world",
        {
            "name": world.name,
            "hash": world.hash,
            "slam": world.slam,
            "explore": world.explore,
            "walls": [wall_corners(wall) for wall in world.walls],
            "bodies": [_body(body) for body in world.bodies],
            "rooms": [{"name": room.name, "polygon_m": room.polygon_m} for room in world.rooms],
            "locations": [place.model_dump() for place in world.locations],
            "keepout_zones": [zone.polygon_m for zone in world.keepout_zones],
            "speed_limits": [zone.polygon_m for zone in world.speed_limits],
            "start": world.start.model_dump(),
        },
    )


def entities_frame(entities: doc.Entities, world: doc.World | None) -> Frame:
    """The bodies and markers that exist, and the names of those markers that are docks."""
    markers = []
    for marker in entities.markers:
        matrix = pose_matrix(marker)
        x, y = matrix[:2, 3].tolist()
        heading_rad = math.atan2(matrix[1, 2], matrix[0, 2])
        markers.append(
            {
                "name": marker.name, "id": marker.marker_id, "x_m": x, "y_m": y,
                "heading_rad": heading_rad, "size_m": marker.marker_size_m,
            }
        )  # fmt: skip
    refused = [refusal.model_dump() for refusal in entities.refused]
    docks = known_markers(world, entities.markers).known if world is not None else ()
    content = {
        "bodies": [_body(body) for body in entities.bodies], "markers": markers,
        "docks": [marker.name for marker in docks], "refused": refused,
    }  # fmt: skip
    return text_frame("entities", content)


def _body(body: doc.Body | doc.BodyEntity) -> dict[str, object]:
    """A body's footprint in the map. A mesh has none here: what stands still is on the map."""
    matrix = pose_matrix(body)
    polygons: list[list[list[float]]] = []
    for shape in body.shapes:
        if shape.solid and not isinstance(shape.geometry, doc.Mesh):
            found = footprint(shape.geometry, product(matrix, pose_matrix(shape)), {})
            polygons += [polygon for group in found.polygons_m for polygon in group.tolist()]
    pose = se2_from_matrix(matrix)
    return {"name": body.name, "polygons_m": polygons, "pose": tuple(pose), "moves": body.moves}


def grid_frame(kind: str, grid: msg.OccupancyGrid, map_from_frame: Array | None) -> Frame:
    """A grid: int8 cells row by row, row 0 at the smallest y. `map_from_frame` (4, 4) is where its
    frame is in the map; None: it is the map.
    """
    origin = msg.matrix_from_pose(grid.info.origin)
    if map_from_frame is not None:
        origin = product(map_from_frame, origin)
    header = {
        "columns": grid.info.width,
        "rows": grid.info.height,
        "resolution_m": float(grid.info.resolution),
        "origin": tuple(se2_from_matrix(origin)),
    }
    return binary_frame(kind, header, grid.data.astype(np.int8).tobytes())


def scan_frame(scan: msg.LaserScan, map_from_lidar: Array) -> Frame:
    """A scan: uint16 ranges in mm, 65535 where nothing was hit, from a (4, 4) pose of the lidar."""
    ranges_m = scan.ranges.astype(np.float64)
    hits = np.isfinite(ranges_m) & (ranges_m >= scan.range_min) & (ranges_m <= scan.range_max)
    millimetres = np.where(hits, np.minimum(ranges_m * _MM_PER_M, _NO_RETURN_MM - 1), _NO_RETURN_MM)
    lidar = Mount.of(map_from_lidar)
    angle_end_rad = float(scan.angle_min) + len(ranges_m) * float(scan.angle_increment)
    header = {
        "pose": tuple(lidar.base_from_scan),
        "angle_min_rad": lidar.angle_rad(float(scan.angle_min)),
        # Not the increment: four decimals are too few for what is multiplied.
        "angle_end_rad": lidar.angle_rad(angle_end_rad),
    }
    return binary_frame("scan", header, millimetres.astype("<u2").tobytes())


def path_frame(path: msg.Path) -> Frame:
    """The path: its points in m."""
    points = [(one.pose.position.x, one.pose.position.y) for one in path.poses]
    return text_frame("plan", {"points_m": _thinned(points)})


def particles_frame(cloud: msg.PoseArray) -> Frame:
    """Particles: float32 x, y in m and yaw in rad of each."""
    poses = [tuple(msg.se2_from_pose(pose)) for pose in cloud.poses]
    data = np.array(_thinned(poses, _MOST_PARTICLES), "<f4").reshape(-1, 3)
    return binary_frame("particles", {"count": len(data)}, data.tobytes())


def shapes_frame(kind: str, array: msg.MarkerArray) -> Frame:
    """Lines and points with their colours."""
    shapes = []
    for one in array.markers:
        # The type hints of rosbags name the same class of another distribution.
        marker = cast("msg.Marker", one)
        points = [(point.x, point.y) for point in marker.points]
        color = marker.color
        shapes.append(
            {
                "name": marker.ns,
                "is_line": marker.type == msg.Marker.LINE_STRIP,
                "rgb": [round(255 * value) for value in (color.r, color.g, color.b)],
                "width_m": marker.scale.x,
                "points_m": _thinned(points),
            }
        )
    return text_frame(kind, {"shapes": shapes})


def graph_frame(graph: PoseGraph) -> Frame:
    """The pose graph: nodes, edges as pairs of nodes, markers as mapped."""
    index = {node.id: position for position, node in enumerate(graph.nodes)}
    edges = [
        (index[edge.source], index[edge.target], edge.kind == "loop")
        for edge in graph.edges
        if edge.kind != "marker" and edge.source in index and edge.target in index
    ]
    content = {
        "nodes": [(node.pose.x_m, node.pose.y_m) for node in graph.nodes],
        "edges": edges,
        "markers": [(one.marker_id, *one.position_m[:2]) for one in graph.landmarks],
        "loops": graph.loops,
    }
    return text_frame("graph", content)


def camera_frame(image: msg.Image) -> Frame:
    """The camera's picture as a small JPEG."""
    pixels = image.data.reshape(image.height, image.width, 3)
    if image.width > _CAMERA_WIDTH_PX:
        height = max(1, round(image.height * _CAMERA_WIDTH_PX / image.width))
        pixels = cv2.resize(
            pixels, (_CAMERA_WIDTH_PX, height), interpolation=cv2.INTER_AREA
        ).astype(np.uint8)
    _, data = cv2.imencode(
        ".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    )
    return binary_frame("camera", {"time_s": stamp_s(image.header)}, data.tobytes())


def detections_frame(array: msg.Detection3DArray, info: msg.CameraInfo | None) -> Frame:
    """The markers in a picture of the camera: their ids, and with its intrinsics their corners, as
    shares of its width and height from its upper left.
    """
    ids, outlines = [], []
    for detection in array.detections:
        if not detection.results:
            continue
        marker_id = detection.results[0].hypothesis.class_id
        ids.append(marker_id)
        if info is None or not info.width or not info.height:
            continue
        half_m = detection.bbox.size.x / 2.0
        corners_m = half_m * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
        camera_from_marker = msg.matrix_from_pose(detection.results[0].pose.pose)
        in_camera_m = corners_m @ camera_from_marker[:3, :3].T + camera_from_marker[:3, 3]
        if (in_camera_m[:, 2] <= 0.0).any():
            continue
        pixels = in_camera_m @ np.asarray(info.k, np.float64).reshape(3, 3).T
        shares = pixels[:, :2] / pixels[:, 2:] / (info.width, info.height)
        outlines.append({"id": marker_id, "corners": shares.tolist()})
    content = {"time_s": stamp_s(array.header), "ids": ids, "outlines": outlines}
    return text_frame("detections", content)


def services_frame(array: msg.DiagnosticArray) -> list[Frame]:
    """The state of each service."""
    return [
        text_frame(
            f"service {status.name}",
            {
                "name": status.name,
                "level": int(status.level),
                "message": status.message,
                "values": {value.key: value.value for value in status.values},
            },
        )
        for status in array.status
    ]


def log_frame(log: msg.Log) -> Frame:
    """A line of the log."""
    content = {
        "time_s": msg.ns_from_time(log.stamp) * 1e-9, "level": int(log.level), "name": log.name,
        "text": log.msg,
    }  # fmt: skip
    return text_frame("log", content, is_event=True)


def stamp_s(header: msg.Header) -> float:
    """Simulation time of a message."""
    return msg.ns_from_time(header.stamp) * 1e-9


def _thinned(points: Sequence[T], most: int = _MOST_POINTS) -> Sequence[T]:
    return points[:: -(-len(points) // most)] if points else points

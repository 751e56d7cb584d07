"""A pose graph as a document and as a file, and its markers as a recipe's."""

from __future__ import annotations

import base64
import binascii
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from mazebot.common.config import ConfigError, must
from mazebot.common.files.folder_writing import write_file
from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, rotation_from_quaternion, wrap_angle
from mazebot.common.messages.documents import Marker, Planar, Wall
from mazebot.common.messages.slam_documents import (
    GraphEdge,
    GraphLandmark,
    GraphNode,
    GraphScan,
    PoseGraph,
)
from mazebot.common.problems import field_name, shown_value
from mazebot.mapping.graph.optimizer import chi2
from mazebot.mapping.graph.pose_graph import CAUCHY, HUBER, KINDS, LOOP, MARKER, PLAIN, Graph

MAX_FILE_BYTES = 512 * 1024 * 1024
Millimetres = NDArray[np.int32]
"""(n, 2) x and y."""

_MOST_GAP_M = 0.15
_MOST_TURN_RAD = math.radians(20.0)
"""A marker hangs on a wall whose face is this near, and turned by no more."""
_PANEL_THICKNESS_M = 0.02


class NodeScan(NamedTuple):
    """What a node's scan showed, by the axes of the node."""

    stamp_ns: int
    points_mm: Millimetres
    """Where beams ended at an obstacle."""
    misses_mm: Millimetres
    """How far beams without a return saw free space."""
    sensor: SE2
    """base_from_scan."""


@dataclass(frozen=True)
class LoadedGraph:
    """A graph as it was when its document was made."""

    graph: Graph
    scans: tuple[NodeScan, ...]
    """Of the nodes."""
    landmarks: tuple[GraphLandmark, ...]
    """Of the graph's landmarks: see `MarkerLandmarks.restored`."""


def millimetres(points_m: Array) -> Millimetres:
    """(n, 2) points in whole millimetres."""
    return np.floor(np.asarray(points_m, np.float64) * 1000.0 + 0.5).astype(np.int32)


def metres(points_mm: Millimetres) -> Array:
    """(n, 2) points in metres."""
    return np.asarray(points_mm, np.float64) / 1000.0


def robust_kernel(kind: int) -> int:
    """The robust kernel of an edge by its kind: a document does not give it."""
    return CAUCHY if kind == LOOP else HUBER if kind == MARKER else PLAIN


def graph_document(
    graph: Graph,
    scans: Sequence[NodeScan],
    landmarks: Sequence[GraphLandmark],
    *,
    stamp_ns: int,
    map_from_odom: SE2,
    resolution_m: float,
    world_hash: str = "",
    epoch: int = 0,
    loops: int = 0,
    loops_rejected: int = 0,
) -> PoseGraph:
    """The document of a graph with the scans of its nodes, and its landmarks in their order."""
    nodes = tuple(
        GraphNode(
            id=index,
            stamp_ns=scan.stamp_ns,
            pose=_planar(graph.pose(index)),
            scan=GraphScan(
                points_mm=_encoded(scan.points_mm),
                misses_mm=_encoded(scan.misses_mm),
                sensor=_planar(scan.sensor),
            ),
        )
        for index, scan in zip(range(len(graph.poses)), scans, strict=True)
    )
    edges = graph.edges
    columns = zip(
        edges.kind.tolist(),
        edges.source.tolist(),
        edges.target.tolist(),
        edges.relative.tolist(),
        edges.covariance.tolist(),
        chi2(graph).tolist(),
        strict=True,
    )
    return PoseGraph(
        world_hash=world_hash,
        epoch=epoch,
        resolution_m=resolution_m,
        map_from_odom=_planar(map_from_odom),
        stamp_ns=stamp_ns,
        nodes=nodes,
        landmarks=tuple(landmarks),
        edges=tuple(
            GraphEdge(
                kind=KINDS[kind],
                source=source,
                target=target,
                relative=_planar(SE2(*relative)),
                covariance=(*covariance[0], *covariance[1][1:], covariance[2][2]),
                residual=max(residual, 0.0),
            )
            for kind, source, target, relative, covariance, residual in columns
        ),
        loops=loops,
        loops_rejected=loops_rejected,
    )


def graph_of(document: PoseGraph, source: str = "pose graph") -> LoadedGraph:
    """The graph of a document, exactly as it was. Nodes are numbered in their order.

    Raises ConfigError in one line with `source`, field and value where something contradicts.
    """
    graph, scans, index_of = Graph(), [], {}
    for index, node in enumerate(document.nodes):
        at = ("nodes", index)
        if node.id in index_of:
            raise _wrong(source, (*at, "id"), node.id, "must be the id of no other node")
        index_of[node.id] = graph.add_node(node.pose.se2())
        points_mm = _decoded(source, (*at, "scan", "points_mm"), node.scan.points_mm)
        misses_mm = _decoded(source, (*at, "scan", "misses_mm"), node.scan.misses_mm)
        scans.append(NodeScan(node.stamp_ns, points_mm, misses_mm, node.scan.sensor.se2()))
    for one in document.landmarks:
        graph.add_landmark(SE2(one.position_m[0], one.position_m[1], _heading_rad(one)))
    for index, edge in enumerate(document.edges):
        at = ("edges", index)
        kind = KINDS.index(edge.kind)
        if edge.source not in index_of:
            raise _wrong(source, (*at, "source"), edge.source, "must be the id of a node")
        if kind == MARKER and not 0 <= edge.target < len(document.landmarks):
            limit = "must be an index in `landmarks`"
            raise _wrong(source, (*at, "target"), edge.target, limit)
        if kind != MARKER and edge.target not in index_of:
            raise _wrong(source, (*at, "target"), edge.target, "must be the id of a node")
        xx, xy, xt, yy, yt, tt = edge.covariance
        try:
            graph.add_edge(
                kind,
                index_of[edge.source],
                edge.target if kind == MARKER else index_of[edge.target],
                edge.relative.se2(),
                np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]),
                robust_kernel(kind),
            )
        except ValueError as error:
            raise _wrong(
                source, (*at, "covariance"), edge.covariance, "must be positive definite"
            ) from error
    return LoadedGraph(graph, tuple(scans), document.landmarks)


def save_graph(path: Path, document: PoseGraph) -> None:
    """Write a document atomically. Raises ConfigError where it cannot be written."""
    try:
        write_file(path, document.model_dump_json().encode() + b"\n")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def load_graph(path: Path) -> PoseGraph:
    """A saved document, of which `graph_of` makes a graph.

    Raises ConfigError in one line with file, field and value, and what would be right.
    """
    try:
        if not path.is_file():
            # Opening a pipe would block forever.
            path.stat()
            raise ConfigError(f"{path}: must be a file")
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
    if len(data) > MAX_FILE_BYTES:
        raise ConfigError(f"{path}: must have at most {MAX_FILE_BYTES} bytes")
    try:
        document = PoseGraph.model_validate_json(data)
    except ValidationError as error:
        first = error.errors()[0]
        if first["type"] == "json_invalid":
            raise ConfigError(f"{path}: {_not_json(data)}") from error
        right = must(first["msg"])
        raise _wrong(str(path), first["loc"], first["input"], right) from error
    graph_of(document, str(path))
    return document


def recipe_markers(
    landmarks: Iterable[GraphLandmark], size_m: float, walls: Sequence[Wall] = ()
) -> dict[str, list[dict[str, Any]]]:
    """`markers` of a recipe, with `walls` for those that hang on none of the given walls: each of
    them a panel of its own. Of several markers of one id the first is taken: ids are unique in a
    recipe.

    `size_m`: side of the markers' black squares.
    """
    panels: list[dict[str, Any]] = []
    markers: dict[int, dict[str, Any]] = {}
    for one in landmarks:
        if one.instance > 0 or one.marker_id in markers:
            continue
        pose = SE2(one.position_m[0], one.position_m[1], _heading_rad(one))
        height_m = one.position_m[2]
        hung = _wall_of(pose, walls)
        if hung is None:
            name = f"marker_{one.marker_id}_panel"
            # Its left side is its face.
            centre = pose @ SE2(-_PANEL_THICKNESS_M / 2.0, 0.0, -math.pi / 2.0)
            panels.append(
                {
                    "name": name,
                    "length_m": _rounded(2.0 * size_m),
                    "thickness_m": _PANEL_THICKNESS_M,
                    "height_m": _rounded(height_m + size_m),
                    "x_m": _rounded(centre.x_m),
                    "y_m": _rounded(centre.y_m),
                    "yaw_rad": _rounded(centre.yaw_rad),
                }
            )
            hung = name, "left", 0.0
        marker = Marker(
            id=one.marker_id,
            dictionary=one.dictionary,
            size_m=size_m,
            wall=hung[0],
            side="left" if hung[1] == "left" else "right",
            offset_m=_rounded(hung[2]),
            height_m=_rounded(height_m),
        )
        markers[one.marker_id] = marker.model_dump(exclude={"quiet_zone_modules"})
    found = sorted(markers.items())
    return {"walls": panels, "markers": [marker for _, marker in found]}


def recipe_text(
    name: str, landmarks: Iterable[GraphLandmark], size_m: float, map_file: str = ""
) -> str:
    """A recipe (YAML) of a world of which only the markers are known, each on a panel of its own,
    and the map, if its file in the folder of maps is given: for `mazebot world check`, and for
    taking its lines to another recipe.
    """
    made = recipe_markers(landmarks, size_m)
    heights_m = [panel["height_m"] for panel in made["walls"]]
    lines = [f"name: {name}", "about: markers found by mapping"]
    lines += [f"wall_height_m: {max(heights_m, default=1.0)!r}"]
    lines += ["materials: {plain: {}}", "wall_materials: [plain]"]
    lines += [f"map: {map_file}"] if map_file else []
    for key, entries in made.items():
        # A mapping in JSON is one in YAML, too.
        written = [f"  - {json.dumps(entry)}" for entry in entries]
        lines += [f"{key}:", *written] if written else [f"{key}: []"]
    return "\n".join(lines) + "\n"


def _wall_of(pose: SE2, walls: Sequence[Wall]) -> tuple[str, str, float] | None:
    """Name, side and offset of the wall whose face a marker hangs on; None: on no wall."""
    best: tuple[float, str, str, float] | None = None
    for wall in walls:
        there = wall.map_from_wall().inverse() @ pose
        side = "left" if there.y_m > 0.0 else "right"
        facing_rad = math.pi / 2.0 if side == "left" else -math.pi / 2.0
        gap_m = abs(abs(there.y_m) - wall.thickness_m / 2.0)
        if (
            gap_m <= _MOST_GAP_M
            and abs(wrap_angle(there.yaw_rad - facing_rad)) <= _MOST_TURN_RAD
            and abs(there.x_m) <= wall.length_m / 2.0
            and (best is None or gap_m < best[0])
        ):
            best = gap_m, wall.name, side, there.x_m
    return None if best is None else best[1:]


def _heading_rad(landmark: GraphLandmark) -> float:
    if landmark.heading_rad is not None:
        return landmark.heading_rad
    normal = rotation_from_quaternion(*landmark.orientation_xyzw)[:, 2]
    return portable.atan2(float(normal[1]), float(normal[0]))


def _rounded(value: float) -> float:
    return round(value, 4) + 0.0


def _planar(pose: SE2) -> Planar:
    return Planar(x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad)


def _encoded(points_mm: Millimetres) -> str:
    return base64.b64encode(np.ascontiguousarray(points_mm, "<i4").tobytes()).decode()


def _decoded(source: str, at: tuple[str | int, ...], text: str) -> Millimetres:
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise _wrong(source, at, text, "must be base64") from error
    if len(data) % 8:
        raise _wrong(source, at, text, "must be pairs of int32: a multiple of 8 bytes")
    return np.frombuffer(data, "<i4").astype(np.int32).reshape(-1, 2)


def _not_json(data: bytes) -> str:
    try:
        json.loads(data)
    except UnicodeDecodeError:
        return "must be JSON in UTF-8"
    except json.JSONDecodeError as error:
        return f"must be valid JSON: error at line {error.lineno} column {error.colno}"
    except RecursionError:
        pass
    return "must be valid JSON"


def _wrong(source: str, at: tuple[str | int, ...], value: object, right: str) -> ConfigError:
    field = field_name(at)
    return ConfigError(f"{source}: {f'{field}: ' if field else ''}{shown_value(value)}: {right}")

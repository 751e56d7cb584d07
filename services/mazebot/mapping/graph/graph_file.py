"""A pose graph as a document and as a file, and its markers as a recipe's."""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from mazebot.common.config import ConfigError, must
from mazebot.common.files.reading import NotReadableError, read_limited, reason
from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, rotation_from_quaternion
from mazebot.common.messages.documents import Planar
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


def load_graph(path: Path) -> PoseGraph:
    """A saved document, of which `graph_of` makes a graph.

    Raises ConfigError in one line with file, field and value, and what would be right.
    """
    try:
        data = read_limited(path, MAX_FILE_BYTES)
    except (OSError, NotReadableError) as error:
        raise ConfigError(f"{path}: {reason(error)}") from error
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


def _heading_rad(landmark: GraphLandmark) -> float:
    if landmark.heading_rad is not None:
        return landmark.heading_rad
    normal = rotation_from_quaternion(*landmark.orientation_xyzw)[:, 2]
    return portable.atan2(float(normal[1]), float(normal[0]))


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

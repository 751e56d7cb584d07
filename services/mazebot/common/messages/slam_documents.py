"""What mapping and exploration tell: the pose graph with its scans and markers, and how far the
exploration has come.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mazebot.common.messages.documents import Document, Finite, Planar, Quaternion, Vector

NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Covariance3 = tuple[Finite, Finite, Finite, Finite, Finite, Finite]
"""Upper triangle of a symmetric (3, 3) by rows: xx, xy, x yaw, yy, y yaw, yaw yaw."""


class GraphScan(Document):
    """The returns of one scan in the frame of its node, whole millimetres."""

    points_mm: str = Field(
        description="base64 of little-endian int32 pairs x, y: where beams ended at an obstacle"
    )
    misses_mm: str = Field(
        "", description="the same for beams without a return: how far they saw free space"
    )
    sensor: Planar = Field(description="the lidar's pose in the frame of the node")


class GraphNode(Document):
    """A keyframe: a pose of the robot's base, and the scan taken there."""

    id: int = Field(ge=0)
    stamp_ns: int
    pose: Planar = Field(description="map_from_base, optimised")
    scan: GraphScan


class GraphLandmark(Document):
    """A marker, as it hangs in the map."""

    dictionary: str
    marker_id: int = Field(ge=0)
    instance: int = Field(0, ge=0, description="1 and up: another marker of the same id")
    position_m: Vector
    orientation_xyzw: Quaternion = Field(description="x to its right, y up, z out of its face")
    heading_rad: Finite | None = Field(
        None, description="of its normal, as exact as the poses of nodes; none: by its orientation"
    )
    std_m: NonNegative = Field(description="standard deviation of its position on the plane")
    sightings: int = Field(ge=0)


class GraphEdge(Document):
    """A measured pose of one node, or of a marker, in the frame of another node."""

    kind: Literal["odometry", "scan_match", "loop", "marker"]
    source: int = Field(description="id of a node")
    target: int = Field(description="id of a node; of a `marker`: index in `landmarks`")
    relative: Planar = Field(description="source_from_target as measured")
    covariance: Covariance3
    residual: NonNegative = Field(description="squared Mahalanobis distance after optimisation")


class PoseGraph(Document):
    """All that mapping knows: loaded again, it localises in the map or goes on with it."""

    world_hash: str = ""
    epoch: int = Field(0, description="the run of the simulation that it belongs to")
    resolution_m: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] = 0.05
    map_from_odom: Planar = Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0)
    stamp_ns: int = 0
    nodes: tuple[GraphNode, ...] = ()
    landmarks: tuple[GraphLandmark, ...] = ()
    edges: tuple[GraphEdge, ...] = ()
    loops: int = Field(0, ge=0, description="loops closed, by scan or by marker")
    loops_rejected: int = Field(0, ge=0, description="loop closures that were rejected")


class PlaceSetAside(Document):
    """A place in the map that could not be reached, or not be seen from where it should be."""

    x_m: Coordinate
    y_m: Coordinate
    tries: int = Field(1, ge=1, description="times that this was so")


class ExplorationStatus(Document):
    """How far the exploration has come, and what an explorer that is started again goes on with."""

    state: Literal["waiting", "exploring", "returning", "complete", "paused", "failed"]
    reason: str = Field("", description="one line: what it is waiting for, or why it ended")
    frontiers: int = Field(0, ge=0, description="groups of frontier cells in the map")
    reachable: int = Field(0, ge=0, description="those that the robot can reach")
    set_aside: int = Field(0, ge=0, description="those that are unreachable in the current map")
    left_out: int = Field(
        0, ge=0, description="those beyond `open_distance` or `max_distance`, which it leaves"
    )
    free_m2: NonNegative = Field(0.0, description="floor seen that the robot can reach")
    seen_share: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        0.0, description="of the reachable floor, seen or estimated beyond frontiers"
    )
    driven_m: NonNegative = 0.0
    goals: int = Field(0, ge=0, description="view points sent")
    goal_stamp_ns: int | None = Field(
        None,
        description="stamp of the goal that it has sent last: it replaces no goal of others and "
        "ends no pause; while the exploration is `paused`, navigation cancels it",
    )
    explored_s: Annotated[float, Field(ge=0.0, le=1e9)] = Field(
        0.0, description="time of exploring, without that in which the robot might not move"
    )
    places_set_aside: tuple[PlaceSetAside, ...] = Field(
        (), description="where it does not drive to, for now or for ever"
    )
    epoch: int = 0

"""The evaluation of a map that the robot has made."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.messages.documents.document import Document, Finite
from mazebot.common.messages.documents.error_statistics import ErrorStatistics, TrajectoryError


class CoverageStep(Document):
    """How much of the floor was mapped at one time of the exploration."""

    time_s: Finite = Field(description="simulation time, s")
    driven_m: Finite = Field(description="length of the true path until then, m")
    coverage_share: Finite = Field(description="of the reachable floor, 0 to 1")


class MarkersMapped(Document):
    """The markers in the pose graph, compared with those in the world of the same id."""

    found: int = Field(0, description="number of the world's markers in the graph")
    missing: int = Field(0, description="number of the world's markers that are not in the graph")
    false: int = Field(
        0, description="number of markers in the graph without one of their id within 1 m"
    )
    error_m: ErrorStatistics = Field(
        ErrorStatistics(), description="distance between a marker's mapped and true position, m"
    )
    error_rad: ErrorStatistics = Field(
        ErrorStatistics(), description="angle between its mapped and true heading, rad"
    )


class MapEvaluation(Document):
    """The map made so far, its pose graph and the estimated path, against the world. Its walls are
    the faces of everything solid and static on the lidar's level that can be seen, at 10 degrees
    or more, from floor that the robot can reach.
    """

    walls_found_share: Finite | None = Field(
        None,
        description="share of the walls, in points 0.05 m apart, with an occupied cell's centre "
        "within 0.10 m, 0 to 1; null: there is no map, or nothing to see",
    )
    walls_true_share: Finite | None = Field(
        None,
        description="share of the occupied cells with their centres within 0.10 m of something "
        "solid; null: there is none",
    )
    free_wrong_share: Finite | None = Field(
        None,
        description="share of the free cells with their centres inside something solid, deeper "
        "than half a cell; null: there is none",
    )
    coverage_share: Finite | None = Field(
        None,
        description="share of the reachable floor (where the robot's centre can be, with 0.24 m "
        "around it) that is free on the map; null: there is no map, or the floor has no end",
    )
    free_m2: Finite | None = Field(
        None, description="area of the free cells of the map; null: there is no map"
    )
    coverage: tuple[CoverageStep, ...] = Field(
        (), description="the coverage over time, a step for each 0.5 % more, oldest first"
    )
    milestones: tuple[CoverageStep, ...] = Field(
        (), description="when the coverage first reached 0.90, 0.95 and 0.99"
    )
    trajectory_error_m: TrajectoryError = Field(
        TrajectoryError(),
        description="absolute trajectory error (ATE): distance between estimated and true pose, m",
    )
    aligned_error_m: TrajectoryError = Field(
        TrajectoryError(),
        description="the same after the rotation and shift that fit the path best, m",
    )
    relative_error_m: TrajectoryError = Field(
        TrajectoryError(),
        description="relative pose error (RPE): of the way over 1 m driven, m",
    )
    relative_error_rad: TrajectoryError = Field(
        TrajectoryError(), description="the same of the heading, rad"
    )
    markers: MarkersMapped = Field(
        MarkersMapped(), description="the markers in the pose graph against the world's"
    )
    keyframes: int = Field(0, description="nodes of the pose graph")
    loops: int = Field(0, description="loops closed, as reported by mapping")
    loops_rejected: int = Field(0, description="loop candidates rejected, as reported by mapping")
    false_loops: int = Field(
        0,
        description="loop edges that are more than 0.3 m or 10 degrees off the true poses of their "
        "nodes",
    )
    driven_m: Finite | None = Field(
        None, description="length of the true path, m; null: no ground truth"
    )
    exploration: str = Field(
        "", description="the explorer's state, such as `complete`; empty: nothing explores"
    )
    exploration_reason: str = Field("", description="its reason, in words")
    explored_s: Finite | None = Field(
        None, description="simulation time at which it was complete or had failed, s"
    )

"""The evaluation of a run against the ground truth."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.messages.documents.document import Document, Finite
from mazebot.common.messages.documents.error_statistics import ErrorStatistics
from mazebot.common.messages.documents.map_evaluation import MapEvaluation
from mazebot.common.messages.documents.places import Planar
from mazebot.common.messages.documents.simulation import Contact


class LocalizationConsistency(Document):
    """Whether the estimated poses are as certain as their covariances say."""

    inside_95_percent: Finite | None = Field(
        None,
        description="share of the estimates, 0 to 1, whose 95 % ellipsoid of x, y and yaw "
        "(chi-square with 3 degrees of freedom: 7.815) holds the true pose: 0.95 is consistent, "
        "less is overconfident; null: there was no estimate",
    )
    estimates: int = Field(0, description="number of estimates that were compared")


class GoalReport(Document):
    """The evaluation of one goal against the ground truth. A task without a goal, such as `spin`,
    is evaluated by where it should have taken the robot from its true pose at the start.
    """

    name: str = Field(
        description="name of the location at this pose; `home`: the start pose; `goal`: any other; "
        "of a task without a goal in the map, its action"
    )
    reached: bool = Field(
        description="navigation reports success, and the robot's true pose, if known, is "
        "within 0.25 m and 0.25 rad of the goal, if there is one; with other tolerances of the "
        "goal checker than the default, within those and 0.19 m and 0.19 rad"
    )
    time_s: Finite = Field(description="simulation time from start to end, s")
    path_length_m: Finite = Field(description="length of the true path, m")
    shortest_path_m: Finite | None = Field(
        description="length of the shortest path for the robot's footprint, m; null: there is "
        "none, or the action is not `navigate_to_pose`"
    )
    goal_error_m: Finite | None = Field(
        description="distance from the true pose at the end to the goal, m; null: the recorder was "
        "restarted at that time, or there is no goal"
    )
    goal_error_rad: Finite | None = Field(description="angle between them, rad; null: likewise")
    recoveries: int = Field(description="number of recovery behaviors")
    error_code: int = Field(description="Nav2's error code; 0: success")
    error_msg: str = Field("", description="the error in words; empty: success")
    goal_stamp_ns: int = Field(
        0, description="stamp of the goal's message, ns of simulation time; 0 if sent as an action"
    )
    action: str = Field("navigate_to_pose", description="what the robot was asked to do")
    goal_id: str = Field("", description="id of a goal sent as an action; empty: by /goal_pose")
    localisation_error_m: Finite | None = Field(
        None,
        description="mean distance between estimated and true pose during the drive, m; null: "
        "there was no estimate",
    )
    contacts: int = Field(0, description="number of contacts during the drive")
    start_time_s: Finite | None = Field(
        None, description="simulation time of the start, s; null: not known"
    )
    goal: Planar | None = Field(
        None, description="target pose in `map`; null: the task specifies none"
    )
    given_up: bool = Field(
        False,
        description="the explorer replaced it by a better one on the way: neither reached nor "
        "missed, and not counted",
    )


class Evaluation(Document):
    """The evaluation of the run so far against the ground truth."""

    goals: tuple[GoalReport, ...] = Field((), description="the goals that have ended, oldest first")
    contacts: tuple[Contact, ...] = Field((), description="the first 1,000 contacts, oldest first")
    markers_seen: dict[str, int] = Field(
        default_factory=dict,
        description="number of images in which each marker of the world was detected, by its id",
    )
    localisation_error_m: ErrorStatistics = Field(
        ErrorStatistics(), description="distance between estimated and true pose, m"
    )
    localisation_error_rad: ErrorStatistics = Field(
        ErrorStatistics(), description="angle between estimated and true heading, rad"
    )
    localization: LocalizationConsistency = Field(
        LocalizationConsistency(),
        description="whether the estimated poses are as certain as their covariances say",
    )
    marker_error_m: ErrorStatistics = Field(
        ErrorStatistics(), description="distance between a marker's detected and true position, m"
    )
    odometry_drift_m: Finite | None = Field(
        None,
        description="distance between the pose by wheel odometry alone and the true one at the "
        "newest odometry message, m; null: no odometry or no ground truth",
    )
    mapping: MapEvaluation | None = Field(
        None, description="the map made by the robot; null: it makes none"
    )
    recording: str = Field("", description="folder of the run, as given by the recorder")

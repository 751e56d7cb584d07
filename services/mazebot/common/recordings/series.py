"""What a run looked like over time, as stored in its series.json: what its plots and plans show."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from mazebot.common.config import ConfigError, one_line
from mazebot.common.files.limits import MAX_DOCUMENT_BYTES
from mazebot.common.files.reading import NotReadableError, read_limited, reason
from mazebot.common.messages.documents import Document, Finite, Location, Planar
from mazebot.common.recordings.run_folder import SERIES

MOST_ROWS = 2000
"""Rows of a table at most, however long the run: if it is full, its resolution is halved."""
MOST_EVENTS = 1000

Column = tuple[Finite, ...]
Ring = tuple[tuple[Finite, Finite], ...]


class TrueRows(Document):
    """The robot's true motion; columns of equal length, oldest first."""

    time_s: Column = Field((), description="simulation time, s")
    x_m: Column = Field((), description="in `map`, m")
    y_m: Column = Field((), description="in `map`, m")
    yaw_rad: Column = Field((), description="in `map`, -pi to pi")
    speed_m_s: Column = Field((), description="forwards, of base_footprint, m/s")
    yaw_rate_rad_s: Column = Field((), description="counter-clockwise, rad/s")


class EstimatedRows(Document):
    """The estimated poses, and their errors at their own stamps; columns of equal length, oldest
    first. Of those left out, the error is smaller than that of the row kept.
    """

    time_s: Column = Field((), description="simulation time, s")
    x_m: Column = Field((), description="in `map`, m")
    y_m: Column = Field((), description="in `map`, m")
    yaw_rad: Column = Field((), description="in `map`, -pi to pi")
    error_m: Column = Field((), description="distance to the true pose, m")
    error_rad: Column = Field((), description="angle to the true heading, 0 to pi")


class CostRows(Document):
    """What a service cost, as reported on /diagnostics; columns of equal length, oldest first. Of
    those left out, the step time is shorter than that of the row kept.
    """

    time_s: Column = Field((), description="simulation time, s")
    step_time_p99_ms: Column = Field(
        (), description="wall time below which 99 % of the newest 1,000 steps stayed, ms"
    )
    missed_periods: Column = Field((), description="periods missed since the start of the service")


class PaceRows(Document):
    """How fast the simulation ran; columns of equal length, oldest first."""

    time_s: Column = Field((), description="simulation time, s")
    real_time_factor: Column = Field((), description="simulation time per wall time")


class SeriesGoal(Document):
    """A goal that has ended."""

    name: str = Field(description="as in summary.json")
    action: str = Field("navigate_to_pose", description="action of the goal")
    start_s: Finite | None = Field(None, description="simulation time, s")
    end_s: Finite | None = Field(None, description="simulation time, s")
    reached: bool = Field(description="as in summary.json")
    canceled: bool = Field(
        False, description="canceled, or preempted by another goal: neither reached nor missed"
    )
    pose: Planar | None = Field(None, description="in `map`; null: the task has none")


class SeriesMarker(Document):
    """A marker of the world."""

    name: str = Field(description="name of the entity")
    marker_id: int = Field(description="its number in its dictionary")
    x_m: Finite = Field(description="in `map`, m")
    y_m: Finite = Field(description="in `map`, m")
    yaw_rad: Finite = Field(description="direction that it faces, in `map`")
    images: int = Field(0, description="number of images in which it was detected")


class SeriesEvent(Document):
    """Something that happened at one time."""

    time_s: Finite = Field(description="simulation time, s")
    kind: Literal["goal", "contact", "marker", "service", "log", "run"] = Field(
        description="`goal`: started or ended; `contact`: of the robot; `marker`: first seen; "
        "`service`: its state has changed; `log`: a warning or an error; `run`: of the simulation"
    )
    level: Literal["info", "warning", "error"] = Field("info", description="severity")
    text: str = Field(description="in one line")
    x_m: Finite | None = Field(None, description="true position of the robot, in `map`, m")
    y_m: Finite | None = Field(None, description="likewise")


class RunSeries(Document):
    """A run over time, in tables of at most 2,000 rows each, and the plan of its world."""

    format: Literal[1] = Field(1, description="version of this document")
    world: str = Field(description="name of the world")
    world_hash: str = Field(description="hash of the world; equal for equal worlds")
    slam: bool = Field(False, description="whether the robot made the map")
    sim_time_s: Finite = Field(0.0, description="simulation time up to which it goes, s")
    truth: TrueRows = Field(TrueRows(), description="the true motion")
    estimate: EstimatedRows = Field(EstimatedRows(), description="the estimated poses")
    costs: dict[str, CostRows] = Field(
        default_factory=dict, description="costs of each service, by its name"
    )
    pace: PaceRows = Field(PaceRows(), description="the simulation's real-time factor")
    start: Planar = Field(description="the robot's start pose, in `map`")
    locations: tuple[Location, ...] = Field((), description="the world's named poses, in `map`")
    goals: tuple[SeriesGoal, ...] = Field((), description="the goals that ended, oldest first")
    markers: tuple[SeriesMarker, ...] = Field((), description="the markers of the world")
    events: tuple[SeriesEvent, ...] = Field(
        (), max_length=MOST_EVENTS, description="what happened, the newest 1,000, oldest first"
    )
    events_dropped: Annotated[int, Field(ge=0)] = Field(
        0, description="number of older events that are not listed"
    )
    solid: tuple[Ring, ...] = Field(
        (),
        description="closed outlines, x and y in `map`, m, of all that is solid and static on the "
        "robot's level; an area is solid if it is inside an odd number of them",
    )


def read_series(folder: Path) -> RunSeries | None:
    """The series of a run; None if it has none.

    Raises ConfigError with one line where the file cannot be read, or is none.
    """
    path = folder / SERIES
    try:
        return RunSeries.model_validate_json(read_limited(path, MAX_DOCUMENT_BYTES))
    except FileNotFoundError:
        return None
    except (OSError, NotReadableError) as error:
        raise ConfigError(f"{path}: {reason(error)}") from error
    except ValidationError as error:
        raise ConfigError(f"{path}: {one_line(error):.300}") from error

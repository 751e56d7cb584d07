"""The summary of a run, as stored in its summary.json."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import Field
from pydantic_core import to_json

from services.common.node.documents import (
    Contact,
    Document,
    ErrorStatistics,
    Evaluation,
    Finite,
    GoalReport,
    LocalizationHonesty,
    MapEvaluation,
    SimulationStats,
    World,
)
from services.common.node.node import TopicCounts
from services.recorder.judging.wall_time import WallTime

RejectedElsewhere = Mapping[tuple[str, str, str], int]
"""Messages that other services rejected: by service, topic and reason."""


class Pauses(Document):
    """How often and for how long the simulation was paused."""

    count: int = Field(description="times that it was paused")
    wall_time_s: Finite = Field(description="wall time of all pauses together, s")


class Contacts(Document):
    """Contacts of the robot, except with the floor."""

    count: int = Field(description="number of contacts in the run")
    list: tuple[Contact, ...] = Field(description="the first 1,000 of them, oldest first")


class TopicMessages(Document):
    """The messages on one topic."""

    sent: int | None = Field(
        description="by their publishers, since the first message received by the recorder; null: "
        "the recorder does not subscribe to this topic"
    )
    received: int | None = Field(description="of these, by the recorder; null as `sent`")
    lost: int | None = Field(description="not received by the recorder; null as `sent`")
    recorded: int | None = Field(
        None, description="of these, in `run.mcap`; null: there is none, or as `sent`"
    )
    rejected: int = Field(description="by any service")
    rejected_by: dict[str, int] = Field(description="the same by `service: reason`")


class RunSummary(Document):
    """Everything about a run that scripts may need. Unmeasured values are null, never 0."""

    world: str = Field(description="name of the world")
    world_hash: str = Field(description="hash of the world; equal for equal worlds")
    seed: int = Field(description="seed of all random streams")
    epoch: int | None = Field(
        description="number of simulation starts, including this run's; null: never received"
    )
    rebuilds: int = Field(
        description="times that physics was rebuilt while time went on, because a body's "
        "state was not physical"
    )
    state_hash: str | None = Field(
        description="hash of every state of the simulation so far; null: never received"
    )
    image_hash: str | None = Field(
        description="hash of every camera image so far; null: there is no camera"
    )
    sim_time_s: Finite | None = Field(
        description="simulation time at the end of the run, s; null: no clock was received"
    )
    wall_time_s: Finite | None = Field(
        description="wall time between the first and the last clock message received, without "
        "pauses, s; null: fewer than two"
    )
    real_time_factor: Finite | None = Field(
        description="simulation time between these messages per wall time; null as `wall_time_s`"
    )
    pauses: Pauses = Field(description="pauses of the simulation")
    renderer: str | None = Field(
        description="renderer of the camera images; `none`: the camera is off; null: never received"
    )
    goals: tuple[GoalReport, ...] = Field(description="the goals that have ended, oldest first")
    contacts: Contacts = Field(description="contacts of the robot, except with the floor")
    markers_seen: dict[str, int] = Field(
        description="number of images in which each marker of the world was detected, by its id"
    )
    localisation_error_m: ErrorStatistics = Field(
        description="distance between estimated and true pose, m"
    )
    localisation_error_rad: ErrorStatistics = Field(
        description="angle between estimated and true heading, rad"
    )
    localization: LocalizationHonesty = Field(
        description="whether the estimated poses are as certain as they say"
    )
    marker_error_m: ErrorStatistics = Field(
        description="distance between a marker's detected and true position, m"
    )
    odometry_drift_m: Finite | None = Field(
        description="distance between the pose by wheel odometry alone and the true one at the "
        "end, m; null: no odometry or no ground truth"
    )
    mapping: MapEvaluation | None = Field(
        description="the map that the robot has made, against the world; null: it makes none"
    )
    recording: str = Field(description="folder of the run, as a path of the recorder")
    distance_m: Finite | None = Field(
        description="length of the true path, m; null: no ground truth"
    )
    goals_sent: int = Field(description="number of goals sent, actions included")
    goals_reached: int = Field(description="number of goals with `reached`")
    spl: Finite | None = Field(
        description="success weighted by path length (arXiv:1807.06757), 0 to 1: the mean of "
        "reached x shortest / max(driven, shortest) over the goals of `navigate_to_pose`; null: no "
        "such goal has ended"
    )
    messages: dict[str, TopicMessages] = Field(description="messages by topic")
    versions: dict[str, str] = Field(description="versions of Mazebot, Python and its libraries")


def build_summary(
    *,
    world: World,
    seed: int,
    stats: SimulationStats | None,
    rebuilds: int,
    sim_time_s: float | None,
    wall_time: WallTime,
    now_s: float,
    evaluation: Evaluation,
    totals: Mapping[str, Any],
    counts: Mapping[str, TopicCounts],
    recorded: Mapping[str, int],
    rejected_elsewhere: RejectedElsewhere,
    versions: Mapping[str, str],
) -> RunSummary:
    """The summary of a run so far; `now_s` is the wall time up to which its pauses are counted."""
    judged = dict(evaluation)
    contacts = judged.pop("contacts")
    totals = dict(totals)
    count = totals.pop("contacts")
    return RunSummary(
        world=world.name,
        world_hash=world.hash,
        seed=seed,
        epoch=stats.epoch if stats else None,
        rebuilds=rebuilds,
        state_hash=(stats.state_hash or None) if stats else None,
        image_hash=(stats.image_hash or None) if stats else None,
        sim_time_s=sim_time_s,
        wall_time_s=wall_time.wall_time_s,
        real_time_factor=wall_time.real_time_factor,
        pauses=Pauses(count=wall_time.pauses, wall_time_s=wall_time.paused_s(now_s)),
        renderer=(stats.renderer or None) if stats else None,
        contacts=Contacts(count=count, list=contacts),
        **judged,
        **totals,
        messages=_messages(counts, recorded, rejected_elsewhere),
        versions=dict(versions),
    )


def summary_text(summary: RunSummary) -> Iterator[bytes]:
    """The text of summary.json, as UTF-8, in pieces: as one string it would grow with each goal,
    every few seconds.
    """
    yield from _pieces(dict(summary), b"\n")
    yield b"\n"


def _pieces(value: Any, line: bytes) -> Iterator[bytes]:
    """JSON of a value, in lines that start like this one."""
    if isinstance(value, Contacts):
        value = dict(value)
    if not isinstance(value, dict | list | tuple) or not value:
        yield to_json(value, indent=2, inf_nan_mode="null").replace(b"\n", line)
        return
    named = isinstance(value, dict)
    opening, closing = (b"{", b"}") if named else (b"[", b"]")
    for index, entry in enumerate(value):
        yield (b"," if index else opening) + line + b"  "
        if named:
            yield to_json(entry) + b": "
        yield from _pieces(value[entry] if named else entry, line + b"  ")
    yield line + closing


def _messages(
    counts: Mapping[str, TopicCounts], recorded: Mapping[str, int], elsewhere: RejectedElsewhere
) -> dict[str, TopicMessages]:
    rejected: dict[str, dict[str, int]] = {}
    for topic, seen in counts.items():
        for reason, count in seen.rejected.items():
            rejected.setdefault(topic, {})[f"recorder: {reason}"] = count
    for (service, topic, reason), count in elsewhere.items():
        rejected.setdefault(topic, {})[f"{service}: {reason}"] = count
    return {
        topic: TopicMessages(
            sent=counts[topic].sent if topic in counts else None,
            received=counts[topic].received if topic in counts else None,
            lost=counts[topic].lost if topic in counts else None,
            recorded=recorded.get(topic, 0) if recorded and topic in counts else None,
            rejected=sum(rejected.get(topic, {}).values()),
            rejected_by=dict(sorted(rejected.get(topic, {}).items())),
        )
        for topic in dict.fromkeys((*counts, *rejected))
    }

"""The summary of a run, as stored in its summary.json."""

from __future__ import annotations

from pydantic import Field, JsonValue

from mazebot.common.messages.documents import (
    Contact,
    Document,
    ErrorStatistics,
    Finite,
    GoalReport,
    LocalizationConsistency,
    MapEvaluation,
)


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
        description="by their publishers, since the first message received by the recorder or, of "
        "a later run of the same recorder, since the run began; null: the recorder does not "
        "subscribe to this topic"
    )
    received: int | None = Field(
        description="of these, by the recorder, with the latched ones of before the run; null as "
        "`sent`"
    )
    lost: int | None = Field(description="not received by the recorder; null as `sent`")
    recorded: int | None = Field(
        None,
        description="of these, in `run.mcap`: fewer, if the disk had no room; null: there is to "
        "be no such file, or as `sent`",
    )
    rejected: int = Field(description="by any service")
    rejected_by: dict[str, int] = Field(description="the same by `service: reason`")


class Hardware(Document):
    """The computer on which the recorder ran."""

    processor: str = Field(description="model name of the processor")
    cores: int | None = Field(description="number of logical cores; null: not known")
    memory_mib: int | None = Field(description="main memory, MiB; null: not known")
    system: str = Field(description="operating system and its version")


class ChangedSetting(Document):
    """A setting that is not the default."""

    value: JsonValue = Field(description="its value in this run")
    default: JsonValue = Field(description="its default")


class RunSummary(Document):
    """Everything about a run that scripts may need. Unmeasured values are null, never 0."""

    world: str = Field(description="name of the world")
    world_hash: str = Field(description="hash of the world; equal for equal worlds")
    ended: bool = Field(
        True,
        description="whether the run has ended, and this was written at its end; false: it goes "
        "on, or its recorder was killed: then all but `messages` and `sim_time_s`, which a repair "
        "takes from its files, is as it was up to 5 s before",
    )
    seed: int = Field(description="seed of all random streams")
    epoch: int | None = Field(
        description="number of simulation starts, including this run's; null: never received"
    )
    rebuilds: int = Field(
        description="number of times that physics was rebuilt without a reset, because a "
        "body's state was invalid"
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
    localization: LocalizationConsistency = Field(
        description="consistency of the estimated poses with their covariances"
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
    goals_sent: int = Field(
        description="number of goals sent, actions included, without those given up"
    )
    goals_given_up: int = Field(
        0, description="number of goals that the explorer replaced by better ones on the way"
    )
    goals_reached: int = Field(description="number of goals with `reached`")
    spl: Finite | None = Field(
        description="success weighted by path length (arXiv:1807.06757), 0 to 1: the mean of "
        "reached x shortest / max(driven, shortest) over the goals of `navigate_to_pose`, without "
        "those given up; null: no such goal has ended"
    )
    messages: dict[str, TopicMessages] = Field(description="messages by topic")
    versions: dict[str, str] = Field(description="versions of Mazebot, Python and its libraries")
    hardware: Hardware | None = Field(
        None, description="the computer of the recorder; null: not recorded"
    )
    changed_settings: dict[str, ChangedSetting] = Field(
        default_factory=dict,
        description="the settings that are not the defaults, by `service.field`; the recorder's "
        "own and the seed are left out",
    )

"""The simulation's state, contacts and control."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from mazebot.common.messages.documents.document import (
    Document,
    Finite,
    Positive,
    Quaternion,
    Vector,
)
from mazebot.common.messages.documents.places import Planar
from mazebot.common.speeds import MIN_SPEED

Natural = Annotated[int, Field(ge=0, lt=2**63)]
"""A seed, or what is counted: numpy takes no other for the state of a random stream."""


Steps = Annotated[int, Field(ge=1, le=10_000_000)]
"""Steps to advance by."""
SimulationTime = Annotated[float, Field(ge=0.0, le=1e9, allow_inf_nan=False)]
"""A time, or how long something lasts."""
PositiveTime = Annotated[float, Field(gt=0.0, le=1e9, allow_inf_nan=False)]


class Contact(Document):
    """A contact of the robot with anything but the floor has begun."""

    time_s: Finite = Field(description="simulation time, s")
    robot_link: str = Field(description="link of the robot")
    body: str = Field(description="name of the wall, body or entity it collided with")
    position_m: tuple[Finite, Finite, Finite] = Field(description="x, y, z in `map`, m")
    impulse_n_s: Finite = Field(description="impulse of the first step, N s")


def _as_fast_as_possible_or_a_factor(speed: float) -> float:
    if 0.0 < speed < MIN_SPEED:
        raise ValueError(f"must be 0 (as fast as possible) or at least {MIN_SPEED:g}")
    return speed


Speed = Annotated[
    float,
    Field(ge=0.0, le=1000.0, allow_inf_nan=False),
    AfterValidator(_as_fast_as_possible_or_a_factor),
]
"""Simulated seconds a second; 0: as fast as possible."""


class SimulationControl(Document):
    """Requests a pause, resume or reset of the simulation. Fields that are None change nothing.

    Of several fields in one request, `reset` is done first, then the rest. The reply to `step` and
    `run_until_s` is sent when they are done; both leave the simulation paused.
    """

    pause: bool | None = None
    step: Steps | None = Field(None, description="advance by this number of steps")
    run_until_s: SimulationTime | None = Field(None, description="advance to this simulation time")
    reset: Literal["all", "fresh", "time"] | None = Field(
        None,
        description="`all`: everything returns to its initial state, at time 0, and what was "
        "spawned to its first pose; `fresh`: the same, and what was spawned is gone; `time`: only "
        "the clock restarts",
    )
    seed: Natural | None = Field(
        None, description="new seed of the random streams; needs `reset: all` or `fresh`"
    )
    speed: Speed | None = Field(
        None, description="simulated seconds a second; 0: as fast as possible"
    )
    robot_pose: Planar | None = Field(
        None,
        description="moves the robot to this pose of base_footprint, at rest, as if it had been "
        "carried there: neither odometry nor navigation is notified",
    )


class SimulationStats(Document):
    """What the simulation has done so far. Holds nothing read from a wall clock."""

    world_hash: str
    sim_time_s: Finite
    iterations: Natural
    step_size_s: Positive
    paused: bool = False
    speed: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        1.0, description="requested simulated seconds a second; 0: as fast as possible"
    )
    seed: Natural = Field(0, description="seed of the random streams")
    epoch: Natural = Field(
        0, description="counts the starts: load, reset, and every rebuild of the world"
    )
    resumed_from: Natural | None = Field(
        None,
        description="epoch in which the run began that a simulator started again goes on with: "
        "time and poses go on; null: the run began with this epoch",
    )
    entities: int = Field(0, description="number of entities in the world")
    renderer: str = Field(
        description="`cpu_rasterizer`, `moderngl (...)`, `tiny_renderer`, or `none`"
    )
    state_hash: str = Field(
        description="chained hash of the states of robot and bodies after every step of this epoch"
    )
    image_hash: str = Field("", description="chained hash of the camera images of this epoch")
    watchdog_stops: int = Field(0, description="times the velocity watchdog stopped the robot")
    emergency_stop: str = Field(
        "", description="why the robot is held at rest until it is cleared; empty: it is not"
    )

    @property
    def run_epoch(self) -> int:
        """The epoch in which the run began: another one is another run."""
        return self.epoch if self.resumed_from is None else self.resumed_from


class BodyCheckpoint(Document):
    """A body that moves, as PyBullet has it, in `map`."""

    name: str
    position_m: Vector = Field(description="of its centre of mass")
    orientation_xyzw: Quaternion = Field(description="of its principal axes")
    velocity_m_s: Vector
    angular_velocity_rad_s: Vector
    travelled_m: Finite = Field(0.0, description="on its scripted path")


class SimulationCheckpoint(Document):
    """What a simulator that is started again needs to go on where the one before was."""

    world_hash: str
    epoch: Natural
    run_epoch: Natural = Field(description="the epoch in which the run began")
    seed: Natural
    iterations: Natural = Field(description="steps done")
    paused: bool
    speed: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    robot: BodyCheckpoint
    wheel_angles_rad: tuple[Finite, Finite] = Field(description="left, right")
    odom_from_base: Planar
    odom_covariance: tuple[Finite, Finite, Finite, Finite, Finite, Finite] = Field(
        description="x x, x y, x yaw, y y, y yaw, yaw yaw"
    )
    movers: tuple[BodyCheckpoint, ...] = ()
    watchdog_stops: int = 0
    emergency_stop: str = Field("", description="see SimulationStats")


class EmergencyStop(Document):
    """Requests that the robot stop and be held at rest, or that it may move again."""

    stop: bool
    reason: str = Field("", max_length=200, description="of a stop: why, for those who look")


class SimulationControlReply(Document):
    """The state of the simulation after a request."""

    error: str = Field("", description="one line; empty: done")
    stats: SimulationStats | None = Field(None, description="None before a world is loaded")

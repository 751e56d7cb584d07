"""Which router a service connects to, and the pace of its run."""

from __future__ import annotations

import re
from typing import Literal

from pydantic import Field, field_validator

from mazebot.common.config import OptionalPath, ServiceConfig
from mazebot.common.messages.keys import Keys
from mazebot.common.speeds import MAX_SPEED, MIN_SPEED

PACES = {"real_time": 1.0, "fast": 0.0, "lockstep": 0.0}
"""Simulated seconds a second; 0: as fast as possible."""


class BusConfig(ServiceConfig):
    """The connection to the other services."""

    connect: str = Field("tcp/127.0.0.1:7447", description="Zenoh endpoint of the router")
    key_file: OptionalPath = Field(
        None,
        description="key with which this process signs in at the router, made by `mazebot keys`; "
        "without one, tools use the operator's key of the stack of this user on that port, if it "
        "has keys, or that in ./keys, where containers leave it",
    )
    wire: Literal["rmw_zenoh", "plain"] = Field(
        "rmw_zenoh",
        description="rmw_zenoh: nodes and tools of ROS 2 (Jazzy and newer) that use rmw_zenoh see "
        "all topics; plain: keys are the names alone, as zenoh-bridge-ros2dds has them",
    )
    domain_id: int = Field(
        0,
        ge=0,
        le=232,
        description="ROS domain of the rmw_zenoh wire; without it ROS_DOMAIN_ID holds",
    )
    distro: Literal["jazzy", "kilted", "lyrical"] = Field(
        "jazzy",
        description="distribution of ROS 2 whose services and actions are spoken: their types "
        "differ; those of topics do not",
    )
    prefix: str = Field(
        "",
        description="namespace of every topic, such as bot1, to run several stacks on one router",
    )
    pace: str = Field(
        "real_time",
        description="real_time; simulated seconds a second, as 0.5; fast: as fast as possible; "
        "lockstep: services step in turn, and a run is repeatable; the same for all services",
    )
    lockstep_timeout_s: float = Field(
        10.0, gt=0.0, le=15.0, description="wall time within which a service must end its turn"
    )

    @field_validator("prefix")
    @classmethod
    def _is_a_namespace(cls, prefix: str) -> str:
        names = [name for name in prefix.split("/") if name]
        if not all(re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) for name in names):
            raise ValueError(
                "must be a ROS namespace: letters, digits and _, such as bot1 or lab/bot1"
            )
        return "".join(f"{name}/" for name in names)

    @field_validator("pace")
    @classmethod
    def _is_a_pace(cls, pace: str) -> str:
        if pace in PACES:
            return pace
        try:
            speed = float(pace)
        except ValueError:
            speed = -1.0
        if not MIN_SPEED <= speed <= MAX_SPEED:
            raise ValueError(
                f"must be {', '.join(PACES)}, or a factor from {MIN_SPEED:g} to {MAX_SPEED:g}"
            )
        return pace

    @property
    def keys(self) -> Keys:
        """The keys of the stack."""
        return Keys(self.wire, self.domain_id, self.prefix, self.distro)

    @property
    def lockstep(self) -> bool:
        """Whether the services run in lockstep."""
        return self.pace == "lockstep"

    @property
    def speed(self) -> float:
        """Initial speed in simulated seconds a second; 0: as fast as possible."""
        return PACES[self.pace] if self.pace in PACES else float(self.pace)

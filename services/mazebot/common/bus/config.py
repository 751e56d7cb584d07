"""Which router a service connects to, and the pace of its run."""

from __future__ import annotations

from pydantic import Field, field_validator

from mazebot.common.config import ServiceConfig
from mazebot.common.speeds import MAX_SPEED, MIN_SPEED

PACES = {"real_time": 1.0, "fast": 0.0, "lockstep": 0.0}
"""Simulated seconds a second; 0: as fast as possible."""


class BusConfig(ServiceConfig):
    """The connection to the other services."""

    connect: str = Field("tcp/127.0.0.1:7447", description="Zenoh endpoint of the router")
    prefix: str = Field("", description="prefix of every key, to run several stacks on one router")
    pace: str = Field(
        "real_time",
        description="real_time; simulated seconds a second, as 0.5; fast: as fast as possible; "
        "lockstep: services step in turn, and a run is repeatable; the same for all services",
    )
    lockstep_timeout_s: float = Field(
        10.0, gt=0.0, le=15.0, description="wall time within which a service must end its turn"
    )

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
    def lockstep(self) -> bool:
        """Whether the services run in lockstep."""
        return self.pace == "lockstep"

    @property
    def speed(self) -> float:
        """Initial speed in simulated seconds a second; 0: as fast as possible."""
        return PACES[self.pace] if self.pace in PACES else float(self.pace)

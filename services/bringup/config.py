"""What `bringup` is told."""

from __future__ import annotations

from pydantic import Field

from services.common.config import ServiceConfig
from services.common.documents import Finite


class BringupConfig(ServiceConfig):
    """Which world to ask for, and where to drive in it."""

    world_name: str = Field("sim_house_enhanced", description="the world to ask for")
    use_aruco: bool = Field(True, description="keep the world's ArUco markers")
    tour: tuple[str, ...] = Field(
        ("location1", "location2", "location3", "location4", "home"),
        description="names of locations to drive to, in order; `home` is the robot's start",
    )
    goal: tuple[Finite, Finite, Finite] | None = Field(
        None, description="x (m), y (m), yaw (rad) in the map frame: one goal in place of the tour"
    )
    bringup_timeout_s: float = Field(
        60.0, gt=0, description="simulation time after which a stack that is not active has failed"
    )
    resend_after_s: float = Field(
        2.0, gt=0, description="simulation time without a sign of the goal; then it is sent again"
    )
    only_ask: bool = Field(
        False, description="end with the answer to the request: an error where another world runs"
    )

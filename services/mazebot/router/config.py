"""The configuration of `router`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from mazebot.common.config import ServiceConfig


class RouterConfig(ServiceConfig):
    """The router's endpoint, and its timeout."""

    listen: str = Field(
        "tcp/127.0.0.1:7447", pattern=r"^\w+/.+:\d+$", description="Zenoh endpoint to listen on"
    )
    keys_dir: Path | None = Field(
        None,
        description="folder of keys, see `mazebot keys`: whoever has none of them is refused, and "
        "each may do what its role needs; keys that are missing are made. None: everyone may "
        "connect and do everything",
    )
    handout_dir: Path | None = Field(
        None,
        description="folder in which each service has one of its name, with its key in own.key, as "
        "in containers; needs keys_dir",
    )
    ground_truth_for: Literal["operator", "grader"] = Field(
        "operator",
        description="with keys, who may read the ground truth: operator: everyone; grader: of "
        "people the grader alone",
    )
    silence_s: float = Field(
        6.0,
        ge=1.0,
        le=3600.0,
        description="wall time without a response after which the router exits, to be restarted",
    )

"""The configuration of `router`."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.config import ServiceConfig


class RouterConfig(ServiceConfig):
    """The router's endpoint, and its timeout."""

    listen: str = Field(
        "tcp/127.0.0.1:7447", pattern=r"^\w+/.+:\d+$", description="Zenoh endpoint to listen on"
    )
    silence_s: float = Field(
        6.0,
        ge=1.0,
        le=3600.0,
        description="wall time without a response after which the router exits, to be restarted",
    )

"""What `router` is told."""

from __future__ import annotations

from pydantic import Field

from services.common.config import ServiceConfig


class RouterConfig(ServiceConfig):
    """Where the router listens, and how long it may be silent."""

    listen: str = Field(
        "tcp/127.0.0.1:7447", pattern=r"^\w+/.+:\d+$", description="Zenoh endpoint to listen on"
    )
    silence_s: float = Field(
        6.0,
        ge=1.0,
        le=3600.0,
        description="wall time without an answer after which the router is ended, to be started "
        "anew",
    )

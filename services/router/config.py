"""What `router` is told."""

from __future__ import annotations

from pydantic import Field

from services.common.config import ServiceConfig


class RouterConfig(ServiceConfig):
    """Where the router listens."""

    listen: str = Field(
        "tcp/127.0.0.1:7447", pattern=r"^\w+/.+:\d+$", description="Zenoh endpoint to listen on"
    )

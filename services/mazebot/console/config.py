"""The configuration of `console`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator

from mazebot.common.config import Names, ServiceConfig


class ConsoleConfig(ServiceConfig):
    """Where the pages are served, what they show, and the limits of a client."""

    bind: str = Field("127.0.0.1", min_length=1, description="address on which the pages are")
    port: int = Field(8080, ge=0, le=65535, description="port of the pages; 0: any free one")
    login: Literal["auto", "always", "never"] = Field(
        "auto",
        description="whether those who open the pages must log in, with the token in the address "
        "that is printed: auto: where `bind` is more than this machine",
    )
    recordings_dir: Path = Field(
        Path("recordings"), description="folder whose runs are shown, one subfolder each"
    )
    hosts: Names = Field(
        (),
        description="names, with commas, by which browsers may reach the pages, besides localhost "
        "and the address in `bind`",
    )
    live: bool = Field(True, description="connect to a running stack, and show and drive it")
    live_data_port: int = Field(
        9876,
        ge=0,
        le=65535,
        description="port, on the host of the pages, from which the recorder shows a run while it "
        "is recorded; 0: such a run is shown from its files",
    )
    max_body_kib: int = Field(64, ge=1, le=65536, description="largest request body, KiB")
    max_connections: int = Field(512, ge=8, le=10_000, description="connections at the same time")
    request_timeout_s: float = Field(
        10.0, ge=0.1, le=3600.0, description="wall time within which a client must send its request"
    )

    @field_validator("hosts")
    @classmethod
    def _names_only(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            with_port = ":" in name and not name.startswith("[")
            if "*" in name or "/" in name or with_port:
                raise ValueError("must be host names without scheme, port and *")
        return value

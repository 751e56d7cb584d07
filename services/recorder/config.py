"""Configuration of the recorder."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from services.common.config import ServiceConfig


class RecorderConfig(ServiceConfig):
    """Where runs are kept, and whether they are shown live."""

    record: bool = Field(
        True,
        description="write run.rrd and run.mcap; summary.json and config.yaml are always written",
    )
    messages: bool = Field(True, description="write run.mcap, unless `record` is off")
    pictures: Literal["jpeg", "raw"] = Field(
        "jpeg",
        description="camera images in run.mcap: compressed, a twentieth of the size, or as they "
        "are, for replaying bit by bit",
    )
    segment_mib: int = Field(
        256, ge=1, le=1024 * 1024, description="size of run.mcap at which run_2.mcap follows it"
    )
    recordings_dir: Path = Field(
        Path("recordings"), description="folder in which each run gets a subfolder"
    )
    out_dir: Path | None = Field(
        None, description="folder of the run, instead of a new one in recordings_dir"
    )
    repair: bool = Field(True, description="at start, repair recordings left by a killed recorder")
    compact_timeout_s: float = Field(
        1.2,
        ge=0,
        description="wall time at a run's end to compact run.rrd so that it opens quickly; 0: none",
    )
    live: bool = Field(False, description="show the run live in a browser")
    bind: str = Field("0.0.0.0", description="address on which the live view listens")
    web_port: int = Field(9090, ge=1, le=65535, description="port of the live view's web page")
    grpc_port: int = Field(
        9876, ge=1, le=65535, description="gRPC port from which the page reads the recording"
    )
    live_memory_mib: int = Field(
        256, ge=16, description="memory for data sent to late viewers; the oldest is dropped first"
    )
    jpeg_quality: int = Field(75, ge=1, le=100, description="of the recorded camera images")
    min_free_mib: int = Field(
        64, ge=0, description="free disk space below which the recording stops until there is more"
    )

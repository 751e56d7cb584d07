"""Configuration of the recorder."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from services.common.config import ServiceConfig


class RecorderConfig(ServiceConfig):
    """Where runs are kept, and whether they are shown live."""

    record: bool = Field(
        True, description="write run.rrd; summary.json and config.yaml are always written"
    )
    recordings_dir: Path = Field(
        Path("recordings"), description="folder in which each run gets a subfolder"
    )
    out_dir: Path | None = Field(
        None, description="folder of the run, instead of a new one in recordings_dir"
    )
    repair: bool = Field(True, description="at start, repair recordings left by a killed recorder")
    keep_days: float | None = Field(
        None,
        gt=0,
        description="at start and at a run's end, delete runs that began longer ago; none: keep "
        "all. Runs with the tag `keep`, and those that have not ended, always stay",
    )
    keep_gib: float | None = Field(
        None,
        gt=0,
        description="likewise, delete the oldest runs until all together take no more, in GiB",
    )
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
        64, ge=0, description="free disk space below which run.rrd is closed until there is more"
    )

"""Configuration of the recorder."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from mazebot.common.config import OptionalPath, ServiceConfig

LayoutName = Literal["overview", "drive", "perception", "performance", "mapping"]
"""The layouts of the viewer, each for one purpose."""


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
    out_dir: OptionalPath = Field(
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
    layout: LayoutName = Field(
        "overview", description="what the viewer shows first, live and of run.rrd"
    )
    bind: str = Field("0.0.0.0", description="address on which the live view listens")
    web_port: int = Field(9090, ge=1, le=65535, description="port of the live view's web page")
    grpc_port: int = Field(
        9876, ge=1, le=65535, description="gRPC port from which the page reads the recording"
    )
    live_memory_mib: int = Field(
        256, ge=16, description="memory for data sent to late viewers; the oldest is dropped first"
    )
    foxglove: bool = Field(False, description="serve the run live to Foxglove, by its websocket")
    foxglove_bind: str = Field("127.0.0.1", description="address on which that server listens")
    foxglove_port: int = Field(8765, ge=0, le=65535, description="its port; 0: any free one")
    foxglove_key_file: OptionalPath = Field(
        None,
        description="where the router asks for keys: the one with which the app's orders are sent, "
        "such as the operator's; none: the recorder's own, with which it may send none",
    )
    jpeg_quality: int = Field(75, ge=1, le=100, description="of the recorded camera images")
    video: bool = Field(
        True,
        description="when a run has ended, make a video of its camera images: a fifth of the size",
    )
    min_free_mib: int = Field(
        64, ge=0, description="free disk space below which the recording stops until there is more"
    )

    @property
    def keeps_messages(self) -> bool:
        """Whether messages are recorded or shown, and not only judged."""
        return self.record or self.live or self.foxglove

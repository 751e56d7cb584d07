"""The spawner's configuration."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.config import ServiceConfig


class SpawnerConfig(ServiceConfig):
    """Drawing and placement of markers."""

    panel_gap_m: float = Field(
        0.002,
        gt=0.0,
        le=0.01,
        description="gap between a wall's face and the marker's, against z-fighting",
    )
    module_px: int = Field(
        64, ge=8, le=256, description="side of one module of a marker in its texture"
    )

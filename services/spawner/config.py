"""What can be set about the spawner."""

from __future__ import annotations

from pydantic import Field

from services.common.config import ServiceConfig


class SpawnerConfig(ServiceConfig):
    """How markers are drawn and where they may hang."""

    panel_gap_m: float = Field(
        0.002, gt=0.0, le=0.01, description="from a wall's face to the marker's, against z-fighting"
    )
    module_px: int = Field(
        64, ge=8, le=256, description="side of one module of a marker in its texture"
    )

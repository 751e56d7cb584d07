"""What can be set about the world generator."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from services.common.config import ServiceConfig
from services.common.root import ROOT


class WorldgenConfig(ServiceConfig):
    """Where recipes and textures lie."""

    worlds_dir: Path = Field(ROOT / "worlds", description="folder of the recipes (*.yaml)")
    texture_base: Path | None = Field(
        None, description="folder of the textures; none: `textures` in the folder of the recipes"
    )

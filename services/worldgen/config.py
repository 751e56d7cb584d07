"""Configuration of the world generator."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from services.common.config import ServiceConfig
from services.common.root import ROOT


class WorldgenConfig(ServiceConfig):
    """Folders of recipes and textures."""

    worlds_dir: Path = Field(ROOT / "worlds", description="folder of the recipes (*.yaml)")
    texture_base: Path | None = Field(
        None, description="folder of the textures; none: `textures` in the recipes' folder"
    )

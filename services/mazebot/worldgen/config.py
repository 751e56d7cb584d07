"""Configuration of the world generator."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from mazebot.common.config import OptionalPath, ServiceConfig
from mazebot.common.files.root import ROOT


class WorldgenConfig(ServiceConfig):
    """Folders of recipes and textures."""

    worlds_dir: Path = Field(ROOT / "worlds", description="folder of the recipes (*.yaml)")
    texture_base: OptionalPath = Field(
        None, description="folder of the textures; none: `textures` in the recipes' folder"
    )
    map_file: OptionalPath = Field(
        None,
        description="YAML file of a map that is published instead of the world's own; if "
        "`markers.yaml` or `NAME.markers.yaml` lies beside it, the robot knows these markers only",
    )

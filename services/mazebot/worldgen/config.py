"""Configuration of the world generator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from mazebot.common.config import ServiceConfig
from mazebot.common.files.root import ROOT


def _none_if_empty(value: object) -> object:
    """Docker Compose sets variables to nothing."""
    return None if value == "" else value


class WorldgenConfig(ServiceConfig):
    """Folders of recipes and textures."""

    worlds_dir: Path = Field(ROOT / "worlds", description="folder of the recipes (*.yaml)")
    texture_base: Path | None = Field(
        None, description="folder of the textures; none: `textures` in the recipes' folder"
    )
    map_file: Annotated[Path | None, BeforeValidator(_none_if_empty)] = Field(
        None,
        description="YAML file of a map that is published instead of the world's own; if "
        "`markers.yaml` or `NAME.markers.yaml` lies beside it, the robot knows these markers only",
    )

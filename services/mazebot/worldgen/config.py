"""Configuration of the world generator."""

from __future__ import annotations

from os.path import normpath
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

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

    @field_validator("texture_base")
    @classmethod
    def _must_be_a_folder(cls, folder: Path | None, info: ValidationInfo) -> Path | None:
        # The default may be missing: a world without textures needs none.
        usual = info.data.get("worlds_dir", ROOT / "worlds") / "textures"
        if folder is None or folder.is_dir() or normpath(folder) == normpath(usual):
            return folder
        raise ValueError("must be a folder")
